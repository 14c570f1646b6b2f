# SPDX-License-Identifier: Apache-2.0
"""The protocol's golden vectors, made again by the gateware."""

import json
from pathlib import Path

import numpy as np
import pytest

from hueflight_hdl.camera.formatter.reference import SensorFrame, expected_packets
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_protocol import FRAME_HEADER, PACKET_HEADER, Frame, PacketParser, encode_frame

VECTORS = Path(__file__).resolve().parents[4] / "protocol" / "vectors"


def intact_packets():
    """Every intact packet of the golden vectors, once."""
    seen = {}
    for path in sorted(VECTORS.glob("*.json")):
        if json.loads(path.read_text())["kind"] == "packets":
            parser = PacketParser()
            data = path.with_suffix(".bin").read_bytes()
            for packet in [*parser.feed(data), *parser.finish()]:
                seen.setdefault(packet.data, (path.stem, packet))
    return list(seen.values())


PACKETS = intact_packets()
SMALL = 1 << 14
FRAMES = [
    (name, packet)
    for name, packet in PACKETS
    if isinstance(packet.content, Frame) and packet.content.codes.size <= SMALL
]
MESSAGES = [
    packet.data
    for _, packet in PACKETS
    if not isinstance(packet.content, Frame) and len(packet.data) <= SMALL
]


FORMAT_FIELDS = ("code_bits", "run", "geometry", "clock_hz")
INFO_FIELDS = ("timestamp", "frame", "periods", "dropped", "step", "capture")


def by_format():
    """Frames of the vectors, those of one format together: each format is built once."""
    groups = {}
    for _, packet in FRAMES:
        header = packet.content.header
        fields = {name: getattr(header, name) for name in ("rows", "cols", *FORMAT_FIELDS)}
        form = FrameFormat(lanes=2 if header.pixels % 2 else 8, **fields)
        groups.setdefault(form, []).append(packet)
    return list(groups.items())


def with_sequence(frame, sequence):
    header = frame.header
    fields = {name: getattr(header, name) for name in (*FORMAT_FIELDS, *INFO_FIELDS, "flags")}
    return encode_frame(frame.codes, sequence=sequence, **fields)


@pytest.mark.parametrize(("form", "packets"), by_format())
def test_frames(form, packets, step_through):
    frames = []
    for packet in packets:
        header = packet.content.header
        # The gateware numbers packets from 0. That only the number differs is checked here.
        assert with_sequence(packet.content, header.sequence) == packet.data
        info = {name: getattr(header, name) for name in INFO_FIELDS}
        frames.append(SensorFrame(packet.content.codes, info | {"flags": int(header.flags)}))
    expected = b"".join(
        with_sequence(packet.content, number) for number, packet in enumerate(packets)
    )
    assert step_through(form, frames, words=len(expected) // 8) == expected


def test_there_are_vectors():
    assert len(FRAMES) > 5
    assert len(MESSAGES) > 5


def unsealed(packet):
    """Words of a packet without what the sealer fills in, and their marks."""
    words = np.frombuffer(packet, "<u8").copy()
    sequence = PACKET_HEADER.offset("sequence") // 8
    check = int.from_bytes(packet[6:8], "little") // 8 - 1  # end of a header of any size
    words[[sequence, check]] &= np.uint64(0xFFFF_FFFF)
    words[-1] = 0
    last = len(words) - 1
    return [(int(word), int(i == check), int(i == last)) for i, word in enumerate(words)]


def test_messages(step_through):
    """Sealed one after the other, they differ from the vectors in number, check and CRC alone."""
    form = FrameFormat(rows=1, cols=8, run=8)
    expected = b"".join(MESSAGES)
    got = step_through(form, [], words=len(expected) // 8, messages=map(unsealed, MESSAGES))
    parser = PacketParser()
    packets = parser.feed(got)
    assert parser.report.damaged == parser.report.missing == 0
    assert [packet.content.header.sequence for packet in packets] == list(range(len(MESSAGES)))
    for packet, vector in zip(packets, MESSAGES, strict=True):
        assert unsealed(packet.data) == unsealed(vector)
    assert PACKET_HEADER.offset("sequence") == FRAME_HEADER.offset("sequence")


def test_messages_and_frames_take_turns(step_through, draw_codes):
    """However many messages wait, none of two follows the other while a frame does."""
    form = FrameFormat(rows=2, cols=8, run=8)
    rng = np.random.default_rng(12)
    frames = [SensorFrame(draw_codes(rng, form, 0.5)) for _ in range(4)]
    waiting = 6 * MESSAGES
    words = sum(map(len, [*waiting, expected_packets(form, frames)])) // 8
    got = step_through(form, frames, words=words, messages=map(unsealed, waiting))
    contents = [packet.content for packet in PacketParser().feed(got)]
    places = [place for place, content in enumerate(contents) if isinstance(content, Frame)]
    assert len(contents) == len(waiting) + len(frames)
    assert np.diff(places).max() <= 2
    assert places[-1] < len(contents) // 2
