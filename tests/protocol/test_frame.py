# SPDX-License-Identifier: Apache-2.0
"""Frame packets: inverse, uniqueness, size, and what is refused."""

import construct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight_protocol as hp
from hueflight_protocol import wire


@st.composite
def frames(draw: st.DrawFn) -> tuple[np.ndarray, int, int]:
    """Codes of any geometry, width and occupancy, with a run length that they allow."""
    # Often small, where the edges are; sometimes as wide as a sensor can be.
    rows = draw(st.integers(1, 12) | st.integers(1, 1024))
    cols = draw(st.integers(1, 40) if rows > 64 else st.integers(1, 40) | st.integers(1, 1024))
    code_bits = draw(st.integers(1, 16))
    run = 8 * draw(st.integers(max(1, -(-rows * cols // (8 << 14))), 512))
    occupancy = draw(st.sampled_from([0.0, 0.01, 0.05, 0.3, 0.7, 0.88, 0.95, 1.0]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    codes = rng.integers(1, 1 << code_bits, (rows, cols), dtype=np.uint16, endpoint=False)
    codes[rng.random((rows, cols)) >= occupancy] = 0
    if draw(st.booleans()):  # whole runs without a photon
        codes[: draw(st.integers(0, rows))] = 0
    return codes, code_bits, run


def encode(codes: np.ndarray, code_bits: int = 9, run: int = 512, **options: int) -> bytes:
    numbers = {"sequence": 1, "frame": 2, "timestamp": 3} | options
    return hp.encode_frame(codes, code_bits=code_bits, run=run, **numbers)


@settings(max_examples=300)
@given(frames())
def test_decoding_inverts_encoding(case: tuple[np.ndarray, int, int]):
    codes, code_bits, run = case
    packet = encode(codes, code_bits, run)
    frame = hp.decode_frame(packet)
    np.testing.assert_array_equal(frame.codes, codes)
    assert len(packet) % 8 == 0
    assert (frame.header.rows, frame.header.cols) == codes.shape
    # One frame, one packet: what the decoder accepts is what the encoder makes.
    assert encode(frame.codes, code_bits, run) == packet


@settings(max_examples=100)
@given(
    st.builds(
        hp.FrameHeader,
        sequence=st.integers(0, 2**32 - 1),
        frame=st.integers(0, 2**64 - 1),
        timestamp=st.integers(0, 2**64 - 1),
        rows=st.integers(1, 30),
        cols=st.integers(1, 30),
        code_bits=st.integers(1, 16),
        run=st.integers(1, 512).map(lambda n: 8 * n),
        periods=st.integers(0, 2**32 - 1),
        dropped=st.integers(0, 2**32 - 1),
        geometry=st.integers(0, 255),
        flags=st.integers(0, 127).map(hp.FrameFlags),
        step=st.integers(0, 2**16 - 1),
        capture=st.integers(0, 2**32 - 1),
        clock_hz=st.integers(0, 2**32 - 1),
    )
)
def test_every_header_field_arrives(header: hp.FrameHeader):
    options = {name: getattr(header, name) for name in header.__slots__}
    shape = options.pop("rows"), options.pop("cols")
    packet = hp.encode_frame(np.ones(shape, np.uint8), **options)
    assert hp.decode_frame(packet).header == header
    # construct's own parser, from which the fast one derives, reads the same.
    parsed = hp.FRAME_HEADER.declaration.parse(packet)
    assert isinstance(parsed, construct.Container)
    assert {name: parsed[name] for name in header.__slots__} == {
        name: int(getattr(header, name)) for name in header.__slots__
    }
    view = np.frombuffer(packet, hp.FRAME_HEADER.dtype, 1)[0]
    assert all(int(view[name]) == parsed[name] for name in view.dtype.names or ())


def occupied(occupancy: float) -> np.ndarray:
    rng = np.random.default_rng(12)
    codes = rng.integers(1, 512, (192, 128), dtype=np.uint16)
    codes[rng.random(codes.shape) >= occupancy] = 0
    return codes


def test_overhead_over_bitmap_and_hits_is_at_most_6_percent_at_occupancy_0_3():
    codes = occupied(0.3)
    ideal = (codes.size + 9 * np.count_nonzero(codes)) / 8
    assert len(encode(codes)) <= 1.06 * ideal


def test_overhead_over_dense_is_at_most_1_5_percent_at_occupancy_1():
    assert len(encode(occupied(1.0))) <= 1.015 * 192 * 128 * 9 / 8


def test_a_frame_without_photons_is_header_and_trailer():
    assert len(encode(np.zeros((1024, 1024), np.uint16))) == 64 + 16


def test_cost_falls_with_what_is_masked():
    codes = occupied(1.0)
    whole = len(encode(codes))
    codes[: 192 * 9 // 10] = 0
    assert len(encode(codes)) < whole / 9


def test_the_longest_packet_is_as_long_as_stated():
    packet = encode(np.full((1024, 1024), 0xFFFF), 16, 64)
    assert len(packet) == hp.MAX_PACKET_BYTES
    assert hp.decode_frame(packet).codes.min() == 0xFFFF


@settings(max_examples=200)
@given(st.integers(1, 600), st.integers(1, 16))
def test_dense_from_is_where_dense_is_no_longer_than_bitmap(pixels: int, code_bits: int):
    def bitmap_bytes(hits: int) -> int:
        return -(-(-(-pixels // 8) + -(-hits * code_bits // 8)) // 4) * 4

    dense_bytes = -(-pixels * code_bits // 32) * 4
    threshold = wire.dense_from(pixels, code_bits)
    assert all((hits >= threshold) == (dense_bytes <= bitmap_bytes(hits))
               for hits in range(1, pixels + 1))  # fmt: skip


@pytest.mark.parametrize("abort_at", [0, 1, 3, 6])
def test_an_aborted_frame_is_well_formed_and_no_data(abort_at: int):
    codes = occupied(0.4)[:24]
    packet = encode(codes, abort_at=abort_at)
    with pytest.raises(hp.AbortedFrameError, match="frame 2 was aborted"):
        hp.decode_frame(packet)
    # It holds what the whole frame's packet holds up to there.
    whole = encode(codes)
    sent = packet[:-16]
    assert whole.startswith(sent) or (sent.endswith(bytes(4)) and whole.startswith(sent[:-4]))
    assert (len(packet) == len(whole)) == (abort_at == 6)


@pytest.mark.parametrize(
    ("codes", "options", "message"),
    [
        ([1, 2], {}, r"codes has shape \(2,\): must be \(rows, cols\)"),
        ([[0.5]], {}, "codes are float64: must be integers"),
        ([[512]], {}, "code 512: must be from 0 to 511"),
        ([[-1]], {}, "code -1: must be from 0 to 511"),
        ([[1]], {"code_bits": 17}, "code_bits = 17: must be from 1 to 16"),
        ([[1]], {"code_bits": 0}, "code_bits = 0: must be from 1 to 16"),
        ([[1]], {"run": 12}, "run = 12: must be a multiple of 8"),
        ([[1]], {"run": 0}, "run = 0: must be from 8 to 4096"),
        ([[1]], {"run": 4104}, "run = 4104: must be from 8 to 4096"),
        (np.zeros((1024, 1024), int), {"run": 56}, "run = 56: .* make 18725 chunks"),
        (np.zeros((1025, 1), int), {}, "rows = 1025: must be from 1 to 1024"),
        (np.zeros((1, 0), int), {}, "cols = 0: must be from 1 to 1024"),
        ([[1]], {"sequence": 1 << 32}, "sequence = 4294967296: must be an integer from 0 to"),
        ([[1]], {"step": -1}, "step = -1: must be an integer from 0 to 65535"),
        ([[1]], {"flags": 128}, "flags = 0x80: bits 0x80 have no meaning"),
        ([[1]], {"abort_at": 2}, "abort_at = 2: must be from 0 to 1"),
    ],
)
def test_what_cannot_be_sent_is_refused(codes, options, message: str):
    with pytest.raises(hp.ProtocolError, match=message):
        encode(codes, **options)


def test_codes_may_be_any_integers():
    packet = encode(np.array([[1, 2]], np.uint16))
    for dtype in (np.uint8, np.int64, np.uint64, np.int16):
        assert encode(np.array([[1, 2]], dtype)) == packet


def test_decoded_codes_are_read_only():
    frame = hp.decode_frame(encode(np.ones((2, 3), np.uint8)))
    with pytest.raises(ValueError, match="read-only"):
        frame.codes[0, 0] = 5


@pytest.mark.parametrize(("cut", "rule"), [(8, "P7"), (63, "P7"), (100, "P7"), (-4, "P7")])
def test_a_cut_packet_is_refused(cut: int, rule: str):
    packet = encode(occupied(0.3)[:8])
    with pytest.raises(hp.PacketError, match="packet ends after") as caught:
        hp.decode_frame(packet[:cut])
    assert caught.value.rule == rule


def test_what_follows_a_packet_is_refused():
    packet = encode(occupied(0.3)[:8])
    with pytest.raises(hp.PacketError, match="8 bytes follow the packet"):
        hp.decode_frame(packet + bytes(8))


def test_an_error_names_value_byte_and_rule():
    packet = bytearray(encode(occupied(0.3)[:8]))
    packet[4] = 9
    with pytest.raises(hp.PacketError) as caught:
        hp.decode_frame(packet)
    assert str(caught.value) == "version 9, this parser reads 1 (byte 4 of the packet, rule P3)"
    assert (caught.value.rule, caught.value.offset) == ("P3", 4)


@pytest.mark.parametrize(
    ("packet", "rule", "message"),
    [
        (hp.encode_event(hp.Event(hp.PacketHeader(sequence=0), 1)) * 2, "P4", "is not a frame"),
        (bytes(80), "P2", "magic is 00 00 00 00"),
    ],
)
def test_what_is_no_frame_packet_is_refused(packet: bytes, rule: str, message: str):
    with pytest.raises(hp.PacketError, match=message) as caught:
        hp.decode_frame(packet)
    assert caught.value.rule == rule
