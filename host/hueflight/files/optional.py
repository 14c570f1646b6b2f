# SPDX-License-Identifier: Apache-2.0
"""Packages that only some functions need, imported when these are called."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from hueflight.errors import MissingPackageError


def import_optional(module: str, *, extra: str) -> Any:
    """Import a module that only some installations have.

    Parameters
    ----------
    module : str
        Dotted name of the module.
    extra : str
        The extra of Hueflight whose installation brings the module.

    Returns
    -------
    module
        The imported module.

    Raises
    ------
    MissingPackageError
        If the module, or one that it imports, is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = (error.name or module).partition(".")[0]
        raise MissingPackageError(
            f"this needs the package {package!r}: pip install 'hueflight[{extra}]' ({error})"
        ) from None
