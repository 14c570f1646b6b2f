# SPDX-License-Identifier: Apache-2.0
"""Video: what has not changed keeps its values and is flagged; what has is seen."""

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.errors import HueflightError
from hueflight.fit import change_detection
from hueflight.fit import solver as kernels
from hueflight.reconstruction.joint import tables_for_calibration
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.video import Video


@pytest.fixture(scope="module")
def setting(small, draw):
    instrument = small(rows=24, cols=24)
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)

    def shot(seed, **scene):
        return draw(instrument, **{"depth": 0.9, "photons": 620, "seed": seed, **scene})

    return calibration, shot


def skipped(image):
    return (image["quality"].values & int(Quality.SKIPPED)) != 0


def test_a_still_scene_keeps_its_values(setting):
    calibration, shot = setting
    video = Video(calibration)
    first = video.next(shot(1))
    assert not skipped(first).any()
    expected = hf.reconstruct(shot(1), calibration)
    for name in ("depth", "depth_std", "reflectance", "reflectance_std", "quality"):
        np.testing.assert_array_equal(first[name], expected[name])
    second = video.next(shot(2))
    xr.testing.assert_identical(second.coords["band"], expected.coords["band"])
    assert second.attrs == first.attrs == expected.attrs
    for name in (*first.data_vars, *expected.coords):
        assert second[name].attrs == expected[name].attrs
        assert (second[name].dims, second[name].dtype) == (
            expected[name].dims,
            expected[name].dtype,
        )
    # 11 contrasts beyond 4 sigma: 7e-4 a pixel; 5 of 576 by chance in 1 run of 10 000
    assert skipped(second).mean() > 0.99
    kept = skipped(second)
    np.testing.assert_array_equal(second["depth"].values[kept], first["depth"].values[kept])


def test_what_moved_is_fitted_again(setting):
    calibration, shot = setting
    still, moved = shot(1), shot(2)
    moved[:6] = shot(3, depth=1.2)[:6]
    moved[6:12] = shot(4, photons=900)[6:12]
    video = Video(calibration)
    video.next(still)
    image = video.next(moved)
    assert not skipped(image)[:12].any()
    assert skipped(image)[12:].mean() > 0.98
    expected = hf.reconstruct(moved, calibration)
    fresh = ~skipped(image)
    for name in ("depth", "depth_std", "reflectance", "reflectance_std"):
        np.testing.assert_array_equal(image[name].values[fresh], expected[name].values[fresh])


def test_slow_drifts_are_seen_in_the_end(setting):
    calibration, shot = setting
    video = Video(calibration)
    for step in range(16):
        image = video.next(shot(step, depth=0.9 + 0.02 * step))
    # the deviation is 2.4 cm: none may be left behind by much more than 8 of it
    assert np.abs(image["depth"].values - 1.2).max() < 9 * 0.034


def test_light_that_goes_out_and_comes_back(setting):
    calibration, shot = setting
    lit, dark = shot(1), shot(2)
    dark[:, :, 1:] = 0
    dark[0, 0] = lit[0, 0]
    video = Video(calibration)
    video.next(lit)
    image = video.next(dark)
    assert np.isnan(image["depth"].values[1:]).all()
    back = video.next(shot(3))
    assert not skipped(back)[1:].any()
    assert np.isfinite(back["depth"].values).all()


def test_changes_that_are_told_are_fitted_and_nothing_else_is_read(setting):
    calibration, shot = setting
    video = Video(calibration)
    first = video.next(shot(1))
    told = np.zeros((24, 24), bool)
    told[4:9, 3] = True
    counts = shot(2, depth=1.2)
    unread = counts.copy()
    unread[~told] = np.iinfo(counts.dtype).max  # would be taken for full counters
    image = video.next(unread, changed=told)
    assert np.array_equal(~skipped(image), told)
    expected = hf.reconstruct(counts, calibration)
    for name in ("depth", "depth_std", "reflectance", "reflectance_std", "photons", "background"):
        np.testing.assert_array_equal(image[name].values[told], expected[name].values[told])
        np.testing.assert_array_equal(image[name].values[~told], first[name].values[~told])
    kept_flags = image["quality"].values[~told] ^ np.uint16(Quality.SKIPPED)
    np.testing.assert_array_equal(kept_flags, first["quality"].values[~told])
    # pixels that are due are fitted as well
    due = np.zeros((24, 24), bool)
    due[0, 0] = True
    assert np.array_equal(~skipped(video.next(counts, changed=told, due=due)), told | due)
    # nothing was kept to compare the pixels with that were told: they are fitted again
    again = video.next(shot(3))
    assert not skipped(again)[told].any()
    assert skipped(again)[~told].mean() > 0.98


def test_a_sensor_without_empty_codes_has_the_exposures_that_are_stated(small, draw):
    instrument = small(rows=8, cols=8, code_zero="bin")
    reference = draw(instrument, photons=20_000)
    calibration = hf.calibrate(reference, instrument, distance=0.5, frames=100_000)
    video, told = Video(calibration), np.zeros((8, 8), bool)
    told[2] = True
    first, second = (draw(instrument, depth=0.9, photons=620, seed=seed) for seed in (1, 2))
    video.next(first, frames=5000)
    image = video.next(second, frames=7000, changed=told)
    expected = hf.reconstruct(second, calibration, frames=7000)
    for name in ("depth", "reflectance", "reflectance_std"):
        np.testing.assert_array_equal(image[name].values[told], expected[name].values[told])


def test_counts_are_compared_by_the_exposures_of_the_last_fit(setting):
    calibration, shot = setting
    video = Video(calibration)
    video.next(shot(1), frames=1e6)
    video.next(shot(2, photons=1240), frames=2e6, due=np.ones((24, 24), bool))
    image = video.next(shot(3, photons=1240), frames=2e6)
    assert skipped(image).mean() > 0.98
    image = video.next(shot(4, photons=1240), frames=1e6)  # twice as many in an exposure
    assert not skipped(image).any()


def test_switched_off(setting):
    calibration, shot = setting
    video = Video(calibration, change_sigma=0)
    video.next(shot(1))
    image = video.next(shot(2))
    assert not skipped(image).any()
    np.testing.assert_array_equal(image["depth"], hf.reconstruct(shot(2), calibration)["depth"])


@pytest.mark.usefixtures("fit_build")
def test_compiled_contrasts_are_those_of_the_definition(setting):
    calibration, shot = setting
    plan = tables_for_calibration(calibration, (-15.0, 15.0))  # the other builds use it too
    now = calibration.bins.in_time_order(shot(2, depth=0.95)).reshape(576, -1)
    then = calibration.bins.in_time_order(shot(1)).reshape(576, -1)
    offsets = calibration.pixel_delay_ns.ravel()
    pixels = np.arange(0, 576, 5)
    found = kernels.fit_pixels(then, offsets, plan).take(pixels)
    reference = change_detection.no_reference(576, plan)
    reference.put(pixels, kernels.change_reference(then, pixels, found, offsets[pixels], plan))
    made = reference.take(pixels)
    expected = change_detection.change_reference(then[pixels], found, offsets[pixels], plan)
    weights = made.weights.astype(int), expected.weights.astype(int)
    assert np.abs(weights[0]).max(axis=-1).tolist() == [127] * pixels.size
    assert np.abs(weights[0] - weights[1]).max() <= 1  # the slopes are in single precision
    assert (weights[0] == weights[1]).mean() > 0.99
    np.testing.assert_array_equal(made.sums[:, 2], then[pixels].sum(axis=-1))
    np.testing.assert_array_equal(made.sums[:, 2:], expected.sums[:, 2:])
    np.testing.assert_array_equal(made.delays_ns, expected.delays_ns)
    for counts in (np.ascontiguousarray(then), then.astype(np.uint32)):  # however they lie
        again = kernels.change_reference(counts, pixels, found, offsets[pixels], plan)
        np.testing.assert_array_equal(again.weights, made.weights)
        np.testing.assert_array_equal(again.sums, made.sums)
    raw = shot(2, depth=0.95, frames=60_000).reshape(576, -1)  # fits 16 bits
    earlier = raw.sum(axis=-1) * np.linspace(0.5, 2, 576)
    exposures = earlier * np.random.default_rng(1).uniform(0.5, 2, 576)
    codes = calibration.bins.codes
    lit = slice(int(codes.min()), int(codes.max()) + 1)
    options = {"backwards": bool(codes[0] > codes[-1])}
    for given in (exposures, None):  # without them, all counts are exposures
        options |= {"exposures": given, "earlier": earlier}
        for counts in (raw, raw.astype(np.uint16)):
            found, fast = kernels.survey_changes(counts, lit, reference, plan, **options)
            for value, expected in zip(found, kernels.survey(counts, lit), strict=True):
                np.testing.assert_array_equal(value, expected)
            now_exposures = raw.sum(axis=-1) if given is None else given
            slow = change_detection.change_significance(
                now[pixels], made, (now_exposures / earlier)[pixels], plan
            )
            assert np.ptp(slow) > 3
            np.testing.assert_allclose(fast[pixels], slow, rtol=2e-4, atol=1e-3)


def test_counts_that_are_not_whole_are_compared_alike(setting):
    calibration, shot = setting
    moved = shot(2)
    moved[:6] = shot(3, depth=1.2)[:6]
    images = []
    for dtype in (np.uint16, np.float32, np.float64):
        video = Video(calibration)
        frames = shot(1).sum(axis=-1) + 0.0
        video.next(np.minimum(shot(1), 65534).astype(dtype), frames=frames)
        images.append(video.next(np.minimum(moved, 65534).astype(dtype), frames=frames))
    for image in images[1:]:
        np.testing.assert_array_equal(skipped(image), skipped(images[0]))
        np.testing.assert_array_equal(image["depth"], images[0]["depth"])


def test_images_that_were_returned_stay_as_they_are(setting):
    calibration, shot = setting
    video = Video(calibration)
    first = video.next(shot(1))
    before = first.copy(deep=True)
    video.next(shot(2, depth=1.2, photons=300))
    assert first.identical(before)


@pytest.mark.parametrize("range_correction", [True, False])
def test_a_pixel_that_is_fitted_is_that_of_a_reconstruction(setting, range_correction):
    calibration, shot = setting
    video = Video(calibration, range_correction=range_correction)
    everywhere = np.ones((24, 24), bool)
    for seed in range(3):
        counts = shot(seed, depth=0.8 + 0.1 * seed)
        counts[seed, :, 1:] = 0  # without a photon, nothing is fitted
        image = video.next(counts, due=everywhere)
        expected = hf.reconstruct(counts, calibration, range_correction=range_correction)
        assert not skipped(image).any()
        for name in image.variables:
            np.testing.assert_array_equal(image[name], expected[name], err_msg=str(name))


def test_a_sensor_that_does_not_report_empty_exposures(small, draw):
    """Without the number of exposures, light that doubles is a change."""
    instrument = small(rows=12, cols=12, code_zero="bin")
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    video = Video(calibration)
    first = video.next(draw(instrument, depth=0.9, photons=620, seed=1))
    assert np.isfinite(first["depth"]).all()
    still = video.next(draw(instrument, depth=0.9, photons=620, seed=2))
    assert skipped(still).mean() > 0.97  # false alarms as above
    assert not skipped(video.next(draw(instrument, depth=0.9, photons=1240, seed=3))).any()


def test_a_threshold_that_makes_no_sense(setting):
    calibration, _ = setting
    with pytest.raises(HueflightError, match="change_sigma = -1"):
        Video(calibration, change_sigma=-1)
