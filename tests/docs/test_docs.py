"""The documentation builds without a warning, and what its pages run, runs."""

import doctest
import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import hueflight

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_pages_build_from_scratch_without_a_warning(tmp_path: Path) -> None:
    """All tutorials are executed on the way; a block that fails fails the build."""
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E",
         "-d", str(tmp_path / "doctrees"), str(ROOT / "docs"), str(tmp_path / "html")],
        capture_output=True,
        text=True,
        check=False,
        timeout=800,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
    for page in ("first-picture", "tutorials/other-language", "api/export", "physics"):
        assert (tmp_path / "html" / f"{page}.html").stat().st_size > 5000
    # executed blocks leave their output in the page
    physics = (tmp_path / "html" / "physics.html").read_text()
    assert "as much background as signal" in physics


@pytest.mark.slow
def test_a_failing_block_fails_the_build(tmp_path: Path) -> None:
    (tmp_path / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT / 'docs' / '_extensions')!r})\n"
        "extensions = ['myst_parser', 'executed']\n"
    )
    for block in ("```{run} python\n1 / 0\n```", "```{run} bash\nfalse\n```"):
        (tmp_path / "index.md").write_text(f"# Title\n\n{block}\n")
        done = subprocess.run(
            [sys.executable, "-m", "sphinx", "-W", "-q", "-E", str(tmp_path), str(tmp_path / "o")],
            capture_output=True,
            text=True,
            check=False,
            timeout=100,
        )
        assert done.returncode != 0
        assert "a block failed" in done.stderr


ROOMS = (
    "hueflight.analysis",
    "hueflight.batch",
    "hueflight.devices",
    "hueflight.export",
    "hueflight.importers",
    "hueflight.ingest",
    "hueflight.recording",
    "hueflight.simulator",
    "hueflight_protocol",
)


def modules() -> list[str]:
    found = list(ROOMS)
    for room in ROOMS:
        package = importlib.import_module(room)
        found += [f"{room}.{entry.name}" for entry in pkgutil.iter_modules(package.__path__)]
    return [name for name in found if not name.rpartition(".")[2].startswith("_")]


def test_examples_in_docstrings_are_true() -> None:
    tried = 0
    for name in modules():
        result = doctest.testmod(importlib.import_module(name))
        assert result.failed == 0, name
        tried += result.attempted
    assert tried >= 36
    assert hueflight.__doc__


def test_every_export_has_a_docstring_that_says_what_it_raises() -> None:
    for room in ROOMS:
        package = importlib.import_module(room)
        for name in package.__all__:
            thing = getattr(package, name)
            if inspect.isclass(thing) or inspect.isfunction(thing):
                assert thing.__doc__, f"{room}.{name}"
