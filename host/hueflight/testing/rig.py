# SPDX-License-Identifier: Apache-2.0
"""What a rig must do so that captures, recordings and the daemon work with it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest

from hueflight.acquisition import Acquisition, RunPlan, RunResult
from hueflight.devices.errors import DeviceError
from hueflight.devices.illumination import CaptureKind
from hueflight.devices.rig import Connect
from hueflight.model.instrument import Instrument

BANDS: CaptureKind = "bands"


class RigChecks:
    """Tests of a rig; a subclass gives the fixtures `connect` and `instrument`.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of capture that the illumination can do, with one frame or more in each.
    frames : int
        Frames of a run, which the rig must deliver without loss.
    patience_s : float
        Seconds that a run may take.
    """

    kinds: ClassVar[tuple[CaptureKind, ...]] = ("scene",)
    frames: ClassVar[int] = 200
    patience_s: ClassVar[float] = 60.0

    @pytest.fixture
    def connect(self) -> Connect:
        """Return what opens the rig; to be given by the subclass."""
        raise NotImplementedError("give a fixture 'connect' that returns what opens the rig")

    @pytest.fixture
    def instrument(self) -> Instrument:
        """Return the instrument that the rig is; to be given by the subclass."""
        raise NotImplementedError("give a fixture 'instrument' that returns the rig's instrument")

    @pytest.fixture
    def acquisition(self, connect: Connect, instrument: Instrument) -> Iterator[Acquisition]:
        """Yield an acquisition with the rig."""
        made = Acquisition(connect, instrument)
        yield made
        made.close()

    def test_it_is_the_instrument_that_it_should_be(
        self, connect: Connect, instrument: Instrument
    ) -> None:
        """The camera has the geometry and the codes of the instrument."""
        rig = connect()
        try:
            rig.camera.require(instrument)
            assert rig.illumination.name, "the illumination must have a name"
        finally:
            rig.close()

    def test_it_can_be_opened_again(self, connect: Connect) -> None:
        """A rig that was closed, even twice, is free for the next program."""
        for _ in range(2):
            rig = connect()
            rig.close()
            try:
                rig.close()
            except DeviceError:
                continue  # that it is closed already may be an error, but no other one

    def test_the_illumination_can_be_told_that_all_is_well(self, connect: Connect) -> None:
        """A watchdog can be fed at any time, also while no run is in progress."""
        rig = connect()
        try:
            for _ in range(3):
                rig.illumination.keep_alive()
        finally:
            rig.close()

    def test_frames_and_counts_add_up(self, acquisition: Acquisition) -> None:
        """Of each kind of capture, every frame is exposed, delivered and counted once."""
        for kind in self.kinds:
            result = self._run(acquisition, RunPlan(kind=kind, frames=self.frames, keep=True))
            wanted = RunPlan(kind=kind, frames=self.frames).frame_limit(acquisition.instrument)
            totals = result.totals
            lost = sum(totals.losses.as_dict().values())
            assert totals.exposed == wanted, f"{kind}: {totals.exposed} of {wanted} frames exposed"
            assert lost == 0, f"{kind}: {lost} frames lost: {totals.losses}"
            assert totals.delivered == wanted
            self._check_counts(result, acquisition.instrument, kind)

    def test_runs_do_not_mix(self, acquisition: Acquisition) -> None:
        """A second run holds its own frames only."""
        for frames in (self.frames, self.frames // 2):
            result = self._run(acquisition, RunPlan(frames=frames, keep=True))
            assert result.totals.delivered == frames
            self._check_counts(result, acquisition.instrument, "scene")

    def test_a_run_without_a_limit_can_be_stopped(self, acquisition: Acquisition) -> None:
        """What was exposed until the stop is delivered, and the next run works."""
        future = acquisition.run(RunPlan(frames=0))
        deadline = time.monotonic() + self.patience_s
        while not acquisition.snapshot.run_frames:
            assert time.monotonic() < deadline, "no frame came"
            time.sleep(0.01)
        acquisition.stop()
        result = future.result(self.patience_s)
        assert result.failure == ""
        assert 0 < result.totals.delivered == result.totals.exposed
        assert self._run(acquisition, RunPlan(frames=self.frames)).totals.delivered == self.frames

    def _run(self, acquisition: Acquisition, plan: RunPlan) -> RunResult:
        result = acquisition.run(plan).result(self.patience_s)
        assert result.failure == "", result.failure
        assert result.gaps == ()
        return result

    def _check_counts(self, result: RunResult, instrument: Instrument, kind: CaptureKind) -> None:
        steps = sorted(result.histograms)
        if kind == BANDS:
            assert steps == list(range(len(instrument.bands))), (
                f"markers {steps} of a capture of kind 'bands': the marker of a frame is the "
                "number of the LED that fires"
            )
        photons = 0
        for histogram in result.histograms.values():
            assert histogram.shape == instrument.histogram_shape
            first = 1 if instrument.sensor.reports_empty else 0
            photons += int(histogram[..., first:].sum(dtype=np.int64))
            if instrument.sensor.reports_empty and kind != BANDS:
                assert (histogram.sum(axis=-1) == result.totals.delivered).all(), (
                    "each frame counts once in each pixel"
                )
        assert photons == result.photons
