# SPDX-License-Identifier: Apache-2.0
"""Public names of a package that are loaded when they are first used (PEP 562).

A package whose modules take long to import lists in a dictionary where each public name is defined.
Importing the package then costs next to nothing, and a name costs what its own module imports.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str], subpackages: tuple[str, ...] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions ``__getattr__`` and ``__dir__`` of a package that loads names lazily.

    A name must differ from those of the package's modules: Python sets a module that was imported
    as an attribute of its package, which would then hide the name.

    Parameters
    ----------
    package : str
        Full name of the package, its ``__name__``.
    homes : mapping of str to str
        Module in which each public name is defined, followed by a colon and the name there where
        it is another one.
    subpackages : tuple of str
        Names of subpackages that are attributes without being imported by name.

    Returns
    -------
    load : callable
        ``__getattr__`` of the package. It imports what is asked for and keeps it in the package, so
        that it is called once for each name.
    names : callable
        ``__dir__`` of the package, for `dir` and tab completion before anything is loaded.
    """

    def load(name: str) -> Any:
        if name in homes:
            module, _, there = homes[name].partition(":")
            value = getattr(import_module(module), there or name)
            setattr(sys.modules[package], name, value)
            return value
        if name in subpackages:
            return import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes, *subpackages})

    return load, names
