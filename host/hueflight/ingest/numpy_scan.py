# SPDX-License-Identifier: Apache-2.0
"""Scanning in Python: reference implementation of ``_c/scan.h``, and fallback without a compiler.

`scan` finds packets by the rules of `hueflight_protocol.PacketParser`, with the two exceptions
that ``_c/scan.h`` states, and records where the chunks of each frame lie. On any input, the results
are bit-identical to those of the compiled kernel.
"""

from __future__ import annotations

import sys
from typing import Any

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from hueflight.backend import ingest
from hueflight.ingest.numpy_frame_scan import (
    HITS_SHIFT,
    KIND_SHIFT,
    ScannedFrames,
    chunk_words,
    scan_frames,
)
from hueflight_protocol import wire
from hueflight_protocol.wire import FRAME_HEADER, FRAME_TRAILER, PACKET_HEADER, PACKET_TRAILER

STATE = ingest.STATE.names
"""Names of the state and totals that scanning carries, in the order of the array `state`."""

MOST_FRAMES = ingest.MOST_FRAMES  # the largest value of the 16-bit counters of a tile


_PAD, _DENSE, _END = int(wire.ChunkKind.PAD), int(wire.ChunkKind.DENSE), int(wire.ChunkKind.END)
_FLAGS = ("masked", "roi", "gated", "saturated", "test_pattern", "simulated", "trigger_lost")
_WRAP = 1 << 32


class _MoreError(Exception):
    """The packet at hand is incomplete: it needs `needed` bytes."""

    def __init__(self, needed: int) -> None:
        self.needed = needed


class _HeaderError(Exception):
    """There is no valid packet header here."""


class _PacketError(Exception):
    """There is a valid header, but the packet breaks a rule."""


class _Stream:
    """A piece of the stream, accessible as bytes, and as words from any byte on."""

    def __init__(self, data: Any) -> None:
        self.octets = np.frombuffer(data, np.uint8)
        self.view = memoryview(data)
        self.size = len(self.view)
        self._words: dict[int, memoryview] = {}

    def words(self, at: int) -> tuple[memoryview, int]:
        """Return a view of little-endian words, and the index of the word at byte `at` in it."""
        phase = at % 4
        if phase not in self._words:
            octets = self.view[phase : phase + (self.size - phase) // 4 * 4]
            if sys.byteorder == "big":
                octets = memoryview(np.frombuffer(octets, "<u4").astype("=u4").tobytes())
            self._words[phase] = octets.cast("I")
        return self._words[phase], at // 4

    def find(self, pattern: bytes, at: int) -> int:
        """Return the first offset of `pattern` from `at` on, or of its first bytes at the end."""
        if self.view[at : at + len(pattern)] == pattern:
            return at
        step = 1 << 16  # in pieces, so that a search in a large buffer does not copy all of it
        while at < self.size:
            piece = bytes(self.view[at : at + step + len(pattern) - 1])
            found = piece.find(pattern)
            if found >= 0:
                return at + found
            if at + len(piece) >= self.size:
                cut = (n for n in range(len(pattern) - 1, 0, -1) if piece.endswith(pattern[:n]))
                return self.size - next(cut, 0)
            at += step
        return self.size

    def crc(self, start: int, stop: int) -> int:
        """Return the CRC-32C of the bytes from `start` to `stop`."""
        return google_crc32c.value(self.octets[start:stop])


def _header_bytes(stream: _Stream, at: int) -> int:
    """Check the header at `at` and return its size."""
    left = stream.size - at
    if left < 8:
        raise _MoreError(8)
    kind, size = stream.view[at + 5], int.from_bytes(stream.view[at + 6 : at + 8], "little")
    due = FRAME_HEADER.size if kind == wire.PacketType.FRAME else PACKET_HEADER.size
    known = 1 <= kind <= max(wire.PacketType)
    if (
        stream.view[at + 4] != wire.VERSION
        or (known and size != due)
        or size % wire.ALIGNMENT
        or not PACKET_HEADER.size <= size <= wire.MAX_HEADER_BYTES
    ):
        raise _HeaderError
    if left < size:
        raise _MoreError(size)
    words, first = stream.words(at)
    check = 0
    for word in words[first : first + size // 4]:
        check ^= word
    if check:
        raise _HeaderError
    return size


def _check_frame(head: dict[str, int]) -> None:
    pixels, run = head["rows"] * head["cols"], head["run"]
    if (
        head["length"] != wire.STREAMED
        or not 1 <= head["rows"] <= wire.MAX_ROWS
        or not 1 <= head["cols"] <= wire.MAX_COLS
        or not 1 <= head["code_bits"] <= wire.MAX_CODE_BITS
        or run % wire.RUN_MULTIPLE
        or not wire.MIN_RUN <= run <= wire.MAX_RUN
        or pixels > run * wire.MAX_CHUNKS
        or head["flags"] & ~sum(wire.FrameFlags)
    ):
        raise _PacketError


def _scan_frame(stream: _Stream, at: int, head: dict[str, int]) -> tuple[int, list[int], list[int]]:
    """Go through the chunks of the frame at `at`; return its size, chunk indices and entries."""
    _check_frame(head)
    pixels, run, code_bits = head["rows"] * head["cols"], head["run"], head["code_bits"]
    count = -(-pixels // run)
    inner, last = chunk_words(run, code_bits), chunk_words(pixels - (count - 1) * run, code_bits)
    words, first = stream.words(at)
    end = first + (stream.size - at) // 4
    place, total, previous = first + FRAME_HEADER.size // 4, 0, -1
    indices: list[int] = []
    entries: list[int] = []
    base = at - 4 * first
    while True:
        if place >= end:
            raise _MoreError(4 * (place - first) + 4)
        word = words[place]
        kind, index, hits = word & 3, word >> 2 & 0x3FFF, word >> 16
        if kind == _END:
            break
        if kind == _PAD:
            if word or (place - first) % 2 == 0:
                raise _PacketError
            if place + 1 >= end:
                raise _MoreError(4 * (place - first) + 8)
            if words[place + 1] & 3 != _END:
                raise _PacketError
            place += 1
            continue
        if not previous < index < count:
            raise _PacketError
        dense_from, lengths = inner if index < count - 1 else last
        if not 1 <= hits < len(lengths) or (hits >= dense_from) != (kind == _DENSE):
            raise _PacketError
        indices.append(index)
        entries.append(base + 4 * place + 4 | hits << HITS_SHIFT | kind << KIND_SHIFT)
        previous, total, place = index, total + hits, place + lengths[hits]
    size = 4 * (place - first) + FRAME_TRAILER.size
    if at + size > stream.size:
        raise _MoreError(size)
    word, announced, packet_words, crc = words[place : place + 4]
    if (
        (place - first) % 2
        or (word >> 2 & 0x3FFF) > 1
        or word >> 16 != len(indices)
        or announced != total
        or packet_words != size // 4
        or crc != stream.crc(at, at + size - 4)
    ):
        raise _PacketError
    return size, indices, entries


def _other_bytes(stream: _Stream, at: int, header: int) -> int:
    """Check the packet at `at`, which is not a frame, and return its size."""
    length = int.from_bytes(stream.view[at + 8 : at + 12], "little")
    if length > wire.MAX_BODY_BYTES:
        raise _PacketError
    body_end = at + header + length
    size = header + wire.padded(length, wire.ALIGNMENT) + PACKET_TRAILER.size
    if at + size > stream.size:
        raise _MoreError(size)
    trailer = PACKET_TRAILER.unpack(stream.view, at + size - PACKET_TRAILER.size)
    if (
        stream.octets[body_end : at + size - PACKET_TRAILER.size].any()
        or trailer["packet_words"] != size // 4
        or trailer["crc"] != stream.crc(at, at + size - 4)
    ):
        raise _PacketError
    return size


def _track_sequence(state: dict[str, int], sequence: int) -> bool:
    """Account for a sequence number; return False if the packet repeats the previous one."""
    gap = (sequence - state["sequence"] - 1) % _WRAP
    first, state["has_sequence"], state["sequence"] = not state["has_sequence"], 1, sequence
    if first:
        return True
    if gap == _WRAP - 1:
        state["repeated"] += 1
        return False
    if gap < _WRAP // 2:
        state["missing"] += gap
    else:
        state["restarts"] += 1
    return True


def _record_frame(state: dict[str, int], head: dict[str, int], aborted: bool, ours: bool) -> bool:
    """Account for the header of a frame; return whether its codes are to be counted."""
    capture, dropped = head["capture"], head["dropped"]
    if not state["has_dropped"]:
        state["dropped_before"] = dropped
    elif capture == state["capture"] and dropped >= state["last_dropped"]:
        state["dropped"] += dropped - state["last_dropped"]
    else:
        state["dropped"] += dropped
    state |= {"has_dropped": 1, "capture": capture, "last_dropped": dropped}
    if aborted:
        state["aborted"] += 1
        return False
    if not ours:
        state["foreign"] += 1
        for field, name in (("rows", "rows"), ("cols", "cols"), ("code_bits", "bits")):
            state[f"foreign_{name}"] = head[field]
        return False
    for bit, name in enumerate(_FLAGS):
        state[name] += head["flags"] >> bit & 1
    state["frames"] += 1
    return True


def scan(
    data: Any,
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
    """Find the packets of `data` from `start` on and fill the tables of frames.

    Parameters
    ----------
    data : bytes-like
        A piece of the stream, less than 4 GiB.
    start : int
        Offset in `data` at which scanning starts.
    final : bool
        Whether the stream ends with `data`. If so, a packet that the end cuts short is damaged.
    rows, cols, code_bits : int
        Geometry and code width. Frames that have them go to the tables, others are counted as
        foreign.
    frames : int
        Number of frames that the tables already hold.
    limit : int
        Number of frames in the tables at which scanning stops.
    run : int
        Run length of the frames in the tables (0 = none yet).
    state : numpy.ndarray, int64, shape (len(STATE),)
        State and totals; updated in place.
    chunks : numpy.ndarray, uint64
        Filled with an entry for each chunk, as an array (chunk, frame); 0 = no such chunk.
    headers : numpy.ndarray, uint8, shape (limit, 64)
        Filled with the headers of the frames.
    places : numpy.ndarray, uint64, shape (limit, 2)
        Filled with the offset and size of each frame.
    others : numpy.ndarray, uint64, shape (n, 2)
        Filled with the offset and size of each packet that is not a frame.

    Returns
    -------
    tuple
        The fields of `kernels.Scanned`.
    """
    stream = _Stream(data)
    totals = dict(zip(STATE, state.tolist(), strict=True))
    pixels, at, found_others = rows * cols, start, 0
    stride = chunks.size // -(-pixels // run) if run else 0

    def result(needed: int, ended: bool) -> tuple[int, int, int, int, int, int, bool]:
        state[:] = list(totals.values())
        return at, frames, found_others, run, stride, needed, ended

    wait, pause = 0, 1  # packets until `scan_frames` is tried again, and how many next time
    while not (frames and frames in (limit, stride)) and found_others < len(others):
        if wait == 0 and frames and stream.size - at >= 4 * int(places[frames - 1, 1]):
            scanned = scan_frames(
                stream.octets, at, rows=rows, cols=cols, code_bits=code_bits, run=run,
                most=min(limit, stride) - frames,
            )  # fmt: skip
            taken = _record_frames(
                totals, scanned, at, frames, chunks, headers, places, pixels, run
            )
            at, frames = at + int(scanned.sizes.sum()), frames + taken
            wait, pause = (1, 1) if taken else (pause, min(2 * pause, 64))
            continue
        wait = max(wait - 1, 0)
        found = stream.find(wire.MAGIC, at)
        if found > at:
            totals["skipped_bytes"] += found - at
            totals["in_step"] = 0
            at = found
        if stream.size - at < len(wire.MAGIC):
            if final:
                totals["skipped_bytes"] += stream.size - at
                totals["in_step"] = 1
                at = stream.size
            return result(8, True)
        head: dict[str, int] = {}
        ours = False
        indices: list[int] = []
        entries: list[int] = []
        try:
            size = _header_bytes(stream, at)
            if stream.view[at + 5] == wire.PacketType.FRAME:
                head = FRAME_HEADER.unpack(stream.view, at)
                here = head["run"]
                ours = (head["rows"], head["cols"], head["code_bits"]) == (rows, cols, code_bits)
                ours &= here > 0 and here % 8 == 0 and -(-pixels // max(here, 1)) <= chunks.size
                if ours and here != run:
                    if frames:
                        return result(0, False)
                    run, stride = here, chunks.size // -(-pixels // here)
                size, indices, entries = _scan_frame(stream, at, head)
            else:
                size = _other_bytes(stream, at, size)
        except (_MoreError, _HeaderError, _PacketError) as trouble:
            if isinstance(trouble, _MoreError) and not final:
                return result(trouble.needed, True)
            # where no packet is expected, a magic number with an invalid header is data
            totals["damaged"] += bool(totals["in_step"]) or not isinstance(trouble, _HeaderError)
            totals["skipped_bytes"] += 1
            totals["in_step"] = 0
            at += 1
            continue
        totals["in_step"] = 1
        totals["packets"] += 1
        sequence = int.from_bytes(stream.view[at + 12 : at + 16], "little")
        if _track_sequence(totals, sequence):
            if not head:
                others[found_others] = at, size
                found_others += 1
            elif _record_frame(totals, head, _is_aborted(stream, at + size), ours):
                trailer = FRAME_TRAILER.unpack(stream.view, at + size - FRAME_TRAILER.size)
                totals["hits"] += trailer["hits"]
                table = chunks[: stride * -(-pixels // run)].reshape(-1, stride)
                table[:, frames] = 0
                table[indices, frames] = np.array(entries, np.uint64)
                headers[frames] = stream.octets[at : at + FRAME_HEADER.size]
                places[frames] = at, size
                frames += 1
        at += size
    return result(0, False)


def _record_frames(
    totals: dict[str, int],
    scanned: ScannedFrames,
    at: int,
    frames: int,
    chunks: NDArray[np.uint64],
    headers: NDArray[np.uint8],
    places: NDArray[np.uint64],
    pixels: int,
    run: int,
) -> int:
    """Account for frames scanned together and append them to the tables; return their number."""
    fields = scanned.headers.reshape(-1).view(FRAME_HEADER.dtype)
    names = ("sequence", "capture", "dropped", "flags")
    heads = zip(*(fields[name].tolist() for name in names), strict=True)
    kept: list[int] = []
    for i, values in enumerate(heads):
        head: dict[str, int] = dict(zip(names, values, strict=True))
        totals["packets"] += 1
        if _track_sequence(totals, head["sequence"]) and _record_frame(totals, head, False, True):
            kept.append(i)
    totals["in_step"] = 1 if len(fields) else totals["in_step"]
    totals["hits"] += int(scanned.hits[kept].sum())
    count = -(-pixels // run)
    table = chunks[: chunks.size // count * count].reshape(count, -1)
    places_now = slice(frames, frames + len(kept))
    table[:, places_now] = scanned.entries[:, kept]
    headers[places_now] = scanned.headers[kept]
    starts = at + np.cumsum(scanned.sizes) - scanned.sizes
    places[places_now, 0], places[places_now, 1] = starts[kept], scanned.sizes[kept]
    return len(kept)


def _is_aborted(stream: _Stream, end: int) -> bool:
    return bool(stream.view[end - FRAME_TRAILER.size] >> 2 & 1)
