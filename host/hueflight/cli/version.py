"""What `hueflight --version` prints."""

from __future__ import annotations

import platform
from importlib.metadata import version


def describe_version() -> str:
    """Versions of Hueflight and of what its numbers depend on, one a line.

    Returns
    -------
    str
        Lines for people and bug reports.
    """
    return "\n".join(
        (
            f"hueflight {version('hueflight')}",
            f"Python {platform.python_version()}",
            f"NumPy {version('numpy')}",
        )
    )
