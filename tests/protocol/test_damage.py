# SPDX-License-Identifier: Apache-2.0
"""Every bit flip, every truncation, every lost byte: found, and the next packet recovered."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import hueflight_protocol as hp

VECTORS = Path(__file__).resolve().parents[2] / "protocol" / "vectors"
LONGEST = 200  # bytes of a vector that every run damages everywhere
LONGEST_SLOW = 500
ALIKE = ("flag-", "event-")  # families of which one member stands for all but in the slow runs


def small_vectors() -> list:
    """Names of vectors that are one packet of sequence number 0, the rest marked slow."""
    cases = []
    for path in sorted(VECTORS.glob("*.json")):
        expected = json.loads(path.read_text())
        packets = expected.get("packets", [])
        if len(packets) != 1 or packets[0]["size"] != expected["bytes"] or packets[0]["sequence"]:
            continue
        slow = expected["bytes"] > LONGEST or path.stem.startswith(ALIKE)
        if path.stem == "event-overflow" or not slow:
            cases.append(path.stem)
        elif expected["bytes"] <= LONGEST_SLOW:
            cases.append(pytest.param(path.stem, marks=pytest.mark.slow))
    return cases


SMALL = small_vectors()
FIRST = hp.encode_event(hp.Event(hp.PacketHeader(sequence=(1 << 32) - 1), 1))
NEXT = hp.encode_frame(np.eye(9, 16, dtype=np.uint8), sequence=1, frame=1, timestamp=9, run=16)


def parse(data: bytes) -> tuple[list[bytes], hp.ParserReport]:
    parser = hp.PacketParser()
    packets = parser.feed(data) + parser.finish()
    return [packet.data for packet in packets], parser.report


def read(name: str) -> bytes:
    """A packet of the vectors, which all have sequence number 0."""
    return (VECTORS / f"{name}.bin").read_bytes()


@pytest.mark.parametrize("name", SMALL)
def test_every_bit_flip(name: str):
    packet = read(name)
    whole, report = parse(FIRST + packet + NEXT)
    assert whole == [FIRST, packet, NEXT]
    assert report.skipped_bytes == 0
    for bit in range(8 * len(packet)):
        flipped = bytearray(packet)
        flipped[bit // 8] ^= 1 << bit % 8
        found, report = parse(FIRST + flipped + NEXT)
        assert found == [FIRST, NEXT], f"bit {bit}"
        assert (report.skipped_bytes, report.missing) == (len(packet), 1), f"bit {bit}"
        # A packet whose magic is gone is noise, found by its sequence number alone.
        assert report.damaged == (bit >= 32), f"bit {bit}"


@pytest.mark.parametrize("name", SMALL)
def test_every_truncation(name: str):
    packet = read(name)
    for size in range(len(packet)):
        found, report = parse(FIRST + packet[:size] + NEXT)
        assert found == [FIRST, NEXT], f"{size} bytes"
        assert (report.skipped_bytes, report.missing) == (size, 1), f"{size} bytes"
        found, report = parse(FIRST + packet[:size])
        assert found == [FIRST], f"{size} bytes at the end"
        assert report.skipped_bytes == size
        assert report.damaged == (size >= 4)


@pytest.mark.parametrize("name", SMALL)
def test_every_lost_beginning(name: str):
    packet = read(name)
    for size in range(1, len(packet)):
        found, report = parse(packet[size:] + NEXT)
        assert found == [NEXT], f"{size} bytes lost"
        assert report.skipped_bytes == len(packet) - size


@pytest.mark.parametrize("name", SMALL)
def test_every_lost_or_doubled_byte(name: str):
    packet = read(name)
    for at in range(len(packet)):
        for damaged in (packet[:at] + packet[at + 1 :], packet[: at + 1] + packet[at:]):
            found, report = parse(FIRST + damaged + NEXT)
            if packet in damaged:  # its first or last byte doubled: the packet itself is whole
                assert found == [FIRST, packet, NEXT]
                continue
            assert found == [FIRST, NEXT], f"byte {at}"
            assert report.skipped_bytes == len(damaged)


@st.composite
def bursts(draw: st.DrawFn) -> tuple[list[bytes], bytes, set[int]]:
    """Packets, the stream that a few bursts of noise made of them, and which ones were hit."""
    count = draw(st.integers(3, 8))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    packets = [
        hp.encode_frame(
            rng.integers(0, 512, (6, 32)) * (rng.random((6, 32)) < rng.random()),
            sequence=number,
            frame=number,
            timestamp=number,
            run=64,
        )
        for number in range(count)
    ]
    stream, hit = bytearray(), set()
    for number, packet in enumerate(packets):
        damage = draw(st.sampled_from(["none", "none", "noise", "cut", "zeros"]))
        at = draw(st.integers(0, len(packet) - 1))
        size = draw(st.integers(1, 40))
        if damage == "none":
            stream += packet
            continue
        if damage == "noise":
            changed = packet[:at] + rng.bytes(min(size, len(packet) - at)) + packet[at + size :]
        elif damage == "cut":
            changed = packet[:at] + packet[at + size :]
        else:
            changed = packet[:at] + bytes(size) + packet[at:]
        stream += changed
        if packet not in changed:
            hit.add(number)
    # A packet that lost its last byte is whole again if the next one begins with that byte.
    assume(all(packets[number] not in stream for number in hit))
    return packets, bytes(stream), hit


@settings(max_examples=200)
@given(bursts(), st.integers(1, 500))
def test_bursts_cost_the_packets_they_hit_and_no_others(
    case: tuple[list[bytes], bytes, set[int]], piece: int
):
    packets, stream, hit = case
    parser = hp.PacketParser()
    found: list[hp.Packet] = []
    for at in range(0, len(stream), piece):
        found += parser.feed(stream[at : at + piece])
    found += parser.finish()
    survivors = [packet for number, packet in enumerate(packets) if number not in hit]
    assert [packet.data for packet in found] == survivors
    # Every byte is either in a packet that was delivered, or counted.
    assert sum(len(packet.data) for packet in found) + parser.report.skipped_bytes == len(stream)
    # Packets before the first and after the last intact one cannot be missed by number.
    alive = sorted(set(range(len(packets))) - hit)
    if alive:
        assert parser.report.missing == alive[-1] - alive[0] + 1 - len(alive)


@settings(max_examples=200)
@given(st.binary(max_size=600), st.integers(1, 100))
def test_random_bytes_are_only_counted(noise: bytes, piece: int):
    parser = hp.PacketParser()
    found: list[hp.Packet] = []
    for at in range(0, len(noise), piece):
        found += parser.feed(noise[at : at + piece])
    found += parser.finish()
    assert found == []
    assert parser.report.skipped_bytes == len(noise)
