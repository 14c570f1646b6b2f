# SPDX-License-Identifier: Apache-2.0
"""A simulated scene that moves, and delays that drift, while the camera runs."""

from __future__ import annotations

import time

import numpy as np
import pytest

import hueflight as hf
from hueflight.devices import DeviceError
from hueflight.devices.simulation import Changes
from hueflight.emulation.fresh_frames import FreshFrames
from hueflight.emulation.live_photons import BALL_AWAY_M, BLOCK, PLACES, LivePhotons
from hueflight.emulation.simulated_rig import SimulatedInstrument
from hueflight.simulator import scene
from hueflight.simulator.named_scenes import BALL_RADIUS_M
from hueflight_protocol import decode_frame
from support.small_daemon import small_instrument

WAIT_S = 60.0
SPACING_NS = 30.0  #: from pulse to pulse of the paper's train


@pytest.fixture(scope="module")
def small_one(tmp_path_factory: pytest.TempPathFactory) -> hf.Instrument:
    """The paper's field of view with larger pixels."""
    folder = tmp_path_factory.mktemp("instrument")
    return hf.Instrument.load(small_instrument(folder, rows=24, cols=16, frame_rate_hz=480.0))


def codes(packets: list[bytes]) -> np.ndarray:
    return np.stack([decode_frame(packet).codes for packet in packets])


def test_a_ball_is_where_it_was_put(small_one: hf.Instrument) -> None:
    seen = scene("plane", small_one, ball=(0.0, 0.0, 0.5), distance=1.0)
    ball = seen.regions["ball"]
    rows, cols = np.nonzero(ball)
    # the middle of the picture lies between its pixels
    assert abs(rows.mean() - 11.5) < 1
    assert abs(cols.mean() - 7.5) < 1
    nearest = seen.truth(small_one).depth.min()
    assert 0.5 - BALL_RADIUS_M - 1e-9 <= nearest < 0.5 - 0.7 * BALL_RADIUS_M
    with pytest.raises(hf.HueflightError, match="must be positive"):
        scene("plane", small_one, ball=(0.0, 0.0, -0.5))


def test_the_ball_moves_from_side_to_side(small_one: hf.Instrument) -> None:
    """Near and white, it is the brightest thing: the brightest column is where it is."""
    photons = LivePhotons("scene", small_one, "empty", 0.4, 1)
    still = (codes(photons.packets()) > 0).mean(axis=0)
    photons.changes = Changes(moving=True)
    found = []
    for _ in range(2 * PLACES - 2):
        light = (codes(photons.packets()) > 0).mean(axis=0) - still
        found.append(float((np.maximum(light, 0.3) - 0.3).sum(axis=0) @ np.arange(16)))
        found[-1] /= (np.maximum(light, 0.3) - 0.3).sum()
    there, back = np.array(found[:PLACES]), np.array(found[PLACES - 1 :])
    assert abs(there[0] - there[-1]) > 8  # of 16 columns
    assert (np.sign(np.diff(there)) == np.sign(there[-1] - there[0])).mean() > 0.7
    assert (np.sign(np.diff(back)) == np.sign(there[0] - there[-1])).mean() > 0.7
    photons.changes = Changes()
    again = (codes(photons.packets()) > 0).mean(axis=0)
    assert np.abs(again - still).max() < 0.5  # two blocks of 128: a difference of 0.5 is 9 sigma
    assert BALL_AWAY_M > 0.4


def test_delays_drift_as_they_should(small_one: hf.Instrument) -> None:
    """The phase of the train of pulses, which are 30 ns apart, turns by the delay."""
    times = small_one.time_bins()
    in_time = np.zeros(small_one.sensor.codes)
    in_time[times.codes] = (times.edges_ns[:-1] + times.edges_ns[1:]) / 2

    def delay_ns(photons: LivePhotons) -> tuple[float, float]:
        """Delay modulo 30 ns, and its standard error."""
        seen = np.concatenate([codes(photons.packets()) for _ in range(8)])
        turning = np.exp(2j * np.pi * in_time[seen[seen > 0]] / SPACING_NS)
        error = SPACING_NS / (2 * np.pi * abs(turning.mean()) * np.sqrt(2 * turning.size))
        return float(np.angle(turning.mean()) * SPACING_NS / (2 * np.pi)), float(error)

    photons = LivePhotons("reference", small_one, "fig1", 0.4, 1)
    before, error = delay_ns(photons)
    per_s = 1000.0
    photons.changes = Changes(drift_ps_per_s=per_s)
    for _ in range(8):
        photons.packets()
    assert photons.delay_ps == pytest.approx(per_s * 8 * BLOCK / 480)
    after, _ = delay_ns(photons)
    expected_ns = 1e-3 * per_s * 12.5 * BLOCK / 480  # the mean of the next eight blocks
    assert expected_ns > 3
    assert error < 0.05
    # by chance one run in 1.7 million differs by five standard errors
    assert after - before == pytest.approx(expected_ns, abs=5 * np.hypot(error, error))
    photons.changes = Changes()
    photons.packets()
    assert photons.delay_ps == 0


def test_changes_reach_the_process_that_draws(small_one: hf.Instrument) -> None:
    frames = FreshFrames("reference", small_one, scene="fig1", distance=0.4, seed=3)
    try:
        frames.change(Changes(drift_ps_per_s=100.0))
        deadline = time.monotonic() + WAIT_S
        number = 0
        while not frames.delay_ps:
            assert time.monotonic() < deadline
            frames.template(number)
            number += 1
            time.sleep(0.001)
    finally:
        frames.close()


def test_frames_that_are_repeated_can_not_change(small_one: hf.Instrument) -> None:
    simulated = SimulatedInstrument(small_one, frames=64)
    with pytest.raises(DeviceError, match="repeats 64 frames"):
        simulated.change(Changes(moving=True))
    drawn = SimulatedInstrument(small_one)
    drawn.change(Changes(moving=True))
    assert drawn.changes.moving
    assert drawn.delay_ps == 0
