# SPDX-License-Identifier: Apache-2.0
"""Names at the top level: loaded when used, known to type checkers, the same everywhere."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest

import hueflight as hf

#: packages that load their public names when they are first used
LAZY = ("hueflight", "hueflight.fit", "hueflight.reconstruction")


def names_for_type_checkers(package: ModuleType) -> dict[str, str]:
    """Public names and where the block for type checkers imports them from."""
    found = {}
    source = Path(str(package.__file__)).read_text("utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for line in node.body:
                if isinstance(line, ast.ImportFrom):
                    for name in line.names:
                        public = name.asname or name.name
                        there = "" if public == name.name else f":{name.name}"
                        found[public] = f"{line.module}{there}"
    return found


@pytest.mark.parametrize("name", LAZY)
def test_type_checkers_see_what_is_loaded(name: str) -> None:
    package = import_module(name)
    assert names_for_type_checkers(package) == package._HOME


@pytest.mark.parametrize("name", LAZY)
def test_all_names_every_public_thing_once(name: str) -> None:
    package = import_module(name)
    assert set(package.__all__) - {"__version__"} == set(package._HOME)
    assert len(package.__all__) == len(set(package.__all__))


@pytest.mark.parametrize("name", LAZY)
def test_no_module_hides_a_public_name(name: str) -> None:
    """An imported module becomes an attribute of its package, whatever had that name before."""
    package = import_module(name)
    modules = {entry.name for entry in pkgutil.iter_modules(package.__path__)}
    assert not modules & set(package.__all__)


@pytest.mark.parametrize("name", LAZY[1:])
def test_names_of_a_lazy_package_are_those_of_its_modules(name: str) -> None:
    package = import_module(name)
    for public, module in package._HOME.items():
        assert getattr(package, public) is getattr(import_module(module), public)
        assert public in dir(package)
    with pytest.raises(AttributeError, match=f"module '{name}' has no attribute 'recnstruct'"):
        _ = package.recnstruct


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
