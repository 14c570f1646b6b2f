# SPDX-License-Identifier: Apache-2.0
"""Write the C headers that C and Python of the kernels share.

    python tools/generate_kernel_headers.py

Each ``_c/abi.h`` is made from the declaration of the same kernel in `hueflight.backend`.
"""

from __future__ import annotations

from pathlib import Path

from hueflight.backend import KERNELS

HOST = Path(__file__).resolve().parent.parent / "host"


def headers() -> dict[Path, str]:
    """Return the path and the text of every header."""
    return {
        HOST.joinpath(*kernel.builds[-1].split(".")[:-1], "_c", "abi.h"): kernel.interface.header()
        for kernel in KERNELS.values()
    }


if __name__ == "__main__":
    for path, text in headers().items():
        path.write_text(text, encoding="utf-8")
        print(path.relative_to(HOST.parent))
