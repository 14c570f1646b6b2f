# SPDX-License-Identifier: Apache-2.0
"""The documentation builds without warnings, its code runs, and it covers the public interface."""

import ast
import doctest
import importlib
import inspect
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hueflight

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_pages_build_from_scratch_without_a_warning(tmp_path: Path) -> None:
    """All tutorials are executed; a block that fails makes the build fail."""
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E",
         "-d", str(tmp_path / "doctrees"), str(ROOT / "docs"), str(tmp_path / "html")],
        capture_output=True,
        text=True,
        check=False,
        timeout=800,
        # a tutorial runs pytest, which would first delete what earlier test runs have left
        env=os.environ | {"PYTEST_DEBUG_TEMPROOT": str(tmp_path)},
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


API_PAGES = ROOT / "docs" / "api"
#: packages whose interface is a command or a service, or that serve the other packages only
WITHOUT_A_PAGE = {"backend", "cli", "daemon", "integrations", "report"}


def described_packages() -> list[str]:
    """Packages that have a page in the description of the programming interface."""
    text = "".join(page.read_text() for page in sorted(API_PAGES.glob("*.md")))
    return re.findall(r"automodule:: (\S+)", text)


def modules() -> list[str]:
    """Public modules of the packages that have a page."""
    found = described_packages()
    for package in found.copy():
        path = importlib.import_module(package).__path__
        found += [f"{package}.{entry.name}" for entry in pkgutil.iter_modules(path)]
    return [name for name in found if not name.rpartition(".")[2].startswith("_")]


def test_every_package_has_a_page() -> None:
    folders = {path.parent.name for path in (ROOT / "host/hueflight").glob("*/__init__.py")}
    expected = {f"hueflight.{name}" for name in folders - WITHOUT_A_PAGE}
    assert set(described_packages()) == expected | {"hueflight", "hueflight_protocol"}


def test_every_page_is_in_the_table_of_contents() -> None:
    contents = (API_PAGES / "index.md").read_text().partition("```{toctree}")[2].split()
    assert {page.stem for page in API_PAGES.glob("*.md")} - {"index"} <= set(contents)


def test_contributing_states_the_order_of_packages() -> None:
    tree = ast.parse((ROOT / "tests/system/architecture/test_import_order.py").read_text())
    order = next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "ORDER"
    )
    table = (ROOT / "CONTRIBUTING.md").read_text().partition("| package of `host/hueflight` |")[2]
    stated = re.findall(r"^\| `(\w+)` \|", table.partition("\n\n")[0], flags=re.MULTILINE)
    assert tuple(stated) == order


def test_examples_in_docstrings_are_true() -> None:
    tried = 0
    for name in modules():
        result = doctest.testmod(importlib.import_module(name))
        assert result.failed == 0, name
        tried += result.attempted
    assert tried >= 36
    assert hueflight.__doc__


def test_every_public_name_has_a_docstring() -> None:
    for name in described_packages():
        package = importlib.import_module(name)
        for public in package.__all__:
            thing = getattr(package, public)
            if inspect.isclass(thing) or inspect.isfunction(thing):
                assert thing.__doc__, f"{name}.{public}"
