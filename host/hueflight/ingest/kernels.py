# SPDX-License-Identifier: Apache-2.0
"""The interface to the kernels, compiled or in NumPy.

Counts are bit-identical; significances may differ in the last digits.

Both implementations are modules with the functions of `Kernels`; `hueflight.backend` decides which
of them is used.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from hueflight import backend
from hueflight.backend.ingest import ADD, MOST_FRAMES, SATURATE, STORE, SUBTRACT, TILE
from hueflight.ingest import numpy_kernels
from hueflight.ingest.numpy_scan import STATE

__all__ = [
    "ADD",
    "MOST_FRAMES",
    "SATURATE",
    "STATE",
    "STORE",
    "SUBTRACT",
    "TILE",
    "Buffer",
    "Kernels",
    "Scanned",
    "available",
    "choose",
]

Buffer = bytes | bytearray | memoryview


class Scanned(NamedTuple):
    """Result of one call of `scan`.

    Attributes
    ----------
    position : int
        Offset at which scanning stopped.
    frames : int
        Number of frames in the tables, including those of earlier calls.
    others : int
        Number of packets found by this call that are not frames.
    run : int
        Run length of the frames, in pixels.
    stride : int
        Number of frames per chunk in the table of chunks.
    needed : int
        Bytes needed from `position` on to make progress.
    ended : bool
        Whether scanning stopped because the data ended. Otherwise a table is full or the run
        length has changed.
    """

    position: int
    frames: int
    others: int
    run: int
    stride: int
    needed: int
    ended: bool


class Kernels(Protocol):
    """Functions over buffers; the modules ``numpy_…`` document them."""

    def scan(
        self,
        data: Buffer,
        start: int,
        final: bool,
        rows: int,
        cols: int,
        code_bits: int,
        frames: int,
        limit: int,
        run: int,
        state: NDArray[np.int64],
        chunks: NDArray[np.uint64],
        headers: NDArray[np.uint8],
        places: NDArray[np.uint64],
        others: NDArray[np.uint64],
        /,
    ) -> tuple[int, int, int, int, int, int, bool]:
        """Find packets in a piece of a byte stream."""
        ...

    def count(
        self,
        data: Buffer,
        chunks: NDArray[np.uint64],
        stride: int,
        chosen: NDArray[np.uint32],
        pixels: int,
        code_bits: int,
        run: int,
        out: NDArray[np.unsignedinteger[Any]],
        wide: bool,
        mode: int,
        done: NDArray[np.uint8],
        begin: int,
        end: int,
        /,
    ) -> tuple[int, int, int]:
        """Count the codes of scanned frames; return photons, clipped counts, tiles left out."""
        ...

    def group_counts(
        self,
        histogram: NDArray[np.unsignedinteger[Any]],
        wide: bool,
        rows: int,
        cols: int,
        codes: int,
        group: int,
        leave_first: bool,
        out: NDArray[np.float64],
        /,
    ) -> None:
        """Count photons by tiles of pixels and groups of codes."""
        ...

    def gather(
        self,
        total: NDArray[np.unsignedinteger[Any]],
        total_wide: bool,
        histogram: NDArray[np.unsignedinteger[Any]],
        histogram_wide: bool,
        anew: NDArray[np.bool_],
        rows: int,
        cols: int,
        codes: int,
        out: NDArray[np.unsignedinteger[Any]],
        out_wide: bool,
        /,
    ) -> None:
        """Add a histogram to a sum that begins anew in some tiles."""
        ...

    def significance(
        self,
        newest: NDArray[np.float64],
        earlier: NDArray[np.float64],
        ratio: NDArray[np.float64],
        rows: int,
        cols: int,
        groups: int,
        size: int,
        window: int,
        brightness_tolerance: float,
        shift_tolerance: float,
        out: NDArray[np.float64],
        /,
    ) -> None:
        """Compare counts with what earlier counts predict."""
        ...


def available() -> dict[str, Kernels]:
    """Return the usable implementations by name.

    Returns
    -------
    dict
        ``"numpy"`` always, ``"c"`` where it was compiled.
    """
    found: dict[str, Kernels] = {"numpy": cast("Kernels", numpy_kernels)}
    if backend.available("ingest"):
        found["c"] = choose("c")
    return found


def choose(name: str | None = None, /) -> Kernels:
    """Return an implementation of the kernels.

    Parameters
    ----------
    name : str, optional
        ``"c"`` or ``"numpy"``; by default what ``HUEFLIGHT_KERNELS`` asks for, else the fastest.

    Returns
    -------
    Kernels
        Its functions.

    Raises
    ------
    KernelError
        If there is no such implementation here.
    """
    module = backend.compiled("ingest", name)
    if module is None:
        return cast("Kernels", numpy_kernels)
    return cast("Kernels", module)
