# SPDX-License-Identifier: Apache-2.0
"""COBS against published examples, and as an inverse."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hueflight_protocol as hp

RUN = bytes(range(1, 256))

# Cheshire and Baker's encoding as tabulated in the encyclopaedia article "Consistent Overhead
# Byte Stuffing" (examples 1 to 11), without the delimiter.
PUBLISHED = [
    (b"\0", b"\x01\x01"),
    (b"\0\0", b"\x01\x01\x01"),
    (b"\0\x11\0", b"\x01\x02\x11\x01"),
    (b"\x11\x22\0\x33", b"\x03\x11\x22\x02\x33"),
    (b"\x11\x22\x33\x44", b"\x05\x11\x22\x33\x44"),
    (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
    (RUN[:254], b"\xff" + RUN[:254]),
    (b"\0" + RUN[:254], b"\x01\xff" + RUN[:254]),
    (RUN, b"\xff" + RUN[:254] + b"\x02\xff"),
    (RUN[1:] + b"\0", b"\xff" + RUN[1:] + b"\x01\x01"),
    (RUN[2:] + b"\0\x01", b"\xfe" + RUN[2:] + b"\x02\x01"),
]


@pytest.mark.parametrize(("message", "encoded"), PUBLISHED)
def test_published_examples(message: bytes, encoded: bytes):
    assert hp.cobs_encode(message) == encoded
    assert hp.cobs_decode(encoded) == message


runs = st.lists(
    st.binary(max_size=4) | st.integers(250, 260).map(lambda n: b"\x55" * n), max_size=6
).map(b"".join)


@given(runs | st.binary(max_size=700))
def test_decoding_inverts_encoding(message: bytes):
    encoded = hp.cobs_encode(message)
    assert 0 not in encoded
    assert len(encoded) <= len(message) + 1 + max(0, len(message) - 1) // 254
    assert hp.cobs_decode(encoded) == message


@given(st.lists(runs, max_size=5), st.integers(1, 300))
def test_a_stream_in_pieces(messages: list[bytes], piece: int):
    stream = b"\0".join([b"", *map(hp.cobs_encode, messages), b""])
    line = hp.CobsDecoder(limit=4000)
    found = []
    for at in range(0, len(stream), piece):
        found += line.feed(stream[at : at + piece])
    assert found == messages
    assert (line.damaged, line.overlong) == (0, 0)


@pytest.mark.parametrize(
    ("encoded", "message"),
    [
        (b"", "empty"),
        (b"\x02\0", "zero byte inside"),
        (b"\0", "zero byte inside"),
        (b"\x03\x11", "code 3 at byte 0 points beyond the end of 2 bytes"),
        (b"\x01\x05\x11", "code 5 at byte 1"),
    ],
)
def test_broken_frames(encoded: bytes, message: str):
    with pytest.raises(hp.MessageError, match=message):
        hp.cobs_decode(encoded)


@given(st.binary(max_size=200))
def test_any_bytes_decode_or_are_refused(noise: bytes):
    try:
        message = hp.cobs_decode(noise)
    except hp.MessageError:
        return
    # What was accepted is the encoding of what came out, but for the other way to end.
    assert noise in (hp.cobs_encode(message), hp.cobs_encode(message) + b"\x01")


def test_an_overlong_frame_is_dropped_to_its_end_and_takes_no_memory():
    line = hp.CobsDecoder(limit=10)
    for _ in range(1000):
        assert line.feed(b"\x55" * 100) == []
    assert line.feed(b"\x55\0" + hp.cobs_encode(b"abc") + b"\0") == [b"abc"]
    assert (line.damaged, line.overlong) == (0, 1)
    assert line.feed(b"\x0a" + b"x" * 9 + b"\0") == [b"x" * 9]
    assert line.feed(b"\x0b" + b"x" * 10 + b"\0") == []
    assert line.overlong == 2
