# SPDX-License-Identifier: Apache-2.0
"""How many threads the libraries below NumPy and SciPy start: one, beside other work.

OpenBLAS starts a thread for each processor, and all of them wait in busy loops between products.
The matrices of this project are too small to gain by that, and the loops take processor time from
everything else: 30 ms for each live picture on two processors, more than the picture itself.
"""

from __future__ import annotations

import os

#: environment of a process whose numerical libraries use one thread
ONE_THREAD: dict[str, str] = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}


def use_one_thread() -> None:
    """Let numerical libraries use one thread, unless the environment says otherwise.

    It counts in this process if NumPy has not been loaded, and in those that are started from it.
    """
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
