"""The interface to the two kernels, compiled or in NumPy, whose results are bit-identical.

Both implementations are modules with the functions `scan` and `count`; `hueflight.backend` decides
which of them is used.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from hueflight import backend
from hueflight.errors import KernelError
from hueflight.ingest import numpy_kernels
from hueflight.ingest.numpy_kernels import (
    ADD,
    MOST_FRAMES,
    SATURATE,
    STATE,
    STORE,
    SUBTRACT,
    TILE,
)
from hueflight_protocol import wire

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
    """Two functions over buffers; `numpy_scan.scan` and `numpy_count.count` document them."""

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


def _wire_constants() -> dict[str, int]:
    """The numbers that the C source repeats, from the protocol's declarations."""
    frame, trailer = wire.FRAME_HEADER, wire.FRAME_TRAILER
    fields = ("type", "header_bytes", "length", "sequence", "timestamp", "frame", "dropped")
    fields += ("rows", "cols", "run", "code_bits", "flags", "step", "capture")
    return {f"AT_{name.upper()}": frame.offset(name) for name in fields} | {
        "MAGIC": int.from_bytes(wire.MAGIC, "little"),
        "VERSION": wire.VERSION,
        "FRAME": int(wire.PacketType.FRAME),
        "LAST_KNOWN_TYPE": int(max(wire.PacketType)),
        "FRAME_HEADER": frame.size,
        "FRAME_TRAILER": trailer.size,
        "OTHER_HEADER": wire.PACKET_HEADER.size,
        "OTHER_TRAILER": wire.PACKET_TRAILER.size,
        "MAX_HEADER": wire.MAX_HEADER_BYTES,
        "MAX_BODY": wire.MAX_BODY_BYTES,
        "MAX_SIDE": max(wire.MAX_ROWS, wire.MAX_COLS),
        "MAX_BITS": wire.MAX_CODE_BITS,
        "MIN_RUN": wire.MIN_RUN,
        "MAX_RUN": wire.MAX_RUN,
        "MAX_CHUNKS": wire.MAX_CHUNKS,
        "KNOWN_FLAGS": int(sum(wire.FrameFlags)),
        "PAD": int(wire.ChunkKind.PAD),
        "BITMAP": int(wire.ChunkKind.BITMAP),
        "DENSE": int(wire.ChunkKind.DENSE),
        "END": int(wire.ChunkKind.END),
        "TILE": TILE,
        "MOST_FRAMES": MOST_FRAMES,
        "ADD": ADD,
        "STORE": STORE,
        "SATURATE": SATURATE,
        "SUBTRACT": SUBTRACT,
    }


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
        The functions `scan` and `count`.

    Raises
    ------
    KernelError
        If there is no such implementation here.
    """
    module = backend.compiled("ingest", name)
    if module is None:
        return cast("Kernels", numpy_kernels)
    _check(module)
    return cast("Kernels", module)


@cache  # takes longer than counting an empty frame
def _check(module: ModuleType) -> None:
    built = {name: getattr(module, name, None) for name in _wire_constants()}
    stale = [name for name, value in _wire_constants().items() if built[name] != value]
    if stale or tuple(module.STATE.split()) != STATE:
        raise KernelError(
            f"the compiled kernels were built from other sources ({', '.join(stale) or 'STATE'} "
            "differ): install the package again, or set HUEFLIGHT_KERNELS=numpy"
        )
