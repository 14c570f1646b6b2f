# SPDX-License-Identifier: Apache-2.0
"""The formatter at the sensor's size, 192×128, compiled: bit-exactness and rate."""

from itertools import tee

import numpy as np
import pytest

from hueflight_hdl.camera.formatter.reference import SensorFrame, expected_packet
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.testbench.formatter import SimulatedFormatter
from hueflight_hdl.testbench.formatter_rate import measure_rates, random_codes
from hueflight_protocol import FrameFlags

FORM = FrameFormat()
MOST_CLOCKS = 3600  # at any occupancy: 27.7 kfps at 100 MHz


@pytest.fixture
def formatter(simulator):
    running = SimulatedFormatter(FORM)
    yield running
    running.close()


def test_clocks_per_frame(simulator):
    rates = list(measure_rates(FORM, frames=6))
    for rate in rates:
        assert FORM.beats - 10 < rate.clocks_mean  # a frame can't leave faster than it comes
        assert rate.clocks_max <= MOST_CLOCKS
        if rate.occupancy <= 0.7:
            assert rate.clocks_mean < FORM.beats + 10


def test_no_number_of_hits_takes_longer(formatter):
    """Every chunk with the same number of hits: all where dense or not is nearly even, and more."""
    pixels = FORM.run
    limit = FORM.chunk(last=False).dense_from
    numbers = [1, 8, *range(limit - 12, limit + 3), pixels - 1, pixels]
    rng = np.random.default_rng(2)
    frames = []
    for hits in numbers:
        for _ in range(3):
            chunks = np.zeros((FORM.chunks, pixels), np.uint16)
            for chunk in chunks:
                chunk[rng.permutation(pixels)[:hits]] = rng.integers(1, 512, hits)
            frames.append(SensorFrame(chunks.reshape(FORM.rows, FORM.cols)))
    for number, packet in enumerate(formatter.packets(frames)):
        assert packet == expected_packet(FORM, frames[number], sequence=number)
    assert max(np.diff(formatter.ended)) <= MOST_CLOCKS


def draw(rng, number):
    """A frame of any occupancy and filters, now and then one that is aborted."""

    def window(count):
        first, last = (int(value) for value in np.sort(rng.integers(0, count, 2)))
        return {"first": first, "last": last if rng.random() < 0.9 else 0xFFFF}

    occupancy = rng.choice([0.0, 0.02, 0.3, 0.7, 0.88, 1.0, rng.random()])
    codes = random_codes(rng, FORM, occupancy)
    if rng.random() < 0.3:  # dark and bright chunks in one frame
        codes[: int(rng.integers(FORM.rows))] *= np.uint16(rng.integers(2))
    info = {
        "timestamp": int(rng.integers(1 << 63)),
        "frame": number,
        "periods": int(rng.integers(1 << 32)),
        "dropped": int(rng.integers(1 << 32)),
        "flags": int(FrameFlags.TRIGGER_LOST) * int(rng.integers(2)),
        "step": int(rng.integers(1 << 16)),
        "capture": int(rng.integers(1 << 32)),
    }
    filters = {
        "mask": int(rng.integers(2)),
        "roi": int(rng.random() < 0.3),
        "gate": int(rng.random() < 0.3),
        "rows": window(FORM.rows),
        "cols": window(FORM.cols),
        "codes": window(1 << FORM.code_bits),
    }
    abort_after = int(rng.integers(1, FORM.beats)) if rng.random() < 0.1 else None
    return SensorFrame(codes, info, filters, abort_after)


def check(formatter, *, frames, seed, sensor_pause, link_pause, first=0, mask=None):
    rng = np.random.default_rng(seed)
    source = (draw(rng, first + number) for number in range(frames))
    sent, kept = tee(source)
    packets = formatter.packets(sent, seed=seed, sensor_pause=sensor_pause, link_pause=link_pause)
    seen = 0
    for frame, packet in zip(kept, packets, strict=True):
        expected = expected_packet(FORM, frame, mask, sequence=first + seen)
        assert packet == expected, f"frame {first + seen}"
        seen += 1
    assert seen == frames
    return first + seen


PAUSES = [(0, 0), (0.3, 0), (0, 0.3), (0.2, 0.5), (0.6, 0.1)]
"""Shares of clocks in which the sensor has no beat, and in which the link takes no word."""


def run_all(formatter, *, frames, seed):
    mask = np.random.default_rng(seed).random((FORM.rows, FORM.cols)) < 0.02
    formatter.set_mask(mask)
    number = 0
    for round_, (sensor_pause, link_pause) in enumerate(PAUSES):
        number = check(
            formatter,
            frames=frames // len(PAUSES),
            seed=seed + round_,
            sensor_pause=sensor_pause,
            link_pause=link_pause,
            first=number,
            mask=mask,
        )
    return number


def test_equals_encoder(formatter):
    assert run_all(formatter, frames=40, seed=1) == 40


@pytest.mark.slow
def test_thousands_of_frames_equal_encoder(formatter):
    assert run_all(formatter, frames=3000, seed=100) == 3000
