"""Names at the top level: loaded when used, known to type checkers, the same everywhere."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

import hueflight as hf

SOURCE = Path(hf.__file__)


def names_for_type_checkers() -> dict[str, str]:
    """Public names and where the block for type checkers imports them from."""
    found = {}
    for node in ast.parse(SOURCE.read_text("utf-8")).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for line in node.body:
                if isinstance(line, ast.ImportFrom):
                    for name in line.names:
                        public = name.asname or name.name
                        there = "" if public == name.name else f":{name.name}"
                        found[public] = f"{line.module}{there}"
    return found


def test_type_checkers_see_what_is_loaded() -> None:
    assert names_for_type_checkers() == hf._HOME


def test_all_names_every_public_thing_once() -> None:
    assert set(hf.__all__) == {*hf._HOME, "__version__"}
    assert len(hf.__all__) == len(set(hf.__all__))


@pytest.mark.parametrize("name", hf.__all__)
def test_every_public_name_can_be_used(name: str) -> None:
    assert getattr(hf, name) is not None


def test_tab_completion_offers_names_and_packages_before_they_are_loaded() -> None:
    program = "import hueflight as hf; print(*dir(hf))"
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
    ).stdout.split()
    assert {*hf.__all__, "simulator", "recording", "analysis"} <= set(shown)


def test_packages_are_attributes() -> None:
    program = "import hueflight as hf; print(hf.simulator.__name__, hf.export.__name__)"
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
    ).stdout.split()
    assert shown == ["hueflight.simulator", "hueflight.export"]


def test_unknown_names_are_refused_as_python_does() -> None:
    with pytest.raises(AttributeError, match="module 'hueflight' has no attribute 'reconstuct'"):
        _ = hf.reconstuct  # type: ignore[attr-defined]


def test_version_is_that_of_the_package() -> None:
    assert hf.__version__ == version("hueflight")


def test_names_of_version_0_1_are_the_same_things() -> None:
    assert hf.reconstruct_alternated is hf.reconstruct_interleaved
    for name in (
        "Calibration", "HueflightError", "Instrument", "calibrate", "color_picture",
        "depth_bound", "reconstruct", "reflectance_bound", "reflectance_interval",
    ):  # fmt: skip
        module, _, there = hf._HOME[name].partition(":")
        assert getattr(hf, name) is getattr(import_module(module), there or name)


def test_the_package_is_a_program() -> None:
    shown = subprocess.run(
        [sys.executable, "-m", "hueflight", "--version"],
        capture_output=True, text=True, check=True, timeout=60,
    ).stdout  # fmt: skip
    assert shown.startswith(f"hueflight {version('hueflight')}\nPython ")
    assert "\nNumPy " in shown
    assert "kernels for packets to histograms: " in shown
