# SPDX-License-Identifier: Apache-2.0
"""Where a scene has changed: sums by hand, exact probabilities of SciPy, false alarms and power."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage, stats

from hueflight import backend
from hueflight.ingest import scene_change
from hueflight.ingest.kernels import available
from hueflight.ingest.numpy_scene_change import count_significance, shift_weights
from hueflight.ingest.scene_change import TILE, changed_tiles, grown, tile_counts


@pytest.mark.parametrize("reports_empty", [True, False])
@pytest.mark.parametrize("shape", [(8, 8, 512), (13, 10, 300), (3, 5, 16)])
@pytest.mark.parametrize("frames", [100, 60_000])
def test_counts_of_tiles_are_sums(
    shape: tuple[int, int, int], frames: int, reports_empty: bool
) -> None:
    rng = np.random.default_rng(4)
    counts = rng.integers(0, frames, shape, endpoint=True).astype(np.uint16)
    size = -(-shape[2] // scene_change.GROUPS)
    wanted = np.zeros((-(-shape[0] // TILE), -(-shape[1] // TILE), -(-shape[2] // size)))
    for (row, col, code), count in np.ndenumerate(counts):
        if code or not reports_empty:
            wanted[row // TILE, col // TILE, code // size] += count
    assert np.array_equal(tile_counts(counts, reports_empty=reports_empty), wanted)


def test_a_burst_is_seen_with_any_number_of_groups() -> None:
    """The windows of groups need not divide them."""
    earlier = np.full((1, 1, 37), 1000.0)
    for place in (0, 18, 36):
        counts = earlier.copy()
        counts[..., place] += 6000
        frames = np.full((1, 1), 1000.0)
        assert scene_change.changed_tiles(counts, frames, earlier, frames).all()
        assert not scene_change.changed_tiles(earlier, frames, earlier, frames).any()


def test_shift_weights_are_relative_slopes_of_smoothed_counts() -> None:
    """Smoothed by another implementation, the ends repeated."""
    counts = np.random.default_rng(8).poisson(40.0, (3, 5, 37)).astype(float)
    smooth = ndimage.convolve1d(counts, np.array([1, 4, 6, 4, 1]) / 16, mode="nearest")
    floor = 1 + 0.05 * smooth.mean(axis=-1, keepdims=True)
    wanted = np.gradient(smooth, axis=-1) / (smooth + floor)
    np.testing.assert_allclose(shift_weights(counts), wanted, rtol=1e-12, atol=1e-15)


def test_significance_is_that_of_the_exact_binomial_test() -> None:
    """Of n photons in all, those of the newer side are binomial if nothing has changed."""
    for ratio in (0.01, 0.1, 1.0):
        for earlier in (5, 40, 1000, 50_000):
            expected = earlier * ratio
            for seen in {
                int(expected * factor) + add for factor in (0, 0.5, 1, 2) for add in (2, 9)
            }:
                share = ratio / (1 + ratio)
                law = stats.binom(seen + earlier, share)
                above = law.sf(seen) + 0.5 * law.pmf(seen)  # mid-p
                exact = abs(stats.norm.isf(above))
                found = count_significance(
                    np.array(float(seen)), np.array(expected), np.array(expected * ratio),
                    np.array(ratio),
                )  # fmt: skip
                if exact < 8:  # farther out, SciPy's probabilities round to 0 or 1
                    assert found == pytest.approx(exact, abs=0.2), (ratio, earlier, seen)


def test_photons_where_there_were_none() -> None:
    """The probability that all n photons fall to the newer side is share ** n."""
    none = np.array(0.0)
    found = count_significance(np.array(7.0), none, none, np.array(0.1))
    assert found == pytest.approx(np.sqrt(2 * 7 * np.log(1.1 / 0.1)))
    assert count_significance(none, none, none, np.array(0.1)) == 0


def test_weights_are_the_relative_derivative() -> None:
    """Of a Gaussian pulse of width s, that is -(x - x0) / s² where there is light."""
    x = np.arange(128.0)
    pulse = 1e6 * np.exp(-((x - 60) ** 2) / (2 * 8**2))
    near = slice(50, 71)  # smoothing widens the pulse by a variance of one group²
    assert shift_weights(pulse)[near] == pytest.approx(
        -(x - 60)[near] / (8**2 + 1), rel=0.2, abs=3e-3
    )


def pulses(delay: float, brightness: float = 1.0) -> np.ndarray:
    """Mean photons per pixel and frame in 128 groups: three pulses on a floor."""
    x = np.arange(128)
    light = sum(np.exp(-((x - at - delay) ** 2) / (2 * 2.5**2)) for at in (20, 60, 100))
    return brightness * (0.2 * light / light.sum() + 0.02 / 128)


def drawn(mean: np.ndarray, frames: int, tiles: int, rng: np.random.Generator) -> np.ndarray:
    return rng.poisson(mean * frames * TILE * TILE, (tiles, tiles, mean.size)).astype(float)


@pytest.mark.parametrize(("frames", "earlier_frames"), [(48, 48), (48, 4800), (500, 100_000)])
def test_false_alarms_are_as_rare_as_stated(frames: int, earlier_frames: int) -> None:
    """At 4 sigma, each of 18 contrasts on each of three levels exceeds with 6.3e-5 by chance."""
    rng = np.random.default_rng(8)
    tiles, mean, alarms, rounds = 16, pulses(0.0), 0, 40
    for _ in range(rounds):
        alarms += changed_tiles(
            drawn(mean, frames, tiles, rng), np.full((tiles, tiles), float(frames)),
            drawn(mean, earlier_frames, tiles, rng), np.full((tiles, tiles), float(earlier_frames)),
            sigma=4.0,
        ).sum()  # fmt: skip
    # a tile by itself 18 × 6.3e-5 = 1.1e-3: 11.6 in 10240 tiles; a square adds 16 at once, 40 × 16
    # squares 0.7 of them. Three times the sum of both has a chance below 1e-6
    assert alarms < 3 * (12 + 16)


def test_changes_are_seen_when_the_photons_suffice() -> None:
    rng = np.random.default_rng(9)
    still = drawn(pulses(0.0), 48, 16, rng)
    before = drawn(pulses(0.0), 4800, 16, rng)
    frames, many = np.full((16, 16), 48.0), np.full((16, 16), 4800.0)

    def changed(part: np.ndarray, where: tuple[slice, slice]) -> np.ndarray:
        now = still.copy()
        now[where] = part[where]
        return changed_tiles(now, frames, before, many)

    one = (slice(5, 6), slice(7, 8))
    # 154 photons in a tile: twice as many are 9 sigma more, a shift by 4 groups 12 sigma
    for part in (pulses(0.0, 2.0), pulses(4.0)):
        seen = changed(drawn(part, 48, 16, rng), one)
        assert seen.sum() == 1
        assert seen[one].all()
    # a shift by 0.4 groups is lost in a tile and plain in all of them
    shifted = drawn(pulses(0.4), 48, 16, rng)
    assert not changed(shifted, one).any()
    assert changed(shifted, (slice(0, 16), slice(0, 16))).all()


def test_small_drifts_of_brightness_are_tolerated() -> None:
    """One percent of 154 million photons is 124 standard deviations, and within the tolerance."""
    frames = np.full((4, 4), 4.8e7)
    mean = np.broadcast_to(pulses(0.0), (4, 4, 128)) * 4.8e7 * 16
    assert not changed_tiles(1.01 * mean, frames, mean, frames).any()
    assert changed_tiles(1.2 * mean, frames, mean, frames).all()


def test_small_shifts_are_tolerated() -> None:
    """By half a hundredth of a group; a whole one is not."""
    frames = np.full((4, 4), 4.8e7)
    still, within, beyond = (
        np.broadcast_to(pulses(delay), (4, 4, 128)) * 4.8e7 * 16 for delay in (0.0, 0.005, 1.0)
    )
    assert not changed_tiles(within, frames, still, frames).any()
    assert changed_tiles(beyond, frames, still, frames).all()


def test_tiles_without_frames_are_not_compared() -> None:
    rng = np.random.default_rng(2)
    now, frames = drawn(pulses(0.0), 48, 8, rng), np.full((8, 8), 48.0)
    none = np.zeros((8, 8))
    assert not changed_tiles(now, frames, np.zeros_like(now), none).any()
    assert not changed_tiles(np.zeros_like(now), none, now, frames).any()


def test_grown_adds_the_eight_neighbors() -> None:
    mask = np.zeros((5, 6), bool)
    mask[0, 2] = mask[4, 5] = True
    wanted = np.zeros((5, 6), bool)
    wanted[:2, 1:4] = wanted[3:, 4:] = True
    assert np.array_equal(grown(mask), wanted)


@pytest.mark.skipif(not backend.available("ingest"), reason="the kernels are not compiled here")
@given(
    seed=st.integers(0, 999),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(2, 140)),
    size=st.sampled_from([1, 4, 16]),
)
def test_the_compiled_significance_is_that_of_its_definition(
    seed: int, shape: tuple[int, int, int], size: int
) -> None:
    """Of few and of many photons, and of tiles that are empty or left out."""
    rng = np.random.default_rng(seed)
    mean = rng.choice([0.0, 0.01, 1.0, 1e5], (*shape[:2], 1)) * rng.random(shape)
    ratio = rng.choice([0.0, 0.01, 1.0], shape[:2])
    earlier = rng.poisson(mean).astype(float)
    newest = rng.poisson(1.02 * mean * ratio[..., None]).astype(float)
    found = []
    for kernel in available().values():
        out = np.full((-(-shape[0] // size), -(-shape[1] // size)), np.nan)
        kernel.significance(
            *(newest, earlier, ratio, *shape, size, 8),
            *(scene_change.BRIGHTNESS_TOLERANCE, scene_change.SHIFT_TOLERANCE, out),
        )
        found.append(out)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9, atol=1e-6)


@pytest.mark.skipif(not backend.available("ingest"), reason="the kernels are not compiled here")
def test_the_compiled_significance_refuses_what_does_not_fit() -> None:
    kernel, counts, some = available()["c"], np.zeros((3, 1, 4)), np.zeros((3, 1))
    with pytest.raises(ValueError, match="newest has 96 bytes, fewer than the 120 it needs"):
        kernel.significance(*(counts, counts, some, 3, 1, 5, 1, 1, 0.0, 0.0, some))
    with pytest.raises(ValueError, match="out has 16 bytes, fewer than the 24 it needs"):
        kernel.significance(*(counts, counts, some, 3, 1, 4, 1, 1, 0.0, 0.0, some[1:]))
    with pytest.raises(ValueError, match="significance: argument out of range"):
        kernel.significance(*(counts, counts, some, 3, 1, 1, 1, 1, 0.0, 0.0, some))
