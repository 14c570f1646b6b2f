# SPDX-License-Identifier: Apache-2.0
"""Live streams: pieces of any size, blocks, sliding windows, histograms by step."""

import tracemalloc
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hueflight.errors import IngestError
from hueflight.ingest import HistogramStream, accumulate
from hueflight.ingest.buffer import LEAST_BYTES, PacketBuffer, pieces
from hueflight.ingest.kernels import Kernels, choose
from hueflight.ingest.sliding_sum import SlidingSum
from hueflight_protocol import (
    Event,
    PacketHeader,
    decode_packet,
    encode_event,
    encode_frame,
)

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def busy(small: Make, random_codes: Make) -> tuple[Any, np.ndarray, bytes]:
    """Forty frames of three steps with other packets, junk and damage between them."""
    rng = np.random.default_rng(11)
    codes = random_codes(rng, (40, 8, 8), code_bits=9, occupancy=0.4)
    stream = b""
    for i, frame in enumerate(codes):
        stream += encode_frame(frame, sequence=2 * i, frame=i, timestamp=10 * i, step=i % 3)
        if i % 5 == 0:
            stream += encode_event(Event(PacketHeader(sequence=2 * i + 1), code=5, value=i))
        if i % 7 == 0:
            stream += b"junk\xa7Hu" + rng.bytes(9)
        if i % 11 == 0:
            stream += encode_frame(frame, sequence=2 * i + 1, frame=i, timestamp=0)[:-5]
    return small(), codes, stream


@pytest.mark.parametrize("size", [1, 3, 64, 1000, 1 << 20])
def test_pieces_of_any_size_give_the_same(size: int, busy: Any, kernels: Kernels) -> None:
    instrument, _, data = busy
    whole, report = accumulate(data, instrument, kernels=kernels)
    live = HistogramStream(instrument, kernels=kernels)
    for at in range(0, len(data), size):
        assert live.feed(data[at : at + size]) == []
    (block,) = live.finish()
    np.testing.assert_array_equal(block.histogram, whole)
    assert block.report == live.report == report
    assert live.pending_bytes == 0


@settings(max_examples=40)
@given(cuts=st.lists(st.integers(0, 1 << 16), max_size=30), block=st.integers(1, 50))
def test_blocks_of_frames(cuts: list[int], block: int, busy: Any) -> None:
    instrument, codes, data = busy
    live = HistogramStream(instrument, block_frames=block)
    blocks = []
    places = sorted({0, len(data), *(cut % len(data) for cut in cuts)})
    for start, stop in pairwise(places):
        blocks += live.feed(data[start:stop])
    blocks += live.finish()
    assert [b.frames for b in blocks] == [min(block, 40 - at) for at in range(0, 40, block)]
    for number, got in enumerate(blocks):
        part = slice(number * block, (number + 1) * block)
        expected = np.zeros_like(got.histogram)
        row, col = np.indices((8, 8))
        for frame in codes[part]:
            expected[row, col, frame] += 1
        np.testing.assert_array_equal(got.histogram, expected)
        numbers = range(40)[part]
        assert (got.first_frame, got.last_frame) == (numbers[0], numbers[-1])
        assert (got.first_tick, got.last_tick) == (10 * numbers[0], 10 * numbers[-1])
    assert live.report == accumulate(data, instrument)[1]


def test_sliding_window_is_the_sum_of_its_blocks(busy: Any) -> None:
    instrument, _, data = busy
    blocks = HistogramStream(instrument, block_frames=6).feed(data)
    live = HistogramStream(instrument, block_frames=6, window_blocks=3)
    windows = live.feed(data)
    assert len(windows) == len(blocks) == 6
    for i, window in enumerate(windows):
        parts = blocks[max(0, i - 2) : i + 1]
        expected = sum(part.histogram.astype(int) for part in parts)
        np.testing.assert_array_equal(window.histogram, expected)
        assert window.frames == sum(part.frames for part in parts)
        assert (window.first_frame, window.last_frame) == (
            parts[0].first_frame, parts[-1].last_frame,
        )  # fmt: skip


def test_several_histograms_at_once(busy: Any, counted: Make) -> None:
    instrument, codes, data = busy
    live = HistogramStream(instrument, block_frames=20, by_step=True)
    first, second = live.feed(data)
    for number, block in enumerate((first, second)):
        assert list(block.counts) == [0, 1, 2]
        for step, counts in block.counts.items():
            chosen = [i for i in range(20 * number, 20 * number + 20) if i % 3 == step]
            np.testing.assert_array_equal(counts, counted(codes[chosen], 9))


def test_windows_forget_steps_that_are_over(small: Make) -> None:
    frames = [
        encode_frame(np.full((8, 8), 5, np.uint16), sequence=i, frame=i, timestamp=i, step=i // 2)
        for i in range(6)
    ]
    live = HistogramStream(small(), block_frames=2, window_blocks=2, by_step=True)
    windows = live.feed(b"".join(frames))
    assert [list(window.counts) for window in windows] == [[0], [0, 1], [1, 2]]
    assert all(
        (counts[..., 5] == 2).all() for window in windows for counts in window.counts.values()
    )


def test_other_packets_are_handed_on(busy: Any) -> None:
    instrument, _, data = busy
    live = HistogramStream(instrument)
    live.feed(data)
    events = [decode_packet(packet) for packet in live.take_others()]
    assert [event.value for event in events if isinstance(event, Event)] == list(range(0, 40, 5))
    assert live.take_others() == []


def test_many_other_packets_between_frames(small: Make) -> None:
    packets = [encode_event(Event(PacketHeader(sequence=i), code=3)) for i in range(200)]
    packets.insert(100, encode_frame(np.ones((8, 8), int), sequence=500, frame=0, timestamp=0))
    live = HistogramStream(small(), block_frames=1)
    (block,) = live.feed(b"".join(packets))
    assert block.frames == 1
    assert len(live.take_others()) == 200


def test_received_in_place(busy: Any) -> None:
    instrument, _, data = busy
    live = HistogramStream(instrument, block_frames=40)
    at, blocks = 0, []
    while at < len(data):
        space = live.writable()
        part = data[at : at + min(len(space), 777)]
        space[: len(part)] = part
        blocks += live.commit(len(part))
        at += len(part)
    assert len(blocks) == 1
    with pytest.raises(IngestError, match="must be from 0 to"):
        live.commit(1 << 40)


def test_given_back_memory_serves_again(small: Make, random_codes: Make, stream: Make) -> None:
    codes = random_codes(np.random.default_rng(2), (6, 8, 8), code_bits=9, occupancy=0.5)
    live = HistogramStream(small(), block_frames=2)
    first, second, _ = live.feed(stream(codes))
    memory, expected = first.histogram, second.histogram.copy()
    live.recycle(first)
    (block,) = live.feed(stream(codes[2:4], sequence=9, frame=9) + stream(codes[3:4], sequence=10))
    assert block.histogram is memory
    np.testing.assert_array_equal(block.histogram, expected)


def test_memory_does_not_grow_with_the_stream(busy: Any) -> None:
    instrument, _, data = busy
    live = HistogramStream(instrument, block_frames=50, buffer_bytes=LEAST_BYTES)
    tracemalloc.start()
    try:
        sizes = []
        for _ in range(12):  # 1 MB of stream each
            for _ in range(1_000_000 // len(data)):
                live.feed(data)
            live.take_others()
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert max(sizes[4:]) - sizes[3] < 100_000


def test_stream_of_the_largest_packets(small: Make) -> None:
    """1024 × 1024 codes of 16 bits: each packet is half the smallest buffer."""
    instrument = small(
        rows=1024, cols=1024, code_bits=16, direction="forward", code_zero="no photon"
    )
    codes = np.full((1024, 1024), 1, np.uint16)
    packet = encode_frame(codes, sequence=0, frame=0, timestamp=0, code_bits=16)
    holder = PacketBuffer(instrument.sensor, choose(), capacity=LEAST_BYTES)
    seen = 0
    for _ in range(3):
        for _ in pieces(holder, packet):
            holder.scan(limit=100)
            seen += holder.scanner.frames
            holder.release()
    assert holder.scanner.total("packets") == 3
    assert seen == 1  # the others have the same sequence number: repeated
    assert holder.scanner.total("repeated") == 2


def test_pieces_that_come_together_are_scanned_when_the_buffer_is_full_and_at_the_end(
    small: Make,
) -> None:
    instrument = small()
    shape = instrument.image_shape
    packets = [
        encode_frame(np.zeros(shape, int), sequence=n, frame=n, timestamp=n) for n in range(9)
    ]
    stream = b"".join(packets)
    cuts = [stream[:5], b"", stream[5:70], stream[70:]]
    holder, copied = PacketBuffer(instrument.sensor, choose()), []
    for size in pieces(holder, *cuts):
        copied.append(size)
        holder.scan(limit=100)
    assert (copied, holder.scanner.frames) == ([len(stream)], 9)

    filler = bytes(LEAST_BYTES - len(stream) + 30)  # no packets, and more than there is room for
    holder, copied = PacketBuffer(instrument.sensor, choose(), capacity=LEAST_BYTES), []
    for size in pieces(holder, filler, *cuts):
        copied.append(size)
        holder.scan(limit=100)
        holder.release()
    assert copied == [LEAST_BYTES, 30]
    assert holder.scanner.total("packets") == 9
    assert holder.scanner.total("skipped_bytes") == len(filler)
    assert list(pieces(holder, b"", b"")) == []


@pytest.mark.parametrize("by_step", [False, True])
def test_a_stream_without_frames(by_step: bool, small: Make) -> None:
    """One histogram of nothing, or none where each step has its own."""
    live = HistogramStream(small(), by_step=by_step)
    live.feed(encode_event(Event(PacketHeader(sequence=0), code=5)))
    (block,) = live.finish()
    assert (block.frames, list(block.counts)) == (0, [] if by_step else [0])
    assert not any(counts.any() for counts in block.counts.values())


def test_a_sliding_sum_takes_wider_counters_when_it_needs_them() -> None:
    sliding = SlidingSum(3)
    expected, types = [], []
    for number, frames in enumerate((40_000, 20_000, 30_000, 10_000, 5_000)):
        sliding.add({0: np.full((2, 2, 4), frames, np.uint16)}, frames)
        expected.append(frames)
        assert (sliding.sums[0] == sum(expected[-3:])).all(), number
        types.append(sliding.sums[0].dtype)
    assert types == [np.uint16, np.uint16, np.uint32, np.uint16, np.uint16]


def test_options_that_make_no_sense(small: Make) -> None:
    for options, message in (
        ({"block_frames": 0}, "block_frames = 0"),
        ({"window_blocks": 2}, "needs block_frames"),
        ({"window_blocks": 0}, "window_blocks = 0"),
        ({"threads": 0}, "threads = 0"),
        ({"buffer_bytes": 1000}, "a buffer of 1000 bytes"),
    ):
        with pytest.raises(IngestError, match=message):
            HistogramStream(small(), **options)
