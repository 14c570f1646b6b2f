# SPDX-License-Identifier: Apache-2.0
"""Validate docstrings with numpydoc.

    python tools/check_docstrings.py [FOLDER ...]

Every public class, function and method of `host` and `protocol` is held to the form (`FORM`).
What a package exports in its `__all__` must also document each parameter and what it returns
(`COMPLETE`). Entries of an Attributes section, which numpydoc does not look at, are held to the
form of parameters (codes AT04 to AT09). Prints one line per finding; the exit code is 1 if there is
any.
"""

from __future__ import annotations

import ast
import enum
import importlib
import inspect
import operator
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpydoc.docscrape import NumpyDocString
from numpydoc.validate import validate

from hueflight.errors import MissingPackageError

ROOT = Path(__file__).resolve().parent.parent
SOURCES = (ROOT / "host" / "hueflight", ROOT / "protocol" / "hueflight_protocol")
ADAPTERS = ROOT / "host" / "hueflight" / "integrations"  #: each needs the program it is for

#: numpydoc's codes for the form of what is written
FORM = frozenset(
    f"{group}{number:02}"
    for group, numbers in {
        "GL": (3, 5, 6, 7, 8, 10),
        "SS": (1, 2, 3, 4, 6),
        "PR": range(2, 11),
        "RT": range(2, 6),
    }.items()
    for number in numbers
)
#: and for what must be there in the public interface
COMPLETE = FORM | {"PR01", "RT01", "YD01"}


def module_name(path: Path) -> str:
    """Dotted name of a source file."""
    top = next(source.parent for source in SOURCES if source in path.parents)
    parts = path.relative_to(top).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def defined_names(path: Path) -> Iterator[str]:
    """Names that a file defines without a leading underscore: classes, their methods, functions."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef) or node.name.startswith("_"):
            continue
        yield node.name
        if isinstance(node, ast.ClassDef):
            for member in node.body:
                if isinstance(member, ast.FunctionDef) and not member.name.startswith("_"):
                    yield f"{node.name}.{member.name}"


def exported(packages: Iterator[str]) -> frozenset[str]:
    """Full names, where they are defined, of what packages export in `__all__`."""
    names = set()
    for package in packages:
        module = importlib.import_module(package)
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if inspect.isclass(thing) or inspect.isfunction(thing):
                names.add(f"{thing.__module__}.{thing.__qualname__}")
    return frozenset(names)


def attribute_faults(attributes: list[Any]) -> Iterator[tuple[str, str]]:
    """Codes and messages for entries of an Attributes section."""
    for names, kind, description in attributes:
        text = " ".join(description).strip()
        if not kind:
            yield "AT04", f'Attribute "{names}" has no type'
        if kind.endswith("."):
            yield "AT05", f'Attribute "{names}" type should not finish with "."'
        if not text:
            yield "AT07", f'Attribute "{names}" has no description'
        elif not (text[0].isupper() or not text[0].isalpha()):
            yield "AT08", f'Attribute "{names}" description should start with a capital letter'
        elif not text.endswith((".", "`", ")")):
            yield "AT09", f'Attribute "{names}" description should finish with "."'


def findings(path: Path, public: frozenset[str]) -> Iterator[str]:
    """One line for each fault in a file."""
    module = module_name(path)
    for name in defined_names(path):
        full = f"{module}.{name}"
        # not by the full name: a package may export a function under the name of a module
        thing: Any = operator.attrgetter(name)(importlib.import_module(module))
        is_public = full in public or full.rpartition(".")[0] in public
        if "." in name and module.startswith("hueflight.testing."):
            is_public = False  # tests and fixtures, whose parameters are fixtures
        result = validate(full)
        faults = [(code, message) for code, message in result["errors"]]
        if inspect.isclass(thing):
            attributes = NumpyDocString(inspect.getdoc(thing) or "")["Attributes"]
            documented = {name for entry in attributes for name in re.split(r",\s*", entry[0])}
            # nobody makes an object of an enumeration's or a Protocol's class
            made = not issubclass(thing, enum.Enum) and not getattr(thing, "_is_protocol", False)
            parameters = fields_or_arguments(thing) if made else set()
            if parameters <= documented:  # of a dataclass, the attributes are the parameters
                faults = [fault for fault in faults if fault[0] != "PR01"]
            faults += attribute_faults(attributes)
        for code, message in faults:
            if code in (COMPLETE if is_public else FORM) or code.startswith("AT"):
                line = result["file_line"]
                yield f"{path.relative_to(ROOT)}:{line}: {name}: {code} {message}"


def can_be_imported(path: Path) -> bool:
    """Whether the program that an adapter is for is installed; true of everything else."""
    if ADAPTERS not in path.parents:
        return True
    try:
        importlib.import_module(module_name(path))
    except MissingPackageError:
        return False
    return True


def fields_or_arguments(kind: type) -> set[str]:
    """Names of what a class is made from."""
    try:
        return set(inspect.signature(kind).parameters)
    except (TypeError, ValueError):
        return set()


def main(folders: list[str]) -> int:
    """Validate all files below the folders, by default everything."""
    wanted = [Path(folder).resolve() for folder in folders] or list(SOURCES)
    everything = [path for source in SOURCES for path in sorted(source.rglob("*.py"))]
    public = exported(module_name(path) for path in everything if path.name == "__init__.py")
    count = 0
    for path in everything:
        if not any(folder == path or folder in path.parents for folder in wanted):
            continue
        if not can_be_imported(path):
            print(f"{path.relative_to(ROOT)}: not checked: its program is not installed")
            continue
        for finding in findings(path, public):
            print(finding)
            count += 1
    print(f"{count} findings")
    return 1 if count else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
