# SPDX-License-Identifier: Apache-2.0
"""Packets that are not frames: inverse, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hueflight_protocol as hp

u32 = st.integers(0, 2**32 - 1)
headers = st.builds(hp.PacketHeader, sequence=u32, timestamp=st.integers(0, 2**64 - 1), capture=u32)


@given(
    st.builds(
        hp.Event,
        headers,
        st.integers(0, 65535),
        st.sampled_from(hp.EventLevel),
        u32,
        st.integers(-(2**63), 2**63 - 1),
    )
)
def test_events(event: hp.Event):
    assert hp.decode_packet(hp.encode_event(event)) == event


@given(
    st.builds(
        hp.Status,
        headers,
        frames_sent=st.integers(0, 2**64 - 1),
        frames_dropped=u32,
        frames_aborted=u32,
        triggers_lost=u32,
        stall_clocks=u32,
        buffer_peak=u32,
        temperature_mdeg=st.none() | st.integers(-(2**31) + 1, 2**31 - 1),
    )
)
def test_status(status: hp.Status):
    assert hp.decode_packet(hp.encode_status(status)) == status


@given(st.integers(6, 255), st.binary(max_size=300), headers)
def test_types_that_are_not_interpreted(kind: int, body: bytes, header: hp.PacketHeader):
    packet = hp.encode_packet(kind, body, header)
    assert len(packet) % 8 == 0
    assert hp.decode_packet(packet) == hp.Opaque(header, kind, body)


@given(headers, st.sampled_from(hp.PatternKind), st.integers(1, 2**32 - 1), st.integers(1, 200))
def test_patterns(header: hp.PacketHeader, pattern: hp.PatternKind, seed: int, words: int):
    packet = hp.encode_test_pattern(header, pattern=pattern, seed=seed, words=words)
    found = hp.decode_packet(packet)
    assert isinstance(found, hp.TestPattern)
    assert (found.header, found.pattern, found.words[0]) == (header, pattern, seed)
    assert (found.words.size, found.errors()) == (words, 0)


def test_xorshift_is_marsaglias():
    # Marsaglia 2003, section 3: y ^= y<<13; y ^= y>>17; y ^= y<<5, first output for y = 2463534242.
    header = hp.PacketHeader(sequence=0)
    packet = hp.encode_test_pattern(
        header, pattern=hp.PatternKind.XORSHIFT, seed=2463534242, words=2
    )
    found = hp.decode_packet(packet)
    assert isinstance(found, hp.TestPattern)
    assert found.words.tolist() == [2463534242, 723471715]


def test_wrong_words_are_counted():
    words = np.arange(10, dtype=np.uint32)
    words[4] = 99
    pattern = hp.TestPattern(hp.PacketHeader(sequence=0), hp.PatternKind.COUNTER, words)
    assert pattern.errors() == 2


def test_the_largest_body():
    header = hp.PacketHeader(sequence=0)
    body = bytes(range(256)) * 4096
    assert hp.decode_packet(hp.encode_packet(9, body, header)) == hp.Opaque(header, 9, body)
    with pytest.raises(hp.ProtocolError, match="body has 1048577 bytes: at most 1048576"):
        hp.encode_packet(9, body + b"x", header)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda h: hp.encode_packet(hp.PacketType.FRAME, b"", h), "use encode_frame"),
        (lambda h: hp.encode_packet(256, b"", h), "type = 256: must be an integer from 0 to 255"),
        (lambda h: hp.encode_event(hp.Event(h, -1)), "code = -1: must be an integer from 0"),
        (lambda h: hp.encode_event(hp.Event(h, 1, count=1 << 32)), "count = 4294967296"),
        (
            lambda h: hp.encode_test_pattern(h, pattern=hp.PatternKind.COUNTER, seed=1, words=0),
            "words = 0: must be from 1 to 262143",
        ),
        (
            lambda h: hp.encode_test_pattern(h, pattern=hp.PatternKind.XORSHIFT, seed=0, words=1),
            "seed = 0: xorshift32 would stay at 0",
        ),
    ],
)
def test_what_cannot_be_sent_is_refused(make, message: str):
    with pytest.raises(hp.ProtocolError, match=message):
        make(hp.PacketHeader(sequence=0))


@pytest.mark.parametrize("size", [0, 7, 31, 40, 64])
def test_a_packet_of_another_length_is_refused(size: int):
    packet = hp.encode_event(hp.Event(hp.PacketHeader(sequence=0), 1))
    with pytest.raises(hp.PacketError, match=f"packet has {size} bytes"):
        hp.decode_packet((packet + packet)[:size])


def test_a_packet_shorter_than_its_header_is_refused():
    """A type of a later version may have a longer header, of which bytes may be missing."""
    packet = bytearray(hp.encode_packet(9, b"", hp.PacketHeader(sequence=0))[:32])
    packet[6:8] = (40).to_bytes(2, "little")
    with pytest.raises(hp.PacketError, match="packet has 32 bytes"):
        hp.decode_packet(bytes(packet))
