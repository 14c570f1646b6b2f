# SPDX-License-Identifier: Apache-2.0
"""Codes in, frame packet out: the reference that the gateware's formatter equals bit for bit."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checksum import crc32c
from .errors import ProtocolError
from .frame import FrameHeader
from .packing import pack_codes
from .wire import (
    ALIGNMENT,
    CHUNK_WORD,
    DEFAULT_RUN,
    END_WORD,
    FRAME_TRAILER,
    MAX_CODE_BITS,
    ChunkKind,
    FrameFlags,
    TrailerStatus,
    dense_from,
    padded,
)


def encode_frame(
    codes: ArrayLike,
    /,
    *,
    sequence: int,
    frame: int,
    timestamp: int,
    code_bits: int = 9,
    run: int = DEFAULT_RUN,
    periods: int = 1,
    dropped: int = 0,
    geometry: int = 0,
    flags: FrameFlags = FrameFlags.NONE,
    step: int = 0,
    capture: int = 0,
    clock_hz: int = 0,
    abort_at: int | None = None,
) -> bytes:
    """Return the frame packet that holds `codes`.

    Parameters
    ----------
    codes : array_like of int, shape (row, col)
        One code per pixel, 0 = no photon, below 2**code_bits. Masked pixels and codes outside
        a region or gate are already 0; `flags` says that this was so.
    sequence, frame, timestamp, code_bits, run, periods, dropped, geometry : int
        Fields of `FrameHeader`.
    flags : FrameFlags
        Field of `FrameHeader`.
    step, capture, clock_hz : int
        Fields of `FrameHeader`.
    abort_at : int, optional
        Make the packet of a frame that the camera gave up before this run: chunks of lower
        index are sent, and the trailer says *aborted*.

    Returns
    -------
    bytes
        A multiple of 8 bytes.

    Raises
    ------
    ProtocolError
        If a value does not fit the wire format.
    """
    values = _checked_codes(codes, code_bits)
    header = FrameHeader(
        sequence=sequence,
        frame=frame,
        timestamp=timestamp,
        rows=values.shape[0],
        cols=values.shape[1],
        code_bits=code_bits,
        run=run,
        periods=periods,
        dropped=dropped,
        geometry=geometry,
        flags=flags,
        step=step,
        capture=capture,
        clock_hz=clock_hz,
    )
    if abort_at is not None and not 0 <= abort_at <= header.chunks:
        raise ProtocolError(f"abort_at = {abort_at}: must be from 0 to {header.chunks}")
    head = header.pack()
    chunks, count, hits = _encode_chunks(values.reshape(-1), code_bits, run, abort_at)
    body = head + chunks
    body += bytes(padded(len(body), ALIGNMENT) - len(body))
    status = TrailerStatus(0) if abort_at is None else TrailerStatus.ABORTED
    trailer = FRAME_TRAILER.pack(
        {
            "end": END_WORD.pack(kind=ChunkKind.END, status=status, chunks=count),
            "hits": hits,
            "packet_words": (len(body) + FRAME_TRAILER.size) // 4,
            "crc": 0,
        }
    )
    packet = body + trailer[:-4]
    return packet + crc32c(packet).to_bytes(4, "little")


def _checked_codes(codes: ArrayLike, code_bits: int) -> NDArray[np.uint16]:
    values = np.asarray(codes)
    if values.ndim != 2:
        raise ProtocolError(f"codes has shape {values.shape}: must be (rows, cols)")
    if not np.issubdtype(values.dtype, np.integer):
        raise ProtocolError(f"codes are {values.dtype}: must be integers")
    if not 1 <= code_bits <= MAX_CODE_BITS:
        raise ProtocolError(f"code_bits = {code_bits}: must be from 1 to {MAX_CODE_BITS}")
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    if low < 0 or high >> code_bits:
        bad = low if low < 0 else high
        raise ProtocolError(f"code {bad}: must be from 0 to {(1 << code_bits) - 1}")
    return values.astype(np.uint16)


def _encode_chunks(
    codes: NDArray[np.uint16], code_bits: int, run: int, abort_at: int | None
) -> tuple[bytes, int, int]:
    """Return all chunks as bytes, their number, and their hits."""
    count = -(-codes.size // run)
    table = np.zeros((count, run), np.uint16)
    table.reshape(-1)[: codes.size] = codes
    pixels = np.full(count, run)
    pixels[-1] = codes.size - run * (count - 1)
    hits = np.count_nonzero(table, axis=1)

    kept = np.flatnonzero(hits[:abort_at])
    table, pixels, hits = table[kept], pixels[kept], hits[kept]
    threshold = np.where(
        pixels == run, dense_from(run, code_bits), dense_from(codes.size % run or run, code_bits)
    )
    dense = hits >= threshold

    lit = table != 0
    compact = np.zeros_like(table)
    compact[np.arange(run) < hits[:, None]] = table[lit]
    packed = pack_codes(np.where(dense[:, None], table, compact), code_bits)
    bitmaps = np.packbits(lit, axis=1, bitorder="little")

    # One row per chunk: word | bitmap | packed codes | padding, of which each chunk keeps the
    # bytes that it has.
    bitmap_size = np.where(dense, 0, -(-pixels // 8))
    packed_size = -(-np.where(dense, pixels, hits) * code_bits // 8)
    pad_size = -(bitmap_size + packed_size) % 4
    kind = np.where(dense, int(ChunkKind.DENSE), int(ChunkKind.BITMAP))
    word = (
        kind << CHUNK_WORD["kind"].shift
        | kept << CHUNK_WORD["index"].shift
        | hits << CHUNK_WORD["hits"].shift
    )
    parts = (
        (word.astype("<u4").view(np.uint8).reshape(-1, 4), np.full(kept.size, 4)),
        (bitmaps, bitmap_size),
        (packed, packed_size),
        (np.zeros((kept.size, 3), np.uint8), pad_size),
    )
    rows = np.concatenate([part for part, _ in parts], axis=1)
    used = np.concatenate(
        [np.arange(part.shape[1]) < size[:, None] for part, size in parts], axis=1
    )
    return rows[used].tobytes(), int(kept.size), int(hits.sum())
