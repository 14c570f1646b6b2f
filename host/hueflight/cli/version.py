# SPDX-License-Identifier: Apache-2.0
"""What `hueflight --version` prints."""

from __future__ import annotations

import platform
from importlib.metadata import version

from hueflight.backend import KERNELS, describe


def describe_version() -> str:
    """Describe the software that numbers depend on, for bug reports.

    Returns
    -------
    str
        Versions of Hueflight, Python and NumPy, and for each set of kernels whether the compiled
        or the NumPy version runs, and why; one a line.
    """
    lines = [
        f"hueflight {version('hueflight')}",
        f"Python {platform.python_version()}",
        f"NumPy {version('numpy')}",
    ]
    for name, implementation in describe().items():
        lines.append(f"kernels for {KERNELS[name].purpose}: {implementation}")
    return "\n".join(lines)
