# SPDX-License-Identifier: Apache-2.0
"""Imports of the gateware go down one order of packages, and there is no circle of modules."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import hueflight_hdl

ROOT = Path(hueflight_hdl.__file__).parent
# as the docstring of `hueflight_hdl` states it; those on one level do not import one another
LEVELS = (
    {"toolchain"},
    {"common"},
    {"control"},
    {"link"},
    {"camera", "illuminator"},
    {"boards"},
    {"testbench"},
    {"proofs"},
    {"build"},
    {"cli"},
)


def imports(path: Path) -> set[str]:
    """Modules of the package that a file imports, inside functions too, as dotted names."""
    package = path.relative_to(ROOT).parts[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {
                alias.name.removeprefix("hueflight_hdl.")
                for alias in node.names
                if alias.name.startswith("hueflight_hdl")
            }
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                base = [*package[: len(package) - node.level + 1]]
            elif (node.module or "").startswith("hueflight_hdl"):
                base = []
            else:
                continue
            module = (node.module or "").removeprefix("hueflight_hdl").strip(".")
            target = ".".join([*base, *([module] if module else [])])
            for alias in node.names:
                name = f"{target}.{alias.name}".strip(".")
                found.add(name if file_of(name) else target)
    return found


def file_of(name: str) -> Path | None:
    """File of a module or package."""
    path = ROOT.joinpath(*name.split("."))
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.exists():
            return candidate
    return None


def name_of(path: Path) -> str:
    """Dotted name of a file below the package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


GRAPH = {name_of(path): imports(path) for path in sorted(ROOT.rglob("*.py"))}


def test_every_package_has_a_level():
    packages = {name.partition(".")[0] for name in GRAPH if name}
    assert packages == set().union(*LEVELS)


def test_imports_go_down():
    level = {package: number for number, level in enumerate(LEVELS) for package in level}
    upward = []
    for importer, imported in GRAPH.items():
        if not importer:
            continue
        package = importer.partition(".")[0]
        for name in imported:
            other = name.partition(".")[0]
            if other != package and level[other] >= level[package]:
                upward.append(f"{importer} imports {name}")
    assert not upward


def test_no_circle_of_modules():
    TopologicalSorter(GRAPH).prepare()  # raises CycleError, which names the circle
