# SPDX-License-Identifier: Apache-2.0
"""Packets of sums: a part of a picture that the camera reduced to a few sums per pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .errors import PacketError, ProtocolError
from .packet_header import PacketHeader
from .reduction import MOST_SUM_BITS, MOST_SUMS
from .wire import ALIGNMENT, MAX_CODE_BITS, MAX_COLS, MAX_ROWS, SUMS_BODY, FrameFlags, padded

NUMBERS = (
    "picture",
    "first_pixel",
    "rows",
    "cols",
    "frames",
    "missed",
    "photons",
    "tables",
    "offsets",
    "periods",
    "code_bits",
)

ALL_FLAGS = int(sum(FrameFlags))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sums:
    """Sums of successive pixels of a picture.

    Parameters
    ----------
    header : PacketHeader
        Sequence, timestamp, capture.
    values : ndarray of uint32, shape (pixel, sum)
        The sums. One at the greatest value of its width is saturated.
    widths : tuple of int
        Bits of each sum.
    picture : int
        Number of the picture since the capture began, modulo 2**32.
    first_pixel : int
        Number of the first pixel, in readout order.
    rows, cols : int
        Shape of the picture.
    frames : int
        Frames that the sums of these pixels hold; other packets of the picture may have others.
    tables : int
        `ReductionTables.hash` of the tables.
    missed : int
        Frames that came while they were gathered and are not in them.
    photons : int
        Codes that were added, over all these pixels.
    offsets : int
        CRC-32C of the offsets of all pixels, one signed byte each; 0 where none is moved.
    periods : int
        Periods per exposure.
    code_bits : int
        Width of a code.
    flags : FrameFlags
        What the camera did to the frames.
    """

    header: PacketHeader
    values: NDArray[np.uint32]
    widths: tuple[int, ...]
    picture: int
    first_pixel: int
    rows: int
    cols: int
    frames: int
    tables: int
    missed: int = 0
    photons: int = 0
    offsets: int = 0
    periods: int = 1
    code_bits: int = 9
    flags: FrameFlags = FrameFlags.NONE

    @property
    def saturated(self) -> int:
        """Number of pixels with a saturated sum."""
        return _saturated(self.values, self.widths)


def _saturated(values: NDArray[np.uint32], widths: tuple[int, ...]) -> int:
    reached = values == _greatest(widths)
    return int(np.count_nonzero(reached.any(axis=1))) if reached.any() else 0


@lru_cache(maxsize=8)
def _greatest(widths: tuple[int, ...]) -> NDArray[np.uint32]:
    """Greatest value of each sum."""
    return np.array([(1 << width) - 1 for width in widths], np.uint32)


def _bits(values: NDArray[np.uint32], widths: tuple[int, ...]) -> NDArray[np.uint8]:
    """Bits of all sums, one after another, shape (bit,)."""
    columns = [
        (values[:, number, None] >> np.arange(width, dtype=np.uint32)) & 1
        for number, width in enumerate(widths)
    ]
    return np.concatenate(columns, axis=1).astype(np.uint8).reshape(-1)


def pack_sums(sums: Sums, /) -> bytes:
    """Return the body of a packet of sums.

    Parameters
    ----------
    sums : Sums
        The sums.

    Returns
    -------
    bytes
        The body, without padding.

    Raises
    ------
    ProtocolError
        If a value does not fit its width, or the packet would break a rule.
    """
    values = np.asarray(sums.values)
    shape = (len(values), len(sums.widths))
    if values.shape != shape or values.dtype.kind not in "iu":
        raise ProtocolError(f"values of shape {values.shape}: must be whole numbers {shape}")
    for number, width in enumerate(sums.widths):
        if 1 <= width <= MOST_SUM_BITS and len(values) and int(values[:, number].max()) >> width:
            raise ProtocolError(
                f"sum {number} reaches {values[:, number].max()}: does not fit {width} bits"
            )
    head = {name: getattr(sums, name) for name in NUMBERS}
    head |= {"pixels": len(values), "sums": len(sums.widths), "flags": int(sums.flags)}
    words = values.astype(np.uint32)
    body = SUMS_BODY.pack({**head, "saturated": _saturated(words, sums.widths), "reserved": 0})
    body += bytes(sums.widths) + bytes(-len(sums.widths) % ALIGNMENT)
    body += np.packbits(_bits(words, sums.widths), bitorder="little").tobytes()
    try:
        unpack_sums(body, sums.header, 0)
    except PacketError as error:
        raise ProtocolError(f"these sums can't be sent: {error}") from None
    return body


def unpack_sums(body: bytes, header: PacketHeader, at: int, /) -> Sums:
    """Return what the body of a packet of sums carries.

    Parameters
    ----------
    body : bytes
        The body, without padding.
    header : PacketHeader
        Sequence, timestamp, capture.
    at : int
        Byte of the packet at which the body begins.

    Returns
    -------
    Sums
        The content.

    Raises
    ------
    PacketError
        If the body breaks a rule.
    """

    def need(right: bool, rule: str, what: str, offset: int) -> None:
        if not right:
            raise PacketError(what, rule=rule, offset=offset)

    need(len(body) >= SUMS_BODY.size, "U1", f"sums body has {len(body)} bytes", 8)
    head = SUMS_BODY.unpack(body)
    rows, cols, pixels, count = head["rows"], head["cols"], head["pixels"], head["sums"]
    shape_fits = 1 <= rows <= MAX_ROWS and 1 <= cols <= MAX_COLS
    need(shape_fits, "U2", f"picture has {rows} rows and {cols} columns", at + 12)
    inside = pixels >= 1 and head["first_pixel"] + pixels <= rows * cols
    need(inside, "U2", f"pixels {head['first_pixel']} + {pixels} of {rows * cols}", at + 4)
    need(1 <= head["code_bits"] <= MAX_CODE_BITS, "U2", f"codes of {head['code_bits']} bits", at)
    need(1 <= count <= MOST_SUMS, "U2", f"{count} sums per pixel", at)
    need(head["flags"] <= ALL_FLAGS, "U2", f"flags are {head['flags']:#06x}", at)
    need(head["reserved"] == 0, "U2", f"reserved word is {head['reserved']}", at)
    first = SUMS_BODY.size + padded(count, ALIGNMENT)
    widths = tuple(body[SUMS_BODY.size : SUMS_BODY.size + count])
    fit = len(widths) == count and all(1 <= width <= MOST_SUM_BITS for width in widths)
    need(fit, "U3", f"widths are {widths}", at + SUMS_BODY.size)
    need(not any(body[SUMS_BODY.size + count : first]), "U3", "padding is not 0", at)
    total = pixels * sum(widths)
    need(len(body) == first + -(-total // 8), "U3", f"sums body has {len(body)} bytes", 8)
    unused = body[-1] >> (total % 8) if total % 8 else 0
    need(unused == 0, "U3", "unused bits are not 0", at + len(body) - 1)
    values = _values(body[first:], pixels, widths)
    found = _saturated(values, widths)
    need(head["saturated"] == found, "U4", f"{found} saturated, not {head['saturated']}", at + 32)
    fields = {name: head[name] for name in NUMBERS}
    return Sums(
        header=header, values=values, widths=widths, flags=FrameFlags(head["flags"]), **fields
    )


def _values(packed: bytes, pixels: int, widths: tuple[int, ...]) -> NDArray[np.uint32]:
    """Sums (pixel, sum) of packed bits: each is cut out of the 8 bytes in which it begins."""
    begins, shifts = _places(pixels, widths)
    padded_bytes = packed + bytes(8)
    words = np.ndarray((len(packed) + 1,), "<u8", padded_bytes, strides=(1,))
    cut = words[begins]
    cut >>= shifts
    return cut.astype(np.uint32) & _greatest(widths)


@lru_cache(maxsize=4)  # packets of a stream are alike, but for the last of a picture
def _places(pixels: int, widths: tuple[int, ...]) -> tuple[NDArray[np.intp], NDArray[np.uint64]]:
    """Byte in which each sum begins, and the bit there, (pixel, sum)."""
    first = np.cumsum((0, *widths[:-1])) + np.arange(pixels)[:, None] * sum(widths)
    return first >> 3, (first & 7).astype(np.uint64)
