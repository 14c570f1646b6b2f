# SPDX-License-Identifier: Apache-2.0
"""Packets to histograms in one call: counts, reports, policies, errors."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import HistogramError, IngestError, OverflowPolicyError
from hueflight.ingest import accumulate, accumulate_by_step, accumulate_codes
from hueflight.ingest.kernels import Kernels
from hueflight_protocol import FrameFlags, PacketHeader, Status, crc32c, encode_frame, encode_status

Make = Callable[..., Any]


@pytest.mark.parametrize("threads", [1, 2, 7])
def test_counts_every_code(
    threads: int, kernels: Kernels, small: Make, random_codes: Make, stream: Make, counted: Make
) -> None:
    instrument = small(rows=24, cols=40)
    codes = random_codes(np.random.default_rng(1), (30, 24, 40), code_bits=9, occupancy=0.4)
    packets = stream(codes, run=64)
    counts, report = accumulate(packets, instrument, threads=threads, kernels=kernels)
    np.testing.assert_array_equal(counts, counted(codes, 9))
    assert counts.dtype == np.uint16
    assert report.frames == report.packets == 30
    assert report.photons == report.hits == np.count_nonzero(codes)
    assert report.lossless


def test_adds_to_counts(kernels: Kernels, small: Make, random_codes: Make, stream: Make) -> None:
    instrument = small()
    codes = random_codes(np.random.default_rng(2), (5, 8, 8), code_bits=9, occupancy=0.4)
    once, _ = accumulate(stream(codes), instrument, kernels=kernels)
    out = np.full(instrument.histogram_shape, 7, np.uint32)
    back, _ = accumulate(stream(codes), instrument, out=out, kernels=kernels)
    assert back is out
    np.testing.assert_array_equal(out, once + 7)


def test_no_packets_no_counts(kernels: Kernels, small: Make) -> None:
    counts, report = accumulate(b"", small(), kernels=kernels)
    assert not counts.any()
    assert report.packets == 0
    assert report.lossless


def test_reports_what_did_not_come(kernels: Kernels, small: Make) -> None:
    codes = np.ones((8, 8), np.uint16)

    def frame(n: int, **fields: Any) -> bytes:
        return encode_frame(
            codes, **({"sequence": n, "frame": n, "timestamp": n, "dropped": 2} | fields)
        )

    broken = bytearray(frame(4))
    broken[70] ^= 1
    flags = FrameFlags.MASKED | FrameFlags.GATED
    packets = b"".join(
        [
            frame(0, dropped=2),
            encode_status(Status(PacketHeader(sequence=1))),
            frame(2, abort_at=0),
            frame(3, flags=flags),
            frame(3, flags=flags),  # the same packet again
            bytes(broken),
            frame(8, dropped=5),
        ]
    )
    counts, report = accumulate(packets, small(), kernels=kernels)
    expected = {"packets": 6, "frames": 3, "photons": 192, "hits": 192, "damaged": 1, "missing": 4}
    expected |= {"dropped": 3, "dropped_before": 2, "aborted": 1, "repeated": 1}
    expected |= {"skipped_bytes": len(broken), "masked": 1, "gated": 1}
    assert {name: count for name, count in report.as_dict().items() if count} == expected
    assert not report.lossless
    assert (counts[..., 1] == 3).all()


def test_run_length_may_change_within_a_stream(
    kernels: Kernels, small: Make, random_codes: Make, counted: Make
) -> None:
    codes = random_codes(np.random.default_rng(3), (12, 8, 8), code_bits=9, occupancy=0.5)
    packets = b"".join(
        encode_frame(frame, sequence=i, frame=i, timestamp=i, run=(8, 8, 32, 512)[i % 4])
        for i, frame in enumerate(codes)
    )
    counts, _ = accumulate(packets, small(), kernels=kernels)
    np.testing.assert_array_equal(counts, counted(codes, 9))


def test_packet_with_content_that_contradicts_its_totals_is_seen(
    kernels: Kernels, small: Make
) -> None:
    """A faulty encoder: the CRC is right, a packed code of a hit is 0 (rule F11)."""
    codes = np.zeros((8, 8), np.uint16)
    codes[0, 0] = 511
    packet = bytearray(encode_frame(codes, sequence=0, frame=0, timestamp=0))
    at = packet.index(b"\xff\x01", 64)  # the packed code
    packet[at : at + 2] = b"\0\0"
    packet[-4:] = crc32c(bytes(packet[:-4])).to_bytes(4, "little")
    counts, report = accumulate(packet, small(), kernels=kernels)
    assert report.miscounted == 1
    assert (counts[..., 0] == 1).all()
    assert counts.sum() == 64


# -- step markers ----------------------------------------------------------------------------------


def test_scanned_sensor_fills_an_image(kernels: Kernels, small: Make, random_codes: Make) -> None:
    instrument = small("line1024", rows=2, cols=8, scan_steps=3)
    codes = random_codes(np.random.default_rng(4), (9, 2, 8), code_bits=9, occupancy=0.5)
    markers = [0, 0, 2, 1, 1, 5, 3, 2, 4]  # two scans of three positions, out of order
    packets = b"".join(
        encode_frame(frame, sequence=i, frame=i, timestamp=i, step=step)
        for i, (frame, step) in enumerate(zip(codes, markers, strict=True))
    )
    counts, report = accumulate(packets, instrument, kernels=kernels)
    by_scan, _ = accumulate_by_step(packets, instrument, kernels=kernels)
    assert report.frames == 9
    expected = np.zeros((2, 6, 8, 512), np.intp)
    row, col = np.indices((2, 8))
    for frame, marker in zip(codes, markers, strict=True):
        scan, position = divmod(marker, 3)
        np.add.at(expected[scan], (row + 2 * position, col, frame), 1)
    np.testing.assert_array_equal(counts, expected.sum(axis=0))
    assert list(by_scan) == [0, 1]
    np.testing.assert_array_equal(np.stack(list(by_scan.values())), expected)


def test_one_histogram_for_each_led(
    kernels: Kernels, small: Make, random_codes: Make, counted: Make
) -> None:
    codes = random_codes(np.random.default_rng(6), (20, 8, 8), code_bits=9, occupancy=0.5)
    packets = b"".join(
        encode_frame(frame, sequence=i, frame=i, timestamp=i, step=(7, 2, 500)[i % 3])
        for i, frame in enumerate(codes)
    )
    counts, report = accumulate_by_step(packets, small(), threads=2, kernels=kernels)
    assert list(counts) == [2, 7, 500]
    assert report.photons == np.count_nonzero(codes)
    for first, step in enumerate((7, 2, 500)):
        np.testing.assert_array_equal(counts[step], counted(codes[first::3], 9))


# -- overflow --------------------------------------------------------------------------------------


@pytest.fixture
def nearly_full(small: Make) -> tuple[hf.Instrument, np.ndarray, bytes, np.ndarray]:
    """Counts of which one counter has room for two more; packets that bring it three."""
    instrument = small(rows=16, cols=16)
    codes = np.zeros((3, 16, 16), np.uint16)
    codes[:, 5, 5] = 9
    codes[:, :, 12] = [[1], [2], [3]]
    packets = b"".join(
        encode_frame(frame, sequence=i, frame=i, timestamp=i, run=64)
        for i, frame in enumerate(codes)
    )
    out = np.zeros(instrument.histogram_shape, np.uint16)
    out[5, 5, 9] = 65533
    return instrument, out, packets, codes


def test_error_leaves_the_counts_as_they_were(kernels: Kernels, nearly_full: Any) -> None:
    instrument, out, packets, _ = nearly_full
    before = out.copy()
    with pytest.raises(OverflowPolicyError, match=r"exceed 65535.*widen"):
        accumulate(packets, instrument, out=out, kernels=kernels)
    np.testing.assert_array_equal(out, before)


def test_widening_is_exact(kernels: Kernels, nearly_full: Any, counted: Make) -> None:
    instrument, out, packets, codes = nearly_full
    expected = out + counted(codes, 9)
    for threads in (1, 3):
        counts, report = accumulate(
            packets, instrument, out=out.copy(), overflow="widen", threads=threads, kernels=kernels
        )
        assert counts.dtype == np.uint32
        np.testing.assert_array_equal(counts, expected)
        assert report.photons == np.count_nonzero(codes)


def test_nothing_is_widened_without_need(kernels: Kernels, nearly_full: Any) -> None:
    instrument, out, packets, _ = nearly_full
    out[5, 5, 9] -= 1
    counts, _ = accumulate(packets, instrument, out=out, overflow="widen", kernels=kernels)
    assert counts is out
    assert out[5, 5, 9] == 65535


def test_saturating_says_what_it_let_go(kernels: Kernels, nearly_full: Any, counted: Make) -> None:
    instrument, out, packets, codes = nearly_full
    expected = np.minimum(out + counted(codes, 9), 65535)
    counts, report = accumulate(packets, instrument, out=out, overflow="saturate", kernels=kernels)
    np.testing.assert_array_equal(counts, expected)
    assert report.clipped == 1
    assert not report.lossless


@pytest.mark.parametrize("policy", ["saturate", "widen"])
def test_any_counter_may_be_full(
    kernels: Kernels, small: Make, random_codes: Make, counted: Make, policy: Any
) -> None:
    """Code 0 too, which gets the frames without a photon."""
    rng = np.random.default_rng(9)
    instrument = small(rows=16, cols=16)
    for occupancy in (0.02, 0.5, 1.0):
        codes = random_codes(rng, (20, 16, 16), code_bits=9, occupancy=occupancy)
        packets = b"".join(
            encode_frame(frame, sequence=i, frame=i, timestamp=i, run=128)
            for i, frame in enumerate(codes)
        )
        out = rng.integers(65500, 65536, instrument.histogram_shape).astype(np.uint16)
        exact = out + counted(codes, 9).astype(np.uint32)
        counts, report = accumulate(packets, instrument, out=out, overflow=policy, kernels=kernels)
        if policy == "widen":
            np.testing.assert_array_equal(counts, exact)
        else:
            np.testing.assert_array_equal(counts, np.minimum(exact, 65535))
            assert report.clipped == exact.sum() - counts.sum(dtype=np.uint64)
        assert report.photons == np.count_nonzero(codes)


@pytest.mark.parametrize("first", [0, 1, 300, 500])
@pytest.mark.parametrize("policy", ["saturate", "widen"])
@pytest.mark.parametrize("elsewhere", [None, 0, 17])
def test_codes_behind_a_gate(
    kernels: Kernels, small: Make, counted: Make, first: int, policy: Any, elsewhere: int | None
) -> None:
    """Few photons, whose codes lie close together but for one in one frame."""
    rng = np.random.default_rng(first)
    instrument = small(rows=15, cols=16)  # the last tile of a chunk, and the last chunk, are short
    codes = rng.integers(first, first + 12, (40, 15, 16)).astype(np.uint16)
    codes[rng.random(codes.shape) >= 0.03] = 0
    if elsewhere is not None:
        codes[elsewhere, 7, 7] = 200
    packets = b"".join(
        encode_frame(frame, sequence=i, frame=i, timestamp=i, run=136)
        for i, frame in enumerate(codes)
    )
    for least, kind in ((0, np.uint16), (65490, np.uint16), (2**31, np.uint32)):
        out = rng.integers(least, least + 46, instrument.histogram_shape).astype(kind)
        exact = out.astype(np.int64) + counted(codes, 9)
        counts, report = accumulate(packets, instrument, out=out, overflow=policy, kernels=kernels)
        most = exact.max() if policy == "widen" else np.iinfo(kind).max
        np.testing.assert_array_equal(counts, np.minimum(exact, most))
        assert report.clipped == exact.sum() - counts.sum(dtype=np.int64)
        assert report.photons == np.count_nonzero(codes)
    counts, _ = accumulate(packets, instrument, kernels=kernels)
    np.testing.assert_array_equal(counts, counted(codes, 9))


def test_32_bits_overflow_too(kernels: Kernels, nearly_full: Any) -> None:
    instrument, out, packets, _ = nearly_full
    wide = out.astype(np.uint32)
    wide[5, 5, 9] = 2**32 - 2
    before = wide.copy()
    with pytest.raises(OverflowPolicyError, match="start a new histogram"):
        accumulate(packets, instrument, out=wide, overflow="widen", kernels=kernels)
    np.testing.assert_array_equal(wide, before)


def test_more_frames_than_16_bits_count(kernels: Kernels, small: Make) -> None:
    instrument = small(rows=1, cols=1)
    one = np.full((1, 1), 3, np.uint16)
    packets = b"".join(encode_frame(one, sequence=i, frame=i, timestamp=i) for i in range(3000))
    out = np.zeros(instrument.histogram_shape, np.uint16)
    out[0, 0, 3] = 64000
    counts, _ = accumulate(packets, instrument, out=out, overflow="widen", kernels=kernels)
    assert counts[0, 0, 3] == 67000
    assert counts.sum() == 67000


# -- codes in memory -------------------------------------------------------------------------------


def test_codes_in_memory(small: Make, random_codes: Make, counted: Make) -> None:
    instrument = small()
    codes = random_codes(np.random.default_rng(8), (5, 8, 8), code_bits=9, occupancy=0.4)
    counts = accumulate_codes(codes, instrument)
    np.testing.assert_array_equal(counts, counted(codes, 9))
    np.testing.assert_array_equal(
        accumulate_codes(codes[0], instrument, out=counts),
        counted(codes, 9) + counted(codes[:1], 9),
    )


def test_codes_overflow_by_policy(small: Make) -> None:
    instrument = small(rows=1, cols=2)
    codes = np.array([[[1, 2]]] * 3, np.uint16)
    out = np.zeros(instrument.histogram_shape, np.uint16)
    out[0, 0, 1] = 65534
    with pytest.raises(OverflowPolicyError, match="exceed 65535"):
        accumulate_codes(codes, instrument, out=out)
    assert out.sum() == 65534
    assert accumulate_codes(codes, instrument, out=out.copy(), overflow="widen")[0, 0, 1] == 65537
    assert accumulate_codes(codes, instrument, out=out, overflow="saturate")[0, 0, 1] == 65535


def test_codes_that_miss_a_nearly_full_counter(small: Make) -> None:
    instrument = small(rows=1, cols=2)
    out = np.zeros(instrument.histogram_shape, np.uint16)
    out[0, 0, 7] = 65535
    codes = np.array([[[1, 2]]] * 3, np.uint16)
    assert accumulate_codes(codes, instrument, out=out) is out
    assert (out[0, 0, 1], out[0, 0, 7], out[0, 1, 2]) == (3, 65535, 3)


def test_a_stream_longer_than_is_scanned_at_once(
    kernels: Kernels,
    small: Make,
    random_codes: Make,
    stream: Make,
    counted: Make,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    codes = random_codes(np.random.default_rng(9), (40, 8, 8), code_bits=9, occupancy=0.4)
    packets = stream(codes)
    monkeypatch.setattr("hueflight.ingest.scanner.WINDOW_BYTES", len(packets) // 7)
    counts, report = accumulate(packets, small(), kernels=kernels)
    np.testing.assert_array_equal(counts, counted(codes, 9))
    assert report.frames == 40
    assert report.lossless


# -- bad input -------------------------------------------------------------------------------------


def test_frames_of_another_sensor(kernels: Kernels, small: Make) -> None:
    packet = encode_frame(np.ones((4, 6), np.uint16), sequence=0, frame=0, timestamp=0, code_bits=5)
    for call in (accumulate, accumulate_by_step):
        with pytest.raises(IngestError, match=r"4 × 6 pixels and 5-bit.*8 × 8 pixels and 9-bit"):
            call(packet, small(), kernels=kernels)


def test_out_that_does_not_fit(small: Make) -> None:
    instrument = small()
    for out, message in (
        (np.zeros((8, 8, 256), np.uint16), r"shape \(8, 8, 256\): must be \(8, 8, 512\)"),
        (np.zeros((8, 8, 512), np.int32), "int32: must be uint16 or uint32"),
        (np.zeros((8, 8, 1024), np.uint16)[..., ::2], "C-contiguous"),
    ):
        with pytest.raises(HistogramError, match=message):
            accumulate(b"", instrument, out=out)  # pyright: ignore[reportArgumentType]


def test_unknown_policy_and_threads(small: Make) -> None:
    with pytest.raises(OverflowPolicyError, match="'wrap': must be one of error, saturate, widen"):
        accumulate(b"", small(), overflow="wrap")  # pyright: ignore[reportArgumentType]
    with pytest.raises(IngestError, match="threads = 0"):
        accumulate(b"", small(), threads=0)


def test_codes_that_do_not_fit(small: Make) -> None:
    for codes, message in (
        (np.zeros((3, 8, 9), np.uint16), r"shape \(3, 8, 9\)"),
        (np.zeros((8, 8)), "float64: must be integers"),
        (np.full((8, 8), 512), "code 512: must be from 0 to 511"),
        (np.full((8, 8), -1), "code -1"),
    ):
        with pytest.raises(HistogramError, match=message):
            accumulate_codes(codes, small())
