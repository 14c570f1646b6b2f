# SPDX-License-Identifier: Apache-2.0
"""The fit from picture to picture: pixels that did not change keep their estimates for a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hueflight as hf
from hueflight.daemon.incremental_fitter import (
    GROWN_S,
    GROWTH,
    REFRESH_S,
    IncrementalFitter,
    growth_steps,
)
from hueflight.reconstruction.quality import Quality


def test_what_is_still_is_not_fitted_again_unless_the_kept_fits_know_less(
    small: Callable[..., hf.Instrument], draw: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = small(rows=24, cols=24)
    calibration = hf.calibrate(draw(wide, photons=20_000), wide, distance=0.5)
    now_s = 1000.0  # stands still, so that no pixel's turn comes unasked
    monkeypatch.setattr("hueflight.daemon.incremental_fitter.time.monotonic", lambda: now_s)
    fitter = IncrementalFitter(change_sigma=4.0, threads=1)

    def skipped(frames: int, seed: int) -> float:
        counts = draw(wide, depth=0.9, photons=1.3 * frames, frames=frames, seed=seed)
        image = fitter.fit(counts.astype(np.uint16), calibration, frames)
        return float((image["quality"].values & int(Quality.SKIPPED) != 0).mean())

    assert skipped(100, seed=1) == 0
    assert skipped(400, seed=2) == 0  # four times the frames: nothing old is good enough
    # 11 contrasts beyond 4 sigma: 7e-4 a pixel; 5 of 576 by chance in 1 run of 10 000
    assert skipped(400, seed=3) > 0.99
    assert skipped(300, seed=4) > 0.99
    now_s += REFRESH_S + 1
    assert skipped(400, seed=5) == 0  # all had their turn meanwhile
    calibration = hf.calibrate(draw(wide, photons=20_000, seed=9), wide, distance=0.5)
    assert skipped(400, seed=6) == 0
    every = IncrementalFitter(change_sigma=0.0, threads=1)
    for seed in (7, 8):
        counts = draw(wide, depth=0.9, photons=500, frames=400, seed=seed)
        image = every.fit(counts.astype(np.uint16), calibration, 400)
        expected = hf.reconstruct(counts.astype(np.uint16), calibration)
        np.testing.assert_array_equal(image["depth"], expected["depth"])


@pytest.mark.parametrize("pictures", [3, 8, 200, 1000])
def test_every_pixel_has_its_turn_once_in_a_while(
    small: Callable[..., hf.Instrument],
    draw: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    pictures: int,
) -> None:
    """The same in each picture, whatever their rate: of the very same counts none has changed."""
    wide = small(rows=24, cols=24)
    calibration = hf.calibrate(draw(wide, photons=20_000), wide, distance=0.5)
    counts = draw(wide, depth=0.9, photons=500, frames=400, seed=2).astype(np.uint16)
    now_s = 1000.0
    monkeypatch.setattr("hueflight.daemon.incremental_fitter.time.monotonic", lambda: now_s)
    fitter = IncrementalFitter(change_sigma=4.0, threads=1)
    fitter.fit(counts, calibration, 400)
    fitted = np.zeros((24, 24), int)
    for _ in range(pictures):
        now_s += REFRESH_S / pictures
        image = fitter.fit(counts, calibration, 400)
        now = image["quality"].values & int(Quality.SKIPPED) == 0
        # none too many at once; times are rounded, and unusable pixels are not fitted at all
        assert now.sum() <= 24 * 24 / pictures + 1
        fitted += now
    # 2e-13 s of rounding in a thousand additions may leave out the very last
    assert (fitted <= 1).all()
    assert fitted.sum() >= calibration.usable.sum() - 1


def test_steps_of_growth_are_spread_over_the_pixels() -> None:
    """While the frames grow by a factor of G, each pixel takes one step, few at a time."""
    before = growth_steps(np.full((20, 50), 1000))
    taken = np.zeros((20, 50), int)
    for part in range(1, 11):
        now = growth_steps(np.full((20, 50), round(1000 * GROWTH ** (part / 10))))
        assert (now - before).sum() == pytest.approx(100, abs=8)
        taken += now - before
        before = now
    assert (taken == 1).mean() > 0.99  # frames are whole numbers


def test_pixels_that_begin_anew_are_fitted_at_once(
    small: Callable[..., hf.Instrument], draw: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = small(rows=24, cols=24)
    calibration = hf.calibrate(draw(wide, photons=20_000), wide, distance=0.5)
    monkeypatch.setattr("hueflight.daemon.incremental_fitter.time.monotonic", lambda: 1000.0)
    fitter = IncrementalFitter(change_sigma=4.0)
    counts = draw(wide, depth=0.9, photons=5000, frames=4000, seed=1).astype(np.uint16)
    frames = np.full((24, 24), 4000)
    fitter.fit(counts, calibration, frames)

    def fitted() -> np.ndarray:
        image = fitter.fit(counts, calibration, frames)
        return (image["quality"].values & int(Quality.SKIPPED)) == 0

    assert not (fitted() & calibration.usable).any()
    part = (slice(3, 9), slice(5, 20))
    counts[part] = draw(wide, depth=0.9, photons=100, frames=80, seed=2)[part]
    frames[part] = 80
    wanted = np.zeros((24, 24), bool)
    wanted[part] = True
    assert np.array_equal(fitted() & calibration.usable, wanted & calibration.usable)
    frames = np.full((24, 24), 8000)
    assert fitted().all()  # far more frames than any fit that was kept


def test_pixels_whose_frames_have_grown_share_the_pictures_of_a_second(
    small: Callable[..., hf.Instrument], draw: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = small(rows=24, cols=24)
    calibration = hf.calibrate(draw(wide, photons=20_000), wide, distance=0.5)
    now_s = 1000.0
    monkeypatch.setattr("hueflight.daemon.incremental_fitter.time.monotonic", lambda: now_s)
    fitter = IncrementalFitter(change_sigma=4.0)
    counts = draw(wide, depth=0.9, photons=500, frames=400, seed=2).astype(np.uint16)
    fitter.fit(counts, calibration, np.full((24, 24), 400))
    fitted = np.zeros((24, 24), int)
    for _ in range(10):
        now_s += GROWN_S / 10
        image = fitter.fit(counts, calibration, np.full((24, 24), round(400 * GROWTH**1.01)))
        now = image["quality"].values & int(Quality.SKIPPED) == 0
        # those of growth, and those whose turn has come anyway
        assert 57 <= now.sum() <= 58 + 24 * 24 * GROWN_S / 10 / REFRESH_S + 1
        fitted += now
    assert (fitted >= 1).sum() >= 570  # 57 in each picture
