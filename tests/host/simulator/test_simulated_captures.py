# SPDX-License-Identifier: Apache-2.0
"""Captures by kind, as histograms and as packets."""

from itertools import pairwise

import numpy as np
import pytest

from hueflight import Instrument
from hueflight.errors import SceneError
from hueflight.simulator import (
    CAPTURES,
    SimulationSettings,
    exposures,
    scene,
    simulate_capture,
    simulate_codes,
    simulate_packets,
)
from hueflight_protocol import FrameFlags, decode_frame


@pytest.fixture(scope="module")
def small(paper, resized):
    return resized(paper, 8, 6)


QUIET = SimulationSettings(hot_share=0, dead_share=0)


def occupancy(histogram):
    return 1 - histogram[..., 0].mean() / histogram.sum(axis=-1).mean()


def test_reference_is_bright_and_reports_its_empty_exposures(small):
    # white at 0.40 m: 0.35 · 6.25 photons, background on top; 5 sigma of 48 pixels' counts
    histogram = simulate_capture("reference", small, frames=20_000, settings=QUIET)
    assert occupancy(histogram) == pytest.approx(
        1 - np.exp(-0.35 * 6.25 - 0.007 - 0.028), abs=0.004
    )
    dimmed = simulate_capture("reference", small, frames=20_000, settings=QUIET.replace(drive=0.16))
    assert occupancy(dimmed) == pytest.approx(1 - np.exp(-0.35 - 0.007 - 0.028), abs=0.006)


def test_one_led_at_a_time_adds_up_to_the_reference(small):
    bands = simulate_capture("bands", small, frames=20_000, settings=QUIET)
    assert bands.shape == (9, *small.histogram_shape)
    light = -np.log(bands[..., 0] / 20_000).mean(axis=(1, 2))
    dark = simulate_capture("dark", small, frames=200_000, settings=QUIET)
    background = -np.log(dark[..., 0] / 200_000).mean()
    together = simulate_capture("reference", small, frames=20_000, settings=QUIET)
    total = -np.log(together[..., 0] / 20_000).mean()
    assert (light - background).sum() == pytest.approx(total - background, rel=0.02)
    # each lights its own time only: the brightest code goes down as the delay goes up
    brightest = bands[..., 1:].sum(axis=(1, 2)).argmax(axis=-1)
    assert all(later < earlier for earlier, later in pairwise(brightest))


def test_dark_and_flat_have_no_pulses(small):
    for kind, settings in (("dark", QUIET), ("flat", QUIET.replace(dnl_lsb=0, inl_lsb=0))):
        histogram = simulate_capture(kind, small, frames=60_000, settings=settings)
        counts = histogram[..., 1:499].sum(axis=(0, 1)).astype(float)
        # false alarm rate 1e-5 over 498 codes, seeded; 10 % for uneven codes in the dark
        slack = 0.3 if kind == "dark" else 0.0
        limit = 5.7 * np.sqrt(counts.mean()) + slack * counts.mean()
        assert np.abs(counts - counts.mean()).max() < limit
    assert occupancy(simulate_capture("flat", small, frames=1000, settings=QUIET)) > 0.25


def test_every_kind_of_capture_draws_its_own_noise(small):
    view = scene("plane", small, distance=0.40)
    a = simulate_capture("scene", small, scene=view, frames=500)
    b = simulate_capture("reference", small, scene=view, frames=500)
    assert (a != b).any()


def test_exposures_say_what_they_are(small):
    parts = exposures("bands", small, settings=QUIET.replace(drive=0.5))
    drives = np.array([part.settings.drive for part in parts])
    np.testing.assert_array_equal(drives, 0.5 * np.eye(9))
    (dark,) = exposures("dark", small)
    assert dark.settings.drive == 0
    assert set(CAPTURES) == {"scene", "reference", "bands", "dark", "flat"}
    with pytest.raises(SceneError, match="no capture 'flash'"):
        exposures("flash", small)
    with pytest.raises(SceneError, match="needs a scene"):
        exposures("scene", small)


# -- packets ----------------------------------------------------------------------------------


def decoded(packets):
    return [decode_frame(packet) for packet in packets]


def test_packets_carry_the_codes_of_simulate_codes(small):
    view = scene("fig1", small)
    options = {"scene": view, "frames": 20, "settings": QUIET, "seed": 7}
    frames = decoded(simulate_packets("scene", small, **options, capture=3))
    wanted = np.concatenate(
        list(simulate_codes(view, small, frames=20, settings=QUIET, seed=(7, 0, 0, 0)))
    )
    assert len(frames) == 20
    for number, (frame, codes) in enumerate(zip(frames, wanted, strict=True)):
        np.testing.assert_array_equal(frame.codes, codes)
        header = frame.header
        assert (header.sequence, header.frame, header.step, header.capture) == (
            number,
            number,
            0,
            3,
        )
        assert header.periods == 3125
        assert header.flags & FrameFlags.SIMULATED
        assert header.timestamp == round(number / 480 * header.clock_hz)


def test_packets_that_cannot_be_are_refused_at_once(small, resized):
    with pytest.raises(SceneError, match="needs a scene"):
        simulate_packets("scene", small, frames=1)
    with pytest.raises(SceneError, match="no code for an empty exposure"):
        simulate_packets("dark", resized(small, 8, 6, code_zero="bin"), frames=1)


def test_step_markers_count_leds(small):
    frames = decoded(simulate_packets("bands", small, frames=40, settings=QUIET))
    assert [frame.header.step for frame in frames] == [led for led in range(9) for _ in range(40)]
    # LED of the step by its light: strongest codes fall from step to step
    means = [
        np.concatenate([f.codes[f.codes > 0] for f in frames[led * 40 : led * 40 + 40]])
        for led in range(9)
    ]
    medians = [np.median(codes) for codes in means]
    assert all(later < earlier for earlier, later in pairwise(medians))


def test_step_markers_count_positions_of_a_scanned_sensor(resized):
    line = Instrument.load("line1024")
    small_line = resized(line, 2, 8, scan_steps=3)
    view = scene("plane", small_line)
    frames = decoded(simulate_packets("scene", small_line, scene=view, frames=5, settings=QUIET))
    assert [frame.header.step for frame in frames] == [0] * 5 + [1] * 5 + [2] * 5
    assert all(frame.codes.shape == (2, 8) for frame in frames)
    bands = decoded(simulate_packets("bands", small_line, frames=1, settings=QUIET))
    assert [frame.header.step for frame in bands] == list(range(27))
    assert [frame.header.sequence for frame in bands] == list(range(27))
