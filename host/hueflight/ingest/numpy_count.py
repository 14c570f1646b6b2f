"""Counting in NumPy: the twin of ``_count.h``.

A chunk's payloads of all frames are gathered and counted together, so that the work per NumPy
call is large and the counters of the chunk's pixels stay in the cache.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.ingest.numpy_scan import HITS_SHIFT, KIND_SHIFT, MOST_FRAMES, bitmap_bytes
from hueflight_protocol.wire import ChunkKind, dense_bytes, padded

TILE = 64  # pixels that are added to the table together or not at all
SLACK = 8  # bytes that may be read behind a payload: its packet's trailer is longer
ADD, STORE, SATURATE, SUBTRACT = range(4)

_Ints = NDArray[np.intp]


def count(
    data: Any,
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
    """Add the codes of frames to histograms; return photons, clipped counts, tiles left out.

    Parameters
    ----------
    data : bytes-like
        What was scanned.
    chunks, stride : uint64 array seen as (chunk, stride)
        Where the chunks of each frame lie.
    chosen : uint32 array (frame,)
        Which frames to count, at most `MOST_FRAMES`.
    pixels, code_bits, run : int
        Geometry of the frames.
    out : uint16 or (if `wide`) uint32 array of ``pixels << code_bits`` elements, changed
        Counts (pixel, code). Code 0 gets what no other code of a pixel got.
    mode : int
        ADD to `out`, but leave alone the tiles of which a counter would not hold the sum; STORE
        over it; SATURATE: add up to the largest count; SUBTRACT.
    done : uint8 array, a tile each, changed
        Tiles that have been added. Only others are added; only these are subtracted.
    begin, end : int
        Which chunks of the sensor to work on.
    """
    octets = np.frombuffer(data, np.uint8)
    if chosen.size > MOST_FRAMES:
        raise ValueError("count: chosen frames out of range")
    codes = 1 << code_bits
    entries = chunks[: stride * -(-pixels // run)].reshape(-1, stride)
    table = out.reshape(-1)[: pixels * codes].reshape(pixels, codes)
    marks = done.reshape(-1)[: -(-run // TILE) * len(entries)].reshape(len(entries), -1)
    photons = clipped = left = 0
    for chunk in range(begin, end):
        first = chunk * run
        size = min(run, pixels - first)
        seen = _count_chunk(octets, entries[chunk, chosen], size, code_bits)
        here = seen.sum(axis=1, dtype=np.intp) - seen[:, 0]
        seen[:, 0] = chosen.size - here
        for tile, at in enumerate(range(0, size, TILE)):
            part = slice(at, min(at + TILE, size))
            rows = table[first + part.start : first + part.stop]
            if (mode == SUBTRACT) != bool(marks[chunk, tile]):
                continue
            more, over = _put(rows, seen[part], mode)
            left += over
            if over:
                continue
            marks[chunk, tile] = mode != SUBTRACT
            clipped += more
            photons += int(here[part].sum())
    return photons, clipped, left


def _put(
    rows: NDArray[np.unsignedinteger[Any]], seen: NDArray[np.uint16], mode: int
) -> tuple[int, bool]:
    """Add to rows of the table; return clipped counts and whether a counter was too small."""
    largest = rows.dtype.type(np.iinfo(rows.dtype).max)
    if mode == STORE:
        rows[...] = seen
    elif mode == SUBTRACT:
        rows -= seen
    elif mode == SATURATE:
        taken = np.minimum(seen, largest - rows)
        rows += taken
        return int((seen - taken).sum(dtype=np.intp)), False
    elif (seen > largest - rows).any():
        return 0, True
    else:
        rows += seen
    return 0, False


def _count_chunk(
    octets: NDArray[np.uint8], entries: NDArray[np.uint64], pixels: int, code_bits: int
) -> NDArray[np.uint16]:
    """Counts (pixel, code) of one chunk over all frames, at most `MOST_FRAMES`."""
    codes = 1 << code_bits
    offset = (entries & np.uint64(0xFFFF_FFFF)).astype(np.intp)
    hits = (entries >> np.uint64(HITS_SHIFT) & np.uint64(0xFFFF)).astype(np.intp)
    kind = (entries >> np.uint64(KIND_SHIFT)).astype(np.intp)
    dense, sparse = kind == int(ChunkKind.DENSE), kind == int(ChunkKind.BITMAP)
    payload = np.where(dense, dense_bytes(pixels, code_bits), 0)
    payload[sparse] = bitmap_bytes(pixels, hits[sparse], code_bits)
    if (
        (entries[~(dense | sparse)] != 0).any()
        or (hits > pixels).any()
        or (offset + payload + SLACK > octets.size)[dense | sparse].any()
    ):
        raise ValueError("count: a chunk lies outside the data")
    seen = np.zeros(pixels * codes, np.uint16)
    if dense.any():
        seen += _count_dense(octets, offset[dense], pixels, code_bits)
    if sparse.any():
        seen += _count_sparse(octets, offset[sparse], hits[sparse], pixels, code_bits)
    return seen.reshape(pixels, codes)


def _gather(octets: NDArray[np.uint8], offset: _Ints, size: int) -> NDArray[np.uint8]:
    """Bytes (frame, at least size) from each offset on; reads at most 7 bytes behind them."""
    anywhere = np.ndarray(octets.size - 7, "<u8", octets, strides=(1,))
    steps = np.arange(0, padded(size, 8), 8)
    return anywhere[offset[:, None] + steps].view(np.uint8)


def _count_dense(
    octets: NDArray[np.uint8], offset: _Ints, pixels: int, code_bits: int
) -> NDArray[np.uint16]:
    """Counts (pixel × code,) of dense payloads: eight codes are `code_bits` bytes."""
    codes, groups = 1 << code_bits, -(-pixels // 8)
    # a row more than there are frames: the last codes are read with some bytes behind them
    rows = np.zeros((len(offset) + 1, padded(groups * code_bits, 8)), np.uint8)
    rows[:-1] = _gather(octets, offset, groups * code_bits)
    index = np.empty((8, len(offset), groups), np.intp)
    base = np.arange(groups) * (8 * codes)
    for lane in range(8):
        byte, shift = divmod(lane * code_bits, 8)
        word = "<u2" if shift + code_bits <= 16 else "<u4"
        values = np.ndarray((len(offset), groups), word, rows, byte, (rows.shape[1], code_bits))
        np.add(values >> shift & (codes - 1), base + lane * codes, out=index[lane])
    counts = np.bincount(index.reshape(-1), minlength=groups * 8 * codes)
    return counts[: pixels * codes].astype(np.uint16)


def _count_sparse(
    octets: NDArray[np.uint8], offset: _Ints, hits: _Ints, pixels: int, code_bits: int
) -> NDArray[np.uint16]:
    """Counts (pixel × code,) of bitmap payloads."""
    codes, map_bytes = 1 << code_bits, -(-pixels // 8)
    bits = np.unpackbits(_gather(octets, offset, map_bytes), axis=1, bitorder="little")
    bits = np.ascontiguousarray(bits[:, :pixels])
    ones = np.count_nonzero(bits, axis=1)
    if (ones > hits).any():  # no more hits than the chunk's word says, whatever the bitmap says
        bits[np.cumsum(bits, axis=1, dtype=np.intp) > hits[:, None]] = 0
        ones = np.minimum(ones, hits)
    pixel = np.flatnonzero(bits)
    frame_start = np.repeat(np.arange(len(offset)) * pixels, ones)
    first = np.cumsum(ones) - ones
    place = np.arange(pixel.size) * code_bits
    place += np.repeat(8 * (offset + map_bytes) - first * code_bits, ones)
    anywhere = np.ndarray(octets.size - 3, "<u4", octets, strides=(1,))
    code = anywhere[place >> 3] >> (place & 7).astype(np.uint32) & np.uint32(codes - 1)
    index = (pixel - frame_start) * codes + code
    return np.bincount(index, minlength=pixels * codes).astype(np.uint16)
