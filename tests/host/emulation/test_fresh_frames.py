# SPDX-License-Identifier: Apache-2.0
"""Photons of the simulated camera: new ones for every frame, or a stated bank."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import hueflight as hf
from hueflight.devices import DeviceGoneError, DeviceNotFoundError
from hueflight.devices.simulation import Repetition
from hueflight.emulation.fresh_frames import FreshFrames
from hueflight.emulation.simulated_rig import SimulatedInstrument
from hueflight_protocol import decode_frame

Small = Callable[..., hf.Instrument]
WAIT_S = 60.0


@pytest.fixture(scope="module")
def tiny(small: Small) -> hf.Instrument:
    return small(rows=8, cols=6, frame_rate_hz=480.0, exposure_ms=1.0)


@pytest.fixture
def fresh(tiny: hf.Instrument) -> Iterator[FreshFrames]:
    made = FreshFrames("reference", tiny, scene="fig1", distance=0.4, seed=3)
    yield made
    made.close()


def codes(frames: FreshFrames, number: int) -> np.ndarray:
    """Codes of so many frames, none of which is repeated."""
    found = []
    deadline = time.monotonic() + WAIT_S
    while len(found) < number:
        before = frames.repeated
        template = frames.template(len(found))
        if frames.repeated == before:
            found.append(decode_frame(template.stamp(sequence=0, timestamp=0, frame=0)).codes)
        else:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    return np.stack(found)


def test_every_frame_has_photons_of_its_own(fresh: FreshFrames, tiny: hf.Instrument) -> None:
    """More frames than wait, all different, and their sum is that of the simulator."""
    seen = codes(fresh, 3000)
    assert len({frame.tobytes() for frame in seen}) == 3000
    expected = hf.simulator.simulate_capture("reference", tiny, frames=100_000, seed=9)
    lit = (seen > 0).mean()
    share = expected[..., 1:].sum() / expected.sum()
    # 3000 frames of 48 pixels; false alarm 6e-7 at five standard deviations
    assert abs(lit - share) < 5 * np.sqrt(share * (1 - share) / seen.size)


@pytest.mark.slow
def test_a_seed_gives_the_same_frames(tiny: hf.Instrument) -> None:
    found = []
    for seed in (3, 3, 4):
        frames = FreshFrames("reference", tiny, scene="fig1", distance=0.4, seed=seed)
        found.append(codes(frames, 50))
        frames.close()
    assert (found[0] == found[1]).all()
    assert (found[0] != found[2]).any()


def test_leds_fire_one_at_a_time_in_order(tiny: hf.Instrument) -> None:
    frames = FreshFrames("bands", tiny, scene="fig1", distance=0.4, seed=3, frames=10)
    taken = [frames.template(number) for number in range(10 * len(tiny.bands))]
    assert frames.repeated == 0  # faster than they are drawn, none is left out
    stamped = (template.stamp(sequence=0, timestamp=0, frame=0) for template in taken)
    steps = [decode_frame(packet).header.step for packet in stamped]
    frames.close()
    assert steps == [band for band in range(len(tiny.bands)) for _ in range(10)]


def test_when_the_process_ends_the_camera_is_gone(fresh: FreshFrames) -> None:
    fresh._process.terminate()
    fresh._process.join()

    def take_all() -> None:
        deadline = time.monotonic() + WAIT_S
        while time.monotonic() < deadline:
            fresh.template(0)

    with pytest.raises(DeviceGoneError, match="draws photons"):
        take_all()


def test_what_is_repeated_is_stated(tiny: hf.Instrument, small: Small) -> None:
    assert SimulatedInstrument(tiny, frames=64).repetition() == Repetition(64, 0)
    assert SimulatedInstrument(tiny).repetition() == Repetition(None, 0)
    fast = small(rows=192, cols=128, frame_rate_hz=18_600.0, exposure_ms=0.02)
    assert SimulatedInstrument(fast).repetition() == Repetition(960, 0)


def test_the_cable_can_be_pulled(tiny: hf.Instrument) -> None:
    simulated = SimulatedInstrument(tiny, frames=4)
    camera = simulated.open_camera()
    simulated.prepare("reference", 0)
    camera.configure(tiny)
    camera.start()
    deadline = time.monotonic() + WAIT_S
    while not camera.read(0.1):
        assert time.monotonic() < deadline
    simulated.plugged = False
    with pytest.raises(DeviceGoneError, match="unplugged"):
        camera.read(0.1)
    with pytest.raises(DeviceGoneError, match="unplugged"):
        camera.running()
    with pytest.raises(DeviceNotFoundError, match="unplugged"):
        simulated.open_camera()
    simulated.plugged = True
    assert simulated.open_camera().running()  # it went on meanwhile, as a real one does


def test_a_calibration_comes_along(tiny: hf.Instrument) -> None:
    """It gives the depth of a target at another distance."""
    calibration = SimulatedInstrument(tiny, frames=4).calibrate(tiny)
    assert calibration.distance == 0.4
    counts = hf.simulator.simulate_capture("reference", tiny, frames=20_000, distance=0.6, seed=5)
    image = hf.reconstruct(counts, calibration)
    assert float(image.depth.median()) == pytest.approx(0.6, abs=0.01)


def test_an_end_during_the_calibration_leaves_nothing_behind(tiny: hf.Instrument) -> None:
    """Not even semaphores, of which Python would warn when the program has ended."""
    program = """
import multiprocessing, os, signal, sys, threading, time
import hueflight as hf
from hueflight.emulation.simulated_rig import SimulatedInstrument
simulated = SimulatedInstrument(hf.Instrument.from_json(sys.argv[1]))
threading.Thread(target=simulated.calibrate, args=(simulated.instrument,), daemon=True).start()
while not multiprocessing.active_children():
    time.sleep(0.01)
os.kill(os.getpid(), signal.SIGTERM)
"""
    ended = subprocess.run(
        [sys.executable, "-c", program, tiny.to_json()],
        capture_output=True, text=True, timeout=WAIT_S, check=False,
    )  # fmt: skip
    assert (ended.returncode, ended.stderr) == (-signal.SIGTERM, "")


def test_an_error_of_the_process_that_draws_is_passed_on(tiny: hf.Instrument) -> None:
    with pytest.raises(hf.HueflightError, match="nowhere"):
        SimulatedInstrument(tiny, scene="nowhere", frames=4).prepare("scene", 4)


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="no real-time priorities here")
def test_drawing_does_not_keep_the_priority_of_acquisition(tiny: hf.Instrument) -> None:
    """A process has the scheduling of the thread that starts it; in real time it slows all others.

    Batches stand for real time here, which takes a permission.
    """
    found: list[Any] = []

    def start() -> None:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        frames = FreshFrames("reference", tiny, scene="fig1", distance=0.4, seed=3)
        found.append(os.sched_getscheduler(frames._process.pid or 0))
        frames.close()

    with ThreadPoolExecutor(1) as thread:
        thread.submit(start).result()
    assert found == [os.SCHED_OTHER]
