# SPDX-License-Identifier: Apache-2.0
"""Imports go one way: down a stated order of packages, without a circle, functions included."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SOURCES = {
    "hueflight": ROOT / "host" / "hueflight",
    "hueflight_hdl": ROOT / "hdl" / "hueflight_hdl",
    "hueflight_protocol": ROOT / "protocol" / "hueflight_protocol",
}
#: first what others stand on; a package may import only what comes before it
ORDER = (
    "errors",
    "lazy",
    "memory",
    "numerical_threads",
    "arguments",
    "recognition",
    "model",
    "backend",
    "files",
    "progress",
    "ingest",
    "recording",
    "fit",
    "calibration",
    "reconstruction",
    "color",
    "importers",
    "analysis",
    "export",
    "simulator",
    "report",
    "batch",
    "live",
    "client",
    "integrations",
    "devices",
    "emulation",
    "acquisition",
    "testing",
    "daemon",
    "cli",
)
#: which of the three distributions each may import
MAY_IMPORT = {
    "hueflight_protocol": {"hueflight_protocol"},
    "hueflight_hdl": {"hueflight_hdl", "hueflight_protocol"},
    "hueflight": {"hueflight", "hueflight_protocol"},
}


def module_name(path: Path, top: Path) -> str:
    parts = path.relative_to(top.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {
    module_name(path, top): path for top in SOURCES.values() for path in sorted(top.rglob("*.py"))
}


def imports_of(module: str, source: str, *, is_package: bool) -> Iterator[str]:
    """Full names of what a module imports, wherever in the file: modules, or names in them."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")
                parent = parts[: len(parts) - node.level + int(is_package)]
                base = ".".join([*parent, *([base] if base else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def targets(module: str, source: str, *, is_package: bool, known: set[str]) -> set[str]:
    """Modules among `known` that a module imports."""
    found = set()
    for name in imports_of(module, source, is_package=is_package):
        while name and name not in known:
            name = name.rpartition(".")[0]
        found |= {name} - {"", module}
    return found


def graph() -> dict[str, set[str]]:
    known = set(MODULES)
    return {
        module: targets(
            module,
            path.read_text(encoding="utf-8"),
            is_package=path.name == "__init__.py",
            known=known,
        )
        for module, path in MODULES.items()
    }


GRAPH = graph()


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import one another (Tarjan's strongly connected components)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for other in sorted(edges[node]):
            if other not in order:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], order[other])
        if low[node] == order[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in edges:
        if node not in order:
            visit(node)
    return found


def package(module: str) -> str:
    """First name below `hueflight`; empty for the top package itself."""
    return module.split(".")[1] if "." in module else ""


def test_no_circle_of_modules() -> None:
    assert circles(GRAPH) == []


def test_every_package_has_its_place_in_the_order() -> None:
    top = SOURCES["hueflight"]
    there = {path.stem for path in top.glob("*.py")} | {
        path.name for path in top.iterdir() if (path / "__init__.py").exists()
    }
    assert there - {"__init__", "__main__"} == set(ORDER)


@pytest.mark.parametrize("name", ORDER)
def test_imports_go_down_the_order(name: str) -> None:
    allowed = set(ORDER[: ORDER.index(name) + 1])
    upward = [
        f"{module} imports {other}"
        for module, others in GRAPH.items()
        if module.startswith("hueflight.") and package(module) == name
        for other in sorted(others)
        if other.startswith("hueflight") and other.split(".")[0] == "hueflight"
        if package(other) not in allowed
    ]
    assert upward == []


@pytest.mark.parametrize("name", sorted(MAY_IMPORT))
def test_gateware_and_host_know_only_the_protocol(name: str) -> None:
    for module, path in MODULES.items():
        if module.split(".")[0] != name:
            continue
        source = path.read_text(encoding="utf-8")
        tops = {
            imported.split(".")[0]
            for imported in imports_of(module, source, is_package=path.name == "__init__.py")
        }
        foreign = tops & {*MAY_IMPORT, "tests", "tools", "support"}
        assert foreign <= MAY_IMPORT[name], module


def test_what_the_lab_relies_on_does_not_reach_the_simulator() -> None:
    """Nothing outside those that show or emulate an instrument imports the simulator."""
    may = {"simulator", "report", "emulation", "cli"}
    users = {
        module
        for module, others in GRAPH.items()
        if any(other.startswith("hueflight.simulator") for other in others)
    }
    assert {package(module) for module in users} <= may


def test_the_reader_sees_every_kind_of_import() -> None:
    """The checks above rest on this reader: relative, nested and conditional imports."""
    source = """
import hueflight.model.pulses
from hueflight.model import time_bins as bins
def inside():
    from ..fit.tables import make
    if True:
        import hueflight.cli
"""
    known = {
        "hueflight.model.pulses",
        "hueflight.model.time_bins",
        "hueflight.fit.tables",
        "hueflight.cli",
    }
    found = targets("hueflight.ingest.report", source, is_package=False, known=known)
    assert found == known
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
