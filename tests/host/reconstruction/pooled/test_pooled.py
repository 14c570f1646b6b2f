# SPDX-License-Identifier: Apache-2.0
"""Pictures from a few photons a pixel: how good, how fine, and never across a step."""

import dataclasses
import os
import signal
import warnings

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import maximum_filter, median_filter, minimum_filter

import hueflight as hf
from hueflight import backend, simulator
from hueflight.errors import HueflightError
from hueflight.reconstruction.inputs import prepare_histogram
from hueflight.reconstruction.options import EstimatorOptions
from hueflight.reconstruction.pooled import estimate as few_photons
from hueflight.reconstruction.pooled.kernels import (
    MOST_GROUPS,
    MOST_PLANES,
    Likeness,
    Limits,
    list_photons,
    neighbors,
    pool,
    square_counts,
)
from hueflight.reconstruction.quality import Quality

native = pytest.mark.skipif(not backend.available("pooled"), reason=backend.why_not("pooled"))
FRAMES = 10
ORANGE = (1, 1, 0.9, 0.5, 0.1, 0.05, 0.05, 0.05, 0.05)
BLUE = (0.03, 0.03, 0.03, 0.03, 0.05, 0.3, 1, 1, 0.8)


@pytest.fixture(scope="module")
def instrument(small):
    return small(rows=48, cols=40)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    return hf.calibrate(draw(instrument, photons=2_000), instrument, distance=0.5)


def estimate(counts, calibration, *, enough=few_photons.ENOUGH, threads=1):
    """What the method itself gives, before it becomes an image."""
    prepared = dataclasses.replace(prepare_histogram(counts, calibration, None), exposures=None)
    options = EstimatorOptions(threads=threads)
    return few_photons.estimate(prepared, calibration, options, enough=enough)


def halves(instrument, draw, *, left, right, photons=3.0, seed=0):
    """Histogram of a scene with a step in the middle; left and right are (depth, reflectance)."""
    histogram = [
        draw(instrument, depth=depth, reflectance=reflectance, photons=photons,
             background=photons / 10, frames=1000, seed=(seed, side))
        for side, (depth, reflectance) in enumerate((left, right))
    ]  # fmt: skip
    middle = instrument.image_shape[1] // 2
    return np.concatenate([histogram[0][:, :middle], histogram[1][:, middle:]], axis=1)


def test_a_wall_from_three_photons_a_pixel(instrument, calibration, draw):
    counts = draw(instrument, depth=0.9, photons=3, background=0.3, frames=1000)
    pooled = hf.reconstruct(counts, calibration, method="pooled")
    alone = hf.reconstruct(counts, calibration, method="paper")
    error = pooled.depth.values - 0.9
    # 6300 photons in all know the wall to 0.8 cm; a radius of 14 pixels of them to 2 … 3 cm
    assert np.sqrt(np.mean(error**2)) < 0.04
    assert np.nanmean(np.abs(alone.depth.values - 0.9) < 0.05) < 0.2
    assert pooled.attrs["method"] == "pooled"
    assert not pooled.quality.values.any()


def test_it_says_how_sure_it_is(instrument, calibration, draw):
    inside = []
    for seed in range(6):
        counts = draw(instrument, depth=0.8, photons=3, background=0.3, frames=1000, seed=seed)
        image = hf.reconstruct(counts, calibration, method="pooled")
        inside.append(np.abs(image.depth.values - 0.8) < 2 * image.depth_std.values)
    # neighbors' errors go together: some 10 independent ones a picture, 60 in all, of which 95 %
    # are expected inside; fewer than 80 % once in 10⁴ runs
    assert np.mean(inside) > 0.8
    assert np.median(image.depth_std) < 0.05


def test_resolution_is_what_photons_leave(instrument, calibration, draw):
    few, more, enough = (
        hf.reconstruct(
            draw(instrument, depth=0.8, photons=photons, frames=100_000),
            calibration,
            method="pooled",
        ).resolution.values
        for photons in (3, 100, 3000)
    )
    assert 8 < np.median(few) < 25
    assert 1 < np.median(more) < 0.7 * np.median(few)
    np.testing.assert_array_equal(enough, 1)


def test_pixels_with_enough_photons_get_the_joint_fit(instrument, calibration, draw):
    counts = draw(instrument, depth=0.8, photons=3, frames=100_000)
    bright = draw(instrument, depth=0.8, photons=5000, frames=100_000)
    counts[10:14, 10:14] = bright[10:14, 10:14]
    pooled = hf.reconstruct(counts, calibration, method="pooled")
    joint = hf.reconstruct(counts, calibration)
    patch = {"row": slice(10, 14), "col": slice(10, 14)}
    for name in ("depth", "depth_std", "reflectance"):
        np.testing.assert_array_equal(pooled[name].isel(patch), joint[name].isel(patch))
    np.testing.assert_array_equal(pooled.resolution.isel(patch), 1)


def test_no_photon_crosses_a_step_between_colours(instrument, calibration, draw):
    """What lies 3 m behind a step of another colour does not move what lies before it."""
    near, far, middle = 0.7, 1.9, 20
    image = hf.reconstruct(
        halves(instrument, draw, left=(near, ORANGE), right=(far, BLUE), photons=6),
        calibration,
        method="pooled",
    )
    depth = image.depth.values
    # the last three columns before the step and the first three after it
    assert np.abs(np.median(depth[:, middle - 3 : middle]) - near) < 0.06
    assert np.abs(np.median(depth[:, middle : middle + 3]) - far) < 0.06
    beyond = (np.abs(depth[:, : middle - 2] - near) > 0.3).mean()
    assert beyond < 0.02
    blue = image.reflectance.values[..., 7]
    assert blue[:, : middle - 2].mean() < 0.15 * blue[:, middle + 2 :].mean()


def test_a_step_of_one_colour_is_kept(instrument, calibration, draw):
    near, far, middle = 0.5, 2.2, 20
    image = hf.reconstruct(
        halves(instrument, draw, left=(near, 1.0), right=(far, 1.0), photons=10),
        calibration,
        method="pooled",
    )
    depth = image.depth.values
    assert np.abs(np.median(depth[:, : middle - 4]) - near) < 0.05
    assert np.abs(np.median(depth[:, middle + 4 :]) - far) < 0.05
    # hardly a pixel hangs between the two
    between = (np.abs(depth - near) > 0.3) & (np.abs(depth - far) > 0.3)
    assert between.mean() < 0.05


def test_reflectance_is_that_of_many_photons(instrument, calibration, draw):
    counts = draw(instrument, depth=0.5, photons=4, background=0.4, reflectance=BLUE, frames=1000)
    image = hf.reconstruct(
        counts, calibration, method="pooled", frames=1000, range_correction=False
    )
    # `draw` scales the colour to the photons asked for; the reference had 2000 of white
    white = instrument.band_brightness()
    expected = np.array(BLUE) * 4 / (white @ np.array(BLUE)) * white.sum() / 2000 * 1000
    found = image.reflectance.mean(("row", "col")).values
    # 7700 photons: each band to 3 % of the brightest at 4 deviations
    np.testing.assert_allclose(found, expected, atol=0.06 * expected.max())


def test_defects_are_flagged_and_lend_nothing(instrument, calibration, draw):
    counts = draw(instrument, depth=0.9, photons=3, background=0.3, frames=1000)
    hot = np.zeros(instrument.image_shape, bool)
    hot[20, 20] = True
    broken = dataclasses.replace(calibration, hot=hot)
    counts[20, 20, 100] = 900
    image = hf.reconstruct(counts, broken, method="pooled")
    assert image.quality.values[20, 20] == Quality.HOT
    assert np.isnan(image.depth.values[20, 20])
    assert np.isnan(image.resolution.values[20, 20])
    counts[20, 20, 1:] = 0
    same = hf.reconstruct(counts, broken, method="pooled")
    np.testing.assert_array_equal(same.depth, image.depth)


def test_where_no_light_comes_back(instrument, calibration):
    counts = np.zeros(instrument.histogram_shape, np.uint16)
    counts[..., 0] = FRAMES
    counts[0, 0, 200] = 1
    image = hf.reconstruct(counts, calibration, method="pooled")
    assert (image.quality.values & Quality.LOW_SIGNAL).mean() > 0.5
    assert np.isnan(image.depth.values[image.quality.values != 0]).all()


@pytest.mark.parametrize("photons", [0.3, 1, 3, 10, 100])
def test_background_alone_is_no_surface(instrument, calibration, draw, photons):
    counts = draw(instrument, photons=1e-9, background=photons, seed=int(10 * photons))
    quality = hf.reconstruct(counts, calibration, method="pooled").quality.values
    # false alarms come as pools: 1 % is a single one, expected in fewer than one image of ten
    assert ((quality & Quality.NO_RETURN) > 0).mean() > 0.99


def test_an_empty_sky_beside_a_surface_stays_empty(instrument, calibration, draw):
    """The surface is kept up to its edge, and does not grow over it by more than two pixels."""
    counts = draw(instrument, depth=0.9, photons=5, background=1, seed=1)
    counts[:, 20:] = draw(instrument, photons=1e-9, background=1, seed=2)[:, 20:]
    image = hf.reconstruct(counts, calibration, method="pooled")
    absent = (image.quality.values & Quality.NO_RETURN) > 0
    assert absent[:, 22:].mean() > 0.99
    assert absent[:, :18].mean() < 0.01
    assert np.isnan(image.depth.values[absent]).all()
    assert np.isfinite(image.background.values[absent]).all()


def test_a_thin_structure_without_contrast_is_uncertain(instrument, calibration, draw):
    """Bars of four pixels, 30 cm in front of a wall: pools reach over them, and say so."""
    counts = draw(instrument, depth=1.2, photons=20, background=2, seed=1)
    bars = np.zeros(instrument.image_shape, bool)
    bars[:, 8:12] = True
    counts[bars] = draw(instrument, depth=0.9, photons=20, background=2, seed=2)[bars]
    image = hf.reconstruct(counts, calibration, method="pooled")
    error = np.abs(image.depth.values - np.where(bars, 0.9, 1.2))
    deviation = image.depth_std.values
    wrong = (error > 3 * deviation) & (image.quality.values == 0)
    # 100 % of the bars were off by that much without a flag, with 13 cm of mean error
    assert wrong[bars].mean() < 0.25
    assert error[bars].mean() < 0.1
    away = slice(20, 36)
    assert np.median(deviation[:, away]) < 0.025
    assert (error[:, away] < 3 * deviation[:, away]).mean() > 0.97


def test_a_pixel_that_contradicts_its_neighbors_keeps_its_own_depth(instrument, calibration, draw):
    counts = draw(instrument, depth=1.0, photons=30, background=3, seed=1)
    others = (np.array([8, 20, 30, 40]), np.array([10, 30, 10, 30]))
    counts[others] = draw(instrument, depth=2.4, photons=40, background=4, seed=2)[others]
    image = hf.reconstruct(counts, calibration, method="pooled")
    flagged = (image.quality.values & Quality.CONTRADICTED) > 0
    assert flagged[others].all()
    # 40 photons know the depth to 11 cm
    np.testing.assert_allclose(image.depth.values[others], 2.4, atol=0.35)
    assert (image.depth_std.values[others] > 0.08).all()
    flagged[others] = False
    assert not flagged.any()


@pytest.mark.parametrize("photons", [3, 20, 100, 500])
def test_nothing_contradicts_a_plain_wall(instrument, calibration, draw, photons):
    for seed, color in enumerate((1.0, ORANGE, BLUE)):
        counts = draw(instrument, depth=1.2, photons=photons, background=photons / 10,
                      reflectance=color, seed=seed)  # fmt: skip
        image = hf.reconstruct(counts, calibration, method="pooled")
        contradicted = (image.quality.values & Quality.CONTRADICTED) > 0
        assert contradicted.sum() <= 2  # of 1920


@native
def test_squares_in_c_are_squares_in_numpy(monkeypatch):
    rng = np.random.default_rng(5)
    counts = rng.poisson(0.05, (6 * 9, 40)).astype(np.uint16)
    photons = list_photons(counts, np.arange(40, dtype=np.float32), np.zeros(54, np.float32), 40)
    pixels, reach = np.arange(54), rng.integers(0, 12, 54).astype(np.int32)
    delays = rng.uniform(-20, 20, 54).astype(np.float32)
    windows = rng.integers(0, 3, 80).astype(np.int8)
    results = []
    for implementation in ("c", "numpy"):
        monkeypatch.setenv("HUEFLIGHT_KERNELS", implementation)
        results.append(square_counts(photons, (6, 9), pixels, reach, delays, windows, 2.0, 3))
    np.testing.assert_array_equal(*results)
    everything = reach >= 8
    np.testing.assert_array_equal(results[0][everything].sum(axis=1), counts.sum())
    np.testing.assert_array_equal(
        results[0][reach == 0].sum(axis=1), counts[reach == 0].sum(axis=1)
    )


def test_the_picture_turns_with_the_scene(instrument, calibration, draw):
    counts = halves(instrument, draw, left=(0.7, ORANGE), right=(1.1, BLUE))
    plain = estimate(counts, calibration)
    mirror = dataclasses.replace(
        calibration,
        pixel_delay_ns=calibration.pixel_delay_ns[:, ::-1],
        flat_field=calibration.flat_field[:, ::-1],
    )
    turned = estimate(np.ascontiguousarray(counts[:, ::-1]), mirror)
    # sums in another order: rounding may close a pool a round later here and there
    apart = np.abs(plain.depth - turned.depth[:, ::-1])
    assert np.quantile(apart, 0.99) < 1e-3


def test_threads_change_nothing(instrument, calibration, draw):
    counts = halves(instrument, draw, left=(0.7, ORANGE), right=(1.1, BLUE))
    one = estimate(counts, calibration)
    three = estimate(counts, calibration, threads=3)
    np.testing.assert_array_equal(one.depth, three.depth)
    np.testing.assert_array_equal(one.reflectance, three.reflectance)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_threads_in_a_forked_process(instrument, calibration, draw):
    counts = halves(instrument, draw, left=(0.7, ORANGE), right=(1.1, BLUE))
    estimate(counts, calibration, threads=2)  # its threads wait in this process
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # newer Pythons warn of just this
        child = os.fork()
    if child == 0:
        signal.alarm(60)
        estimate(counts, calibration, threads=2)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0


@native
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.float32])
def test_the_compiled_loops_do_the_same(instrument, calibration, draw, monkeypatch, dtype):
    counts = halves(instrument, draw, left=(0.7, ORANGE), right=(1.1, BLUE))
    counts[..., 0] = 0
    counts = counts.astype(dtype)
    found = {}
    for implementation in ("c", "numpy"):
        monkeypatch.setenv("HUEFLIGHT_KERNELS", implementation)
        found[implementation] = estimate(counts, calibration)
    for name in ("depth", "depth_std", "reflectance", "resolution"):
        fast, slow = getattr(found["c"], name), getattr(found["numpy"], name)
        # a photon on the border of two cells may fall into either
        apart = np.abs(fast - slow) / np.abs(slow).mean()
        assert np.quantile(apart, 0.99) < 2e-3, name


@native
@pytest.mark.parametrize("shape", [(5, 7), (16, 33)])
def test_pooling_in_c_is_pooling_in_numpy(monkeypatch, shape):
    rng = np.random.default_rng(3)
    data = rng.random((5, *shape), np.float32)
    like = Likeness(
        means=rng.random((3, *shape), np.float32),
        delays_ns=rng.random(shape, np.float32),
        pixels=10 * rng.random(shape, np.float32),
        information=10 * rng.random(shape, np.float32),
    )
    valid = rng.random(shape) < 0.8
    limits = Limits(color=4.0, depth_color=6.0, depth=2.0)
    results = []
    for implementation in ("c", "numpy"):
        monkeypatch.setenv("HUEFLIGHT_KERNELS", implementation)
        results.append(pool(data, 3, valid, np.ones(shape, bool), like, 3.5, limits))
    for name in ("sums", "weight", "squares", "depth_squares"):
        fast, slow = (getattr(result, name) for result in results)
        np.testing.assert_allclose(fast, slow, rtol=1e-4, atol=1e-5)


def test_more_planes_than_the_compiled_loops_have_room_for(monkeypatch):
    shape = (3, 4)
    flat = np.ones(shape, np.float32)
    like = Likeness(np.ones((MOST_GROUPS + 1, *shape), np.float32), flat, flat, flat)
    everywhere = np.ones(shape, bool)
    limits = Limits(color=4.0, depth_color=6.0, depth=2.0)
    data = np.ones((MOST_PLANES + 1, *shape), np.float32)
    many = pool(data, 0, everywhere, everywhere, like, 1.5, limits)
    few = dataclasses.replace(like, means=like.means[:1])
    np.testing.assert_allclose(
        many.sums[:1], pool(data[:1], 0, everywhere, everywhere, few, 1.5, limits).sums, rtol=1e-5
    )


@pytest.mark.parametrize("implementation", ["numpy", pytest.param("c", marks=native)])
def test_pooling_of_equals_is_a_plain_sum(monkeypatch, implementation):
    """Where all look alike every neighbour counts by distance alone."""
    monkeypatch.setenv("HUEFLIGHT_KERNELS", implementation)
    shape = (9, 20)
    flat = np.ones(shape, np.float32)
    like = Likeness(flat[None], flat, 100 * flat, 100 * flat)
    found = pool(
        flat[None], 1, flat > 0, flat > 0, like, 2.5, Limits(color=1, depth_color=1, depth=1)
    )
    _, kernel = neighbors(2.5)
    np.testing.assert_allclose(found.sums[0, 4, 10], kernel.sum(), rtol=1e-6)
    np.testing.assert_allclose(found.squares[4, 10], (kernel**2).sum(), rtol=1e-6)
    # the corner has no neighbors beyond the picture
    assert found.weight[0, 0] < 0.5 * kernel.sum()


@pytest.mark.parametrize("implementation", ["numpy", pytest.param("c", marks=native)])
def test_list_of_photons_is_the_histogram(monkeypatch, implementation):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", implementation)
    counts = np.random.default_rng(0).poisson(0.02, (30, 37)).astype(np.uint16)
    times = np.arange(37, dtype=np.float32)
    times[0] = -1  # no photon
    offsets = np.linspace(-2, 2, 30).astype(np.float32)
    photons = list_photons(counts, times, offsets, 37.0)
    assert photons.weights.sum() == counts[:, 1:].sum()
    again = np.zeros_like(counts)
    code = np.rint(photons.times_ns + offsets[photons.owners]).astype(int) % 37
    np.add.at(again, (photons.owners, code), photons.weights.astype(np.uint16))
    np.testing.assert_array_equal(again[:, 1:], counts[:, 1:])


@pytest.mark.parametrize("shape", [(1, 1), (2, 7), (31, 20)])
def test_median_of_nine_is_scipys(shape):
    values = np.random.default_rng(4).integers(0, 9, shape).astype(np.float32)
    expected = median_filter(values, 3, mode="nearest")
    np.testing.assert_array_equal(few_photons._median_of_nine(values), expected)


def test_bad_calls(instrument, calibration, draw, monkeypatch):
    counts = draw(instrument, photons=3)
    with pytest.raises(HueflightError, match="enough = 0"):
        estimate(counts, calibration, enough=0)
    single = dataclasses.replace(
        calibration, bins=dataclasses.replace(calibration.bins, period_ns=None)
    )
    with pytest.raises(HueflightError, match="has no period"):
        estimate(counts, single)
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "fortran")
    with pytest.raises(HueflightError, match="HUEFLIGHT_KERNELS = 'fortran'"):
        estimate(counts, calibration)


@pytest.mark.slow
def test_fig1_from_ten_frames_beats_the_paper_from_a_thousand():
    """The paper's scene with 3 signal and 0.3 background photons a pixel on average.

    Depth against the paper's method with 100 times the photons, at steps and away from them, and
    reflectance at 445 nm against it with 30 times. At steps the medians are compared: the RMSE of
    the paper's method gained when it began to leave out pixels without a return.
    """
    instrument = hf.Instrument.load("paper")
    settings = simulator.SimulationSettings()
    reference = simulator.simulate_capture("reference", instrument, frames=2000, seed=1)
    dark = simulator.simulate_capture("dark", instrument, frames=2000, seed=1)
    calibration = hf.calibrate(reference, instrument, distance=0.4, dark=dark)
    usable = calibration.usable
    scene = simulator.scene("fig1", instrument)
    # of the scene with the default light and none but dark counts
    bright = simulator.expected_rates(scene, instrument, settings.replace(ambient=0.0))
    mean = (bright.periods * bright.photons.sum(axis=0))[usable].mean()
    dim = settings.replace(white_detections=settings.white_detections * 0.3 / mean, ambient=0.005)
    plane = simulator.scene("plane", instrument, distance=0.4)
    white = simulator.expected_rates(plane, instrument, settings).photons[7]
    seen = simulator.expected_rates(scene, instrument, dim).photons[7]
    truth = np.divide(seen, white, out=np.zeros_like(seen), where=white > 0)
    edge = maximum_filter(scene.depth, 7) - minimum_filter(scene.depth, 7) > 0.01

    def picture(frames: int, method: str) -> xr.Dataset:
        counts = simulator.simulate_histogram(
            scene, instrument, frames=frames, settings=dim, seed=frames
        )
        return hf.reconstruct(counts, calibration, method=method)

    pooled, hundredfold, thirtyfold = (
        picture(10, "pooled"),
        picture(1000, "paper"),
        picture(300, "paper"),
    )

    def errors(image: xr.Dataset, other: xr.Dataset) -> tuple[float, float, float, float]:
        """Errors where both know the depth: each leaves out pixels without a return."""
        apart = image.depth.values - scene.depth
        known = usable & np.isfinite(apart) & np.isfinite(other.depth.values)
        blue = (image.reflectance.values[..., 7] - truth)[known]
        return (
            float(np.sqrt(np.mean(apart[known & ~edge] ** 2))),
            float(np.sqrt(np.mean(apart[known & edge] ** 2))),
            float(np.sqrt(np.mean(blue**2))),
            float(np.median(np.abs(apart[known & edge]))),
        )

    ours, theirs = errors(pooled, hundredfold), errors(hundredfold, pooled)
    assert ours[0] < theirs[0]
    assert errors(pooled, thirtyfold)[2] < errors(thirtyfold, pooled)[2]
    assert ours[3] < theirs[3]  # 4.9 cm before pools looked again
