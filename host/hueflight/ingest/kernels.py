"""The seam to the two hot kernels, compiled or NumPy, which give the same bits.

Both backends are modules with the functions `scan` and `count`. The compiled one is taken where
it was built; ``HUEFLIGHT_KERNELS=numpy`` or ``=c`` chooses by hand.
"""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import IngestError
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
    """What one call of `scan` found.

    Attributes
    ----------
    position : where scanning stopped.
    frames : frames in the tables, those of earlier calls included.
    others : packets that are not frames, found by this call.
    run, stride : run length of the frames, and frames per chunk in the table of chunks.
    needed : bytes from `position` without which there is nothing more to do.
    ended : stopped for want of bytes; otherwise the tables are full or the run length changed.
    """

    position: int
    frames: int
    others: int
    run: int
    stride: int
    needed: int
    ended: bool


class Kernels(Protocol):
    """Two functions over buffers; see `numpy_kernels` for what they do."""

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
        """Count the codes of scanned frames; return photons, clipped counts, tiles left."""
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


def _compiled() -> Kernels | None:
    """The C kernels, or None where they were not built.

    Raises
    ------
    IngestError
        If they were built for another version of the wire format.
    """
    try:
        module = import_module("hueflight.ingest._kernels")
    except ImportError:
        return None
    built = {name: getattr(module, name, None) for name in _wire_constants()}
    stale = [name for name, value in _wire_constants().items() if built[name] != value]
    if stale or tuple(module.STATE.split()) != STATE:
        raise IngestError(
            f"the compiled kernels were built from other sources ({', '.join(stale) or 'STATE'} "
            "differ): install the package again, or set HUEFLIGHT_KERNELS=numpy"
        )
    return cast("Kernels", module)


def available() -> dict[str, Kernels]:
    """The backends that are there, by name: ``"numpy"`` always, ``"c"`` where it was built."""
    found: dict[str, Kernels] = {"numpy": cast("Kernels", numpy_kernels)}
    if (compiled := _compiled()) is not None:
        found["c"] = compiled
    return found


@cache  # checking takes longer than counting an empty frame
def _fastest() -> Kernels:
    return _compiled() or cast("Kernels", numpy_kernels)


def choose(name: str | None = None, /) -> Kernels:
    """The backend called `name`; by default what ``HUEFLIGHT_KERNELS`` says, else the fastest.

    Raises
    ------
    IngestError
        If there is no such backend here.
    """
    name = name or os.environ.get("HUEFLIGHT_KERNELS") or None
    if name == "numpy":
        return cast("Kernels", numpy_kernels)
    if name is None:
        return _fastest()
    found = available()
    if name not in found:
        raise IngestError(f"no kernels {name!r} here: there are {', '.join(sorted(found))}")
    return found[name]
