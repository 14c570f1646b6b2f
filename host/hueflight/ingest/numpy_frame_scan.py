# SPDX-License-Identifier: Apache-2.0
"""Scanning of many frames at once, which `numpy_scan.scan` uses where there is no damage.

The chunks of one frame have to be visited one after the other, but many frames can be processed
together, since their headers are easy to find. Everything unusual is left to `numpy_scan.scan`,
which knows all rules: a frame is accepted only if it obeys every rule and the next one begins where
it ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from hueflight.backend.ingest import HITS_SHIFT, KIND_SHIFT
from hueflight_protocol import wire
from hueflight_protocol.wire import FRAME_HEADER, FRAME_TRAILER

BATCH = 512  # frames scanned together, few enough that their bytes may still be in a cache
_START = int.from_bytes(wire.MAGIC, "little") | (
    wire.VERSION << 32 | int(wire.PacketType.FRAME) << 40 | FRAME_HEADER.size << 48
)  # the first eight bytes of a frame
_HEADER_WORDS, _TRAILER_WORDS = FRAME_HEADER.size // 4, FRAME_TRAILER.size // 4
_DENSE, _END = int(wire.ChunkKind.DENSE), int(wire.ChunkKind.END)

_Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class ScannedFrames:
    """Complete frames that follow one another.

    Attributes
    ----------
    sizes : numpy.ndarray, int64, shape (frame,)
        Size of each frame in bytes.
    hits : numpy.ndarray, int64, shape (frame,)
        Number of hits in each frame.
    headers : numpy.ndarray, uint8, shape (frame, 64)
        Headers of the frames.
    entries : numpy.ndarray, uint64, shape (chunk, frame)
        Entries for the table of chunks.
    """

    sizes: _Ints
    hits: _Ints
    headers: NDArray[np.uint8]
    entries: NDArray[np.uint64]


def bitmap_bytes(pixels: int, hits: _Ints, code_bits: int, /) -> _Ints:
    """Return the payload bytes of bitmap chunks of `pixels` pixels, with padding (rule F10)."""
    return -(-(-(-pixels // 8) - (-hits * code_bits // 8)) // 4) * 4


@lru_cache(maxsize=256)
def chunk_words(pixels: int, code_bits: int, /) -> tuple[int, list[int]]:
    """Return the hits from which a chunk is dense, and its words for every number of hits."""
    dense_from = wire.dense_from(pixels, code_bits)
    dense = 1 + wire.dense_bytes(pixels, code_bits) // 4
    bitmaps = 1 + bitmap_bytes(pixels, np.arange(dense_from), code_bits) // 4
    return dense_from, bitmaps.tolist() + [dense] * (pixels + 1 - dense_from)


def scan_frames(
    octets: NDArray[np.uint8],
    at: int,
    /,
    *,
    rows: int,
    cols: int,
    code_bits: int,
    run: int,
    most: int,
) -> ScannedFrames:
    """Scan complete frames of one geometry from byte `at` on, up to the first other packet."""
    pixels = rows * cols
    count = -(-pixels // run)
    dense = wire.dense_bytes(run, code_bits) + 4
    longest = FRAME_HEADER.size + count * dense + 8 + FRAME_TRAILER.size
    block = octets[at : at + min(most, BATCH) * longest]
    block = block[: len(block) // 8 * 8]
    words = block.view("<u4")
    starts = 2 * np.flatnonzero(block.view("<u8") == _START)[: min(most, BATCH) + 1]
    ends = np.append(starts[1:], len(words))
    starts, ends = starts[:most], ends[:most]
    whole = ends - starts >= _HEADER_WORDS + _TRAILER_WORDS
    starts, ends = starts[whole], ends[whole]
    if not starts.size or starts[0]:
        return _accepted(block, starts[:0], starts[:0], starts[:0], np.zeros((count, 0), np.uint64))
    good = _good_headers(
        words[starts[:, None] + np.arange(_HEADER_WORDS)], rows, cols, code_bits, run
    )
    place, entries, total = _scan_chunks(words, starts, ends, good, pixels, run, code_bits)
    sizes = 4 * (place + _TRAILER_WORDS - starts) * good
    good[1:] &= starts[:-1] + sizes[:-1] // 4 == starts[1:]
    frames = int(good.argmin()) if not good.all() else len(good)
    for i in range(frames):
        start, stop = 4 * int(starts[i]), 4 * int(starts[i]) + int(sizes[i])
        if google_crc32c.value(block[start : stop - 4]) != words[stop // 4 - 1]:
            frames = i
            break
    there = entries[:, :frames]
    there[there != 0] += np.uint64(at)
    return _accepted(block, starts[:frames], sizes[:frames], total[:frames], there)


def _accepted(
    block: NDArray[np.uint8],
    starts: _Ints,
    sizes: _Ints,
    hits: _Ints,
    entries: NDArray[np.uint64],
) -> ScannedFrames:
    headers = block[4 * starts[:, None] + np.arange(FRAME_HEADER.size)]
    return ScannedFrames(sizes, hits, headers, entries)


def _good_headers(
    headers: NDArray[np.uint32], rows: int, cols: int, code_bits: int, run: int
) -> NDArray[np.bool_]:
    """Return which headers (frame, word) are valid and of this geometry."""
    fields = np.ascontiguousarray(headers).view(FRAME_HEADER.dtype)[:, 0]
    return (
        (np.bitwise_xor.reduce(headers, axis=1) == 0)
        & (fields["length"] == wire.STREAMED)
        & (fields["rows"] == rows)
        & (fields["cols"] == cols)
        & (fields["code_bits"] == code_bits)
        & (fields["run"] == run)
        & (fields["flags"] & ~np.uint16(sum(wire.FrameFlags)) == 0)
    )


@lru_cache(maxsize=16)
def _lengths(pixels: int, run: int, code_bits: int) -> tuple[_Ints, _Ints]:
    """Return the hits from which chunks are dense, and words by hits, for inner and last chunks."""
    last = pixels - (-(-pixels // run) - 1) * run
    of_inner, of_last = chunk_words(run, code_bits), chunk_words(last, code_bits)
    lengths = np.zeros((2, 1 << 16), np.int64)  # 0: an impossible number of hits
    lengths[0, 1 : run + 1], lengths[1, 1 : last + 1] = of_inner[1][1:], of_last[1][1:]
    return np.array([of_inner[0], of_last[0]]), lengths


def _scan_chunks(
    words: NDArray[np.uint32],
    starts: _Ints,
    ends: _Ints,
    good: NDArray[np.bool_],
    pixels: int,
    run: int,
    code_bits: int,
) -> tuple[_Ints, NDArray[np.uint64], _Ints]:
    """Return places of trailers, entries of chunks, and hits; clear `good` for invalid frames."""
    count, frames = -(-pixels // run), len(starts)
    dense_from, lengths = _lengths(pixels, run, code_bits)
    entries = np.zeros((count, frames), np.uint64)
    place = starts + _HEADER_WORDS
    previous, found, total = np.full(frames, -1), np.zeros(frames, int), np.zeros(frames, int)
    going = np.flatnonzero(good)
    while going.size:
        at = place[going]
        word = words[np.minimum(at, len(words) - 1)].astype(np.int64)
        inside = at + _TRAILER_WORDS <= ends[going]
        pad = inside & (word == 0) & (at - starts[going] & 1 == 1)
        kind, index, hits = word & 3, word >> 2 & 0x3FFF, word >> 16
        last = (index == count - 1).astype(np.int64)
        length = lengths[last, hits]
        chunk = (
            inside
            & (length > 0)
            & (previous[going] < index)
            & (index < count)
            & (kind == np.where(hits >= dense_from[last], _DENSE, int(wire.ChunkKind.BITMAP)))
        )
        good[going] = chunk | pad | inside & (kind == _END)
        place[going[pad]] += 1  # the next word must be the end; a chunk would not be aligned there
        going, at, index, hits, kind = (x[chunk] for x in (going, at, index, hits, kind))
        entries[index, going] = 4 * at + 4 | hits << HITS_SHIFT | kind << KIND_SHIFT
        previous[going] = index
        found[going] += 1
        total[going] += hits
        place[going] += length[chunk]
    trailer = words[np.minimum(place[:, None] + np.arange(_TRAILER_WORDS), len(words) - 1)]
    good &= (
        (place + _TRAILER_WORDS <= ends)
        & ((place - starts) % 2 == 0)
        & (trailer[:, 0] == (found << 16 | _END))  # not aborted
        & (trailer[:, 1] == total)
        & (trailer[:, 2] == place + _TRAILER_WORDS - starts)
    )
    return place, entries, total
