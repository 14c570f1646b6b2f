# SPDX-License-Identifier: Apache-2.0
"""Video: what has not changed keeps its values and is flagged; what has is seen."""

import numpy as np
import pytest

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
    scales = np.linspace(0.5, 2, pixels.size)
    memory = np.zeros((576, 2, 128), np.float32)
    memory[pixels] = kernels.change_reference(then, pixels, found, offsets[pixels], plan)
    expected = change_detection.change_reference(then[pixels], found, offsets[pixels], plan)
    np.testing.assert_array_equal(memory[pixels, 0], expected[:, 0])
    np.testing.assert_array_equal(memory[pixels, 0].sum(axis=-1), then[pixels].sum(axis=-1))
    np.testing.assert_allclose(memory[pixels, 1], expected[:, 1], rtol=1e-3, atol=1e-4)
    for counts in (np.ascontiguousarray(then), then.astype(np.uint32)):  # however they lie
        again = kernels.change_reference(counts, pixels, found, offsets[pixels], plan)
        np.testing.assert_array_equal(again, memory[pixels])
    delays_ns = found.delay_ns + offsets[pixels]
    fast = kernels.change_significance(now, memory, pixels, scales, delays_ns, plan)
    slow = change_detection.change_significance(
        now[pixels], memory[pixels], scales, delays_ns, plan
    )
    np.testing.assert_allclose(fast, slow, rtol=2e-4, atol=1e-3)


def test_a_threshold_that_makes_no_sense(setting):
    calibration, _ = setting
    with pytest.raises(HueflightError, match="change_sigma = -1"):
        Video(calibration, change_sigma=-1)
