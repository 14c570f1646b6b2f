# SPDX-License-Identifier: Apache-2.0
"""The parser's bookkeeping and its bounds; damage has a file of its own."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight_protocol as hp


def frame(sequence: int, **options) -> bytes:
    rng = np.random.default_rng(sequence)
    codes = rng.integers(0, 512, (16, 32)) * (rng.random((16, 32)) < 0.3)
    numbers = {"frame": sequence, "timestamp": 100 * sequence, "run": 128} | options
    return hp.encode_frame(codes, sequence=sequence, **numbers)


def mixed_stream() -> tuple[bytes, int]:
    header = hp.PacketHeader(sequence=1, timestamp=5, capture=9)
    packets = [
        frame(0),
        hp.encode_event(hp.Event(header, hp.EventCode.TRIGGER_LOST, hp.EventLevel.WARNING, 2, -3)),
        frame(2),
        frame(3, abort_at=2),
        hp.encode_status(hp.Status(hp.PacketHeader(sequence=4), frames_sent=4)),
        hp.encode_packet(6, b"x" * 77, hp.PacketHeader(sequence=5)),
        frame(6),
    ]
    return b"".join(packets), len(packets)


@settings(max_examples=100)
@given(st.lists(st.integers(0, 3000), max_size=20))
def test_pieces_do_not_matter(cuts: list[int]):
    stream, count = mixed_stream()
    parser = hp.PacketParser()
    found: list[hp.Packet] = []
    edges = [0, *sorted(cuts), len(stream)]
    for start, stop in pairwise(edges):
        found += parser.feed(stream[start:stop])
    assert parser.pending_bytes == 0
    assert parser.report.packets == count
    assert (parser.report.frames, parser.report.aborted) == (3, 1)
    assert [type(packet.content).__name__ for packet in found] == [
        "Frame",
        "Event",
        "Frame",
        "Status",
        "Opaque",
        "Frame",
    ]
    for packet in found:
        assert stream[packet.offset : packet.offset + len(packet.data)] == packet.data


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_bytes_like_object_is_taken(kind: type):
    parser = hp.PacketParser()
    assert len(parser.feed(kind(frame(0)))) == 1


def test_a_packet_is_delivered_with_its_last_byte():
    packet = frame(0)
    parser = hp.PacketParser()
    assert parser.feed(packet[:-1]) == []
    assert len(parser.feed(packet[-1:])) == 1


def test_memory_stays_below_the_longest_packet():
    # A header that promises the most, and chunks that never end.
    codes = np.full((1024, 1024), 0xFFFF, np.uint16)
    packet = hp.encode_frame(codes, sequence=0, frame=0, timestamp=0, code_bits=16, run=64)
    parser = hp.PacketParser()
    most = 0
    for at in range(0, len(packet) - 4, 100_000):
        parser.feed(packet[: len(packet) - 4][at : at + 100_000])
        most = max(most, parser.pending_bytes)
    assert most == len(packet) - 4
    for _ in range(20):  # noise in place of the CRC: given up, nothing is kept
        parser.feed(bytes(100_000))
    assert parser.pending_bytes == 0
    assert parser.report.damaged == 1


def test_damage_records_are_bounded():
    parser = hp.PacketParser(keep_damage=3)
    for number in range(10):
        packet = bytearray(frame(number))
        packet[70] ^= 1
        parser.feed(packet)
    parser.feed(frame(10))
    assert parser.report.damaged == 10
    assert len(parser.damage) == 3
    assert parser.damage[-1].offset > parser.damage[0].offset
    assert "byte" in parser.damage[-1].reason


def test_dropped_frames_are_summed_over_runs():
    parser = hp.PacketParser()
    for number, (capture, dropped) in enumerate([(1, 5), (1, 5), (1, 9), (2, 2), (2, 3), (3, 8)]):
        parser.feed(frame(number, capture=capture, dropped=dropped))
    assert parser.report.dropped_before == 5
    assert parser.report.dropped == 4 + 2 + 1 + 8


def test_an_aborted_frame_announces_drops_too():
    parser = hp.PacketParser()
    parser.feed(frame(0) + frame(1, dropped=3, abort_at=0))
    assert parser.report.dropped == 3


@pytest.mark.parametrize(
    ("numbers", "missing", "restarts", "repeated"),
    [
        ([0, 1, 2], 0, 0, 0),
        ([0, 5], 4, 0, 0),
        ([2**32 - 1, 0, 1], 0, 0, 0),
        ([2**32 - 2, 3], 4, 0, 0),
        ([7, 7, 8], 0, 0, 1),
        ([100, 0, 1], 0, 1, 0),
        ([0, 2**31], 2**31 - 1, 0, 0),
        ([0, 2**31 + 1], 0, 1, 0),
    ],
)
def test_sequence_numbers(numbers: list[int], missing: int, restarts: int, repeated: int):
    parser = hp.PacketParser()
    found: list[hp.Packet] = []
    for number in numbers:
        found += parser.feed(hp.encode_event(hp.Event(hp.PacketHeader(sequence=number), 1)))
    report = parser.report
    assert (report.missing, report.restarts, report.repeated) == (missing, restarts, repeated)
    assert len(found) == len(numbers) - repeated


def test_parsing_can_go_on_after_the_end_of_a_stream():
    parser = hp.PacketParser()
    parser.feed(frame(0)[:200])
    assert parser.finish() == []
    assert parser.report.damaged == 1
    assert [packet.offset for packet in parser.feed(frame(1))] == [200]


def test_a_whole_packet_inside_a_cut_one_is_found_at_the_end():
    # A test packet promises more than comes; what comes instead is the next packet.
    cut = hp.encode_packet(200, bytes(5000), hp.PacketHeader(sequence=0))[:64]
    parser = hp.PacketParser()
    assert parser.feed(cut + frame(1)) == []
    assert [packet.offset for packet in parser.finish()] == [64]
