# SPDX-License-Identifier: Apache-2.0
"""Frame packet in, codes out: strict, so that what it accepts is what the encoder makes.

The decoder refuses every packet that differs in one bit from what `encode_frame` makes of
the codes in it, and names the rule of the specification that the packet breaks.
"""

import numpy as np
from numpy.typing import NDArray

from .checksum import crc32c
from .errors import AbortedFrameError, PacketError
from .frame import Frame, FrameHeader
from .packing import unpack_codes
from .walk import Chunk, FrameWalk
from .wire import FRAME_TRAILER, ChunkKind


def decode_frame(packet: bytes | bytearray | memoryview, /) -> Frame:
    """Return the frame in one whole frame packet.

    Parameters
    ----------
    packet : bytes-like
        Exactly one packet, from magic to CRC.

    Returns
    -------
    Frame
        Header and codes.

    Raises
    ------
    AbortedFrameError
        If the packet is well-formed but says that the camera gave the frame up.
    PacketError
        If the packet breaks a rule; the message names the rule, the value and the byte.
    """
    data = bytes(packet)
    walk = FrameWalk()
    if not walk.advance(data):
        raise PacketError(f"packet ends after {len(data)} bytes", rule="P7", offset=len(data))
    if walk.position != len(data):
        raise PacketError(
            f"{len(data) - walk.position} bytes follow the packet", rule="P7", offset=walk.position
        )
    return read_frame(data, walk)


def read_frame(data: bytes, walk: FrameWalk, /) -> Frame:
    """Return the frame in `data`, whose chunks `walk` has found.

    Raises
    ------
    AbortedFrameError, PacketError
        As `decode_frame`.
    """
    stored = int.from_bytes(data[-4:], "little")
    computed = crc32c(data[:-4])
    if stored != computed:
        raise PacketError(
            f"CRC is {stored:#010x}, the bytes give {computed:#010x}",
            rule="P6",
            offset=len(data) - 4,
        )
    header = FrameHeader.from_wire(walk.header)
    runs = np.zeros((header.chunks, header.run), np.uint16)
    if walk.chunks:
        runs[[chunk.index for chunk in walk.chunks]] = _read_chunks(data, walk.chunks, header)
    if walk.aborted:
        raise AbortedFrameError(
            f"frame {header.frame} was aborted by the camera",
            rule="F13",
            offset=len(data) - FRAME_TRAILER.size,
        )
    codes = runs.reshape(-1)[: header.pixels].reshape(header.rows, header.cols)
    codes.flags.writeable = False
    return Frame(header, codes)


def _read_chunks(data: bytes, chunks: list[Chunk], header: FrameHeader) -> NDArray[np.uint16]:
    """Return one full run of codes per chunk, the pixels beyond the frame's end being 0."""
    source = np.frombuffer(data, np.uint8)
    bitmaps = np.zeros((len(chunks), header.run // 8), np.uint8)
    packed = np.zeros((len(chunks), header.run * header.code_bits // 8), np.uint8)
    for row, chunk in enumerate(chunks):
        start = chunk.offset + 4
        middle = start + chunk.bitmap_size
        end = middle + chunk.packed_size
        bitmaps[row, : chunk.bitmap_size] = source[start:middle]
        packed[row, : chunk.packed_size] = source[middle:end]
        padding = data[end : start + chunk.size]
        if any(padding):
            raise PacketError(
                f"padding of chunk {chunk.index} is {padding.hex(' ')}, must be 0",
                rule="F10",
                offset=end,
            )

    place = np.arange(header.run)
    pixels = np.array([chunk.pixels for chunk in chunks])[:, None]
    hits = np.array([chunk.hits for chunk in chunks])[:, None]
    dense = np.array([chunk.kind == ChunkKind.DENSE for chunk in chunks])[:, None]
    values = unpack_codes(packed, header.code_bits)
    lit = np.unpackbits(bitmaps, axis=1, bitorder="little").view(bool)

    stored = np.where(dense, pixels, hits)
    beyond = "bits after the last code, which must be 0"
    _refuse((values != 0) & (place >= stored), chunks, "F10", beyond)
    _refuse(lit & (place >= pixels), chunks, "F10", "a bit for a pixel that the run does not have")
    _refuse((values == 0) & (place < hits) & ~dense, chunks, "F11", "a hit with code 0")
    counted = np.where(dense, values != 0, lit).sum(axis=1, keepdims=True)
    for chunk, count in zip(chunks, counted[:, 0], strict=True):
        if chunk.hits != count:
            raise PacketError(
                f"chunk {chunk.index} says {chunk.hits} hits and has {count}",
                rule="F11",
                offset=chunk.offset,
            )

    codes = np.where(dense, values, 0)
    codes[lit] = values[~dense & (place < hits)]
    return codes


def _refuse(wrong: NDArray[np.bool_], chunks: list[Chunk], rule: str, what: str) -> None:
    """Raise an error about the first chunk that has something wrong."""
    bad = np.flatnonzero(wrong.any(axis=1))
    if bad.size:
        chunk = chunks[int(bad[0])]
        raise PacketError(f"chunk {chunk.index} has {what}", rule=rule, offset=chunk.offset)
