# SPDX-License-Identifier: Apache-2.0
"""Counting in NumPy: reference implementation of ``_c/count.h``, and fallback without a compiler.

The payloads that all frames have for a chunk are counted together, so that each NumPy call does
much work and the counters of the chunk's pixels stay in the cache.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.ingest import ADD, MOST_FRAMES, STORE, SUBTRACT, TILE
from hueflight.ingest.numpy_frame_scan import HITS_SHIFT, KIND_SHIFT, bitmap_bytes
from hueflight_protocol.wire import ChunkKind, dense_bytes

SLACK = 8  # bytes that may be read past a payload: the trailer of its packet is longer
AT_ONCE = 1 << 18  # pixels whose bitmaps are unpacked at once: a few MB, and few calls

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
    """Add the codes of frames to histograms.

    Parameters
    ----------
    data : bytes-like
        The piece of the stream that was scanned.
    chunks : numpy.ndarray, uint64
        Entries that `scan` wrote, as an array (chunk, stride).
    stride : int
        Number of frames per chunk in `chunks`.
    chosen : numpy.ndarray, uint32, shape (frame,)
        Indices of the frames to count, at most `MOST_FRAMES`.
    pixels, code_bits, run : int
        Geometry of the frames.
    out : numpy.ndarray, uint16 or (if `wide`) uint32, of ``pixels << code_bits`` elements
        Counts (pixel, code), updated in place. Code 0 receives every frame that has no other code
        for a pixel.
    wide : bool
        Whether `out` has 32 bits.
    mode : int
        ADD to `out`, but leave out the tiles in which a counter would overflow; STORE replaces the
        content of `out`; SATURATE adds up to the largest count; SUBTRACT undoes ADD.
    done : numpy.ndarray, uint8, an element for each tile
        Marks of the tiles that have been added, updated in place. Only unmarked tiles are added,
        only marked ones are subtracted.
    begin, end : int
        Range of chunks of the sensor to work on.

    Returns
    -------
    tuple of int
        Photons, clipped counts, and the number of tiles that were left out.
    """
    octets = np.frombuffer(data, np.uint8)
    if chosen.size > MOST_FRAMES:
        raise ValueError("count: chosen frames out of range")
    codes = 1 << code_bits
    entries = chunks[: stride * -(-pixels // run)].reshape(-1, stride)
    table = out.reshape(-1)[: pixels * codes].reshape(pixels, codes)
    marks = done.reshape(-1)[: -(-run // TILE) * len(entries)].reshape(len(entries), -1)
    photons = clipped = left = 0
    space = np.empty((3, chosen.size * (min(run, pixels) // 8)), np.uint64)
    for chunk in range(begin, end):
        first = chunk * run
        size = min(run, pixels - first)
        seen = _count_chunk(octets, entries[chunk, chosen], size, code_bits, space)
        here = seen[:, 1:].sum(axis=1, dtype=np.uint16)  # exact: no more than frames
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
            photons += int(here[part].sum(dtype=np.intp))
    return photons, clipped, left


def _put(
    rows: NDArray[np.unsignedinteger[Any]], seen: NDArray[np.uint16], mode: int
) -> tuple[int, bool]:
    """Add to rows of the table; return the clipped counts and whether a counter would overflow."""
    if mode == STORE:
        rows[...] = seen
    elif mode == SUBTRACT:
        rows -= seen
    else:
        rows += seen
        if (rows < seen).any():
            rows -= seen
            if mode == ADD:
                return 0, True
            taken = np.minimum(seen, rows.dtype.type(np.iinfo(rows.dtype).max) - rows)
            rows += taken
            return int((seen - taken).sum(dtype=np.intp)), False
    return 0, False


def _count_chunk(
    octets: NDArray[np.uint8],
    entries: NDArray[np.uint64],
    pixels: int,
    code_bits: int,
    space: NDArray[np.uint64],
) -> NDArray[np.uint16]:
    """Count one chunk over all frames, as (pixel, code); of code 0, only those that were sent."""
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
    spare = 8 + -pixels % 8  # see `_locate`
    counts = np.zeros((pixels + spare, 1 << code_bits), np.uint16)
    seen = counts[:pixels]
    if dense.any():
        _count_dense(octets, offset[dense], code_bits, seen, space)
    if sparse.any():
        _count_sparse(octets, offset[sparse], hits[sparse], code_bits, pixels, counts)
    return seen


def _words(octets: NDArray[np.uint8], size: int) -> NDArray[np.unsignedinteger[Any]]:
    """Return a view of the little-endian words of `size` bytes that begin at each byte."""
    return np.ndarray(octets.size - size + 1, f"<u{size}", octets, strides=(1,))


def _count_dense(
    octets: NDArray[np.uint8],
    offset: _Ints,
    code_bits: int,
    seen: NDArray[np.uint16],
    space: NDArray[np.uint64],
) -> None:
    """Add dense payloads, in which eight codes take `code_bits` bytes.

    A code that is not complete in the 64-bit word at their start is complete in the one at their
    end.
    """
    pixels, codes = seen.shape
    groups, mask = pixels // 8, np.uint64(codes - 1)
    behind = max(code_bits - 8, 0)
    if groups:
        heads, tails, index = (part[: len(offset) * groups].reshape(-1, groups) for part in space)
        _load(octets, offset, code_bits, heads)
        _load(octets, offset + behind, code_bits, tails)
        base = np.arange(groups, dtype=np.uint64) * np.uint64(8 * codes)
        for lane in range(8):
            whole = (lane + 1) * code_bits <= 64
            shift = lane * code_bits - (0 if whole else 8 * behind)
            np.right_shift(heads if whole else tails, np.uint64(shift), out=index)
            np.bitwise_and(index, mask, out=index)
            np.add(index, base, out=index)
            np.add.at(seen[lane:].reshape(-1), index.reshape(-1).view(np.int64), np.uint16(1))
    for pixel in range(8 * groups, pixels):
        byte, shift = divmod(pixel * code_bits, 8)
        values = _words(octets, 4)[offset + byte] >> np.uint32(shift) & np.uint32(codes - 1)
        np.add.at(seen[pixel], values, np.uint16(1))


def _load(octets: NDArray[np.uint8], offset: _Ints, step: int, words: NDArray[np.uint64]) -> None:
    """Fill `words` (frame, group) with words at every `step` bytes from each offset on."""
    apart = np.diff(offset)
    if apart.size and (apart == apart[0]).all() and apart[0] > 0:  # frames of the same length
        strides = (int(apart[0]), step)
        words[...] = np.ndarray(words.shape, "<u8", octets, int(offset[0]), strides)
    else:
        words[...] = _words(octets, 8)[offset[:, None] + np.arange(words.shape[1]) * step]


def _count_sparse(
    octets: NDArray[np.uint8],
    offset: _Ints,
    hits: _Ints,
    code_bits: int,
    pixels: int,
    counts: NDArray[np.uint16],
) -> None:
    """Add bitmap payloads."""
    map_bytes = -(-pixels // 8)
    together = max(1, AT_ONCE // pixels)
    for at in range(0, len(offset), together):
        some = slice(at, at + together)
        index = _locate(octets, offset[some], hits[some], map_bytes, pixels, code_bits)
        np.add.at(counts.reshape(-1), index, np.uint16(1))


def _locate(
    octets: NDArray[np.uint8],
    offset: _Ints,
    hits: _Ints,
    map_bytes: int,
    pixels: int,
    code_bits: int,
) -> _Ints:
    """Return the indices of the counters (pixel × code) that the hits of some frames belong to.

    Eight codes take `code_bits` bytes, as in dense payloads. To pad the hits of a frame to a
    multiple of eight, its bitmap is extended by one byte with a one for each missing hit.
    """
    groups = -(-hits // 8)
    most = int(groups.max())
    size = map_bytes + most * code_bits + 8  # of the longest payload, and some bytes after it
    if int(offset.max()) + size > octets.size:
        return _locate_each(octets, offset, hits, map_bytes, pixels, code_bits)
    rows = np.ndarray(octets.size - size + 1, f"V{size}", octets, strides=(1,))[offset]
    payloads = rows.view(np.uint8).reshape(-1, size)
    maps = payloads[:, : map_bytes + 1].copy()
    maps[:, map_bytes - 1] &= 0xFF >> -pixels % 8
    maps[:, map_bytes] = 0xFF >> 8 - -hits % 8
    if (np.bitwise_count(maps).sum(axis=1, dtype=np.intp) != 8 * groups).any():
        return _locate_each(octets, offset, hits, map_bytes, pixels, code_bits)

    there = np.arange(most) < groups[:, None]
    behind = max(code_bits - 8, 0)
    heads, tails = (
        np.ascontiguousarray(
            np.ndarray(there.shape, "<u8", payloads, map_bytes + skip, (size, code_bits))
        )[there]
        for skip in (0, behind)
    )
    lanes = np.arange(8, dtype=np.uint64)[:, None] * np.uint64(code_bits)
    whole = min(8, 64 // code_bits)  # codes that the first word holds
    index = np.empty((8, heads.size), np.uint64)
    np.right_shift(heads, lanes[:whole], out=index[:whole])
    np.right_shift(tails, lanes[whole:] - np.uint64(8 * behind), out=index[whole:])
    index &= np.uint64((1 << code_bits) - 1)
    base = np.arange(len(maps), dtype=np.uint64) * np.uint64(8 * maps.shape[1] << code_bits)
    index -= np.repeat(base, groups)
    pixel = np.flatnonzero(np.unpackbits(maps, bitorder="little").view(np.bool_)).view(np.uint64)
    pixel <<= np.uint64(code_bits)
    index += pixel.reshape(-1, 8).T
    return index.reshape(-1).view(np.intp)


def _locate_each(
    octets: NDArray[np.uint8],
    offset: _Ints,
    hits: _Ints,
    map_bytes: int,
    pixels: int,
    code_bits: int,
) -> _Ints:
    """Do the same as `_locate` for frames with contradictory bitmaps or at the end of the data."""
    maps = octets[offset[:, None] + np.arange(map_bytes)]
    bits = np.unpackbits(maps, axis=1, bitorder="little", count=pixels)
    ones = bits.sum(axis=1, dtype=np.intp)
    if (ones > hits).any():  # no more hits than the chunk word announces, whatever the bitmap holds
        bits[np.cumsum(bits, axis=1, dtype=np.intp) > hits[:, None]] = 0
        ones = np.minimum(ones, hits)
    pixel = np.flatnonzero(bits.view(np.bool_))
    if pixels & (pixels - 1):
        pixel -= np.repeat(np.arange(len(offset)) * pixels, ones)
    else:
        pixel &= pixels - 1
    first = np.cumsum(ones) - ones
    place = np.arange(pixel.size) * code_bits
    place += np.repeat(8 * (offset + map_bytes) - first * code_bits, ones)
    words = _words(octets, 4)[place >> 3]
    words >>= (place & 7).astype(np.uint32)
    words &= np.uint32((1 << code_bits) - 1)
    pixel <<= code_bits
    pixel += words
    return pixel
