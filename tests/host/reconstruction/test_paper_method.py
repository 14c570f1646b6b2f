# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest

import hueflight as hf
from hueflight.reconstruction.paper import _background
from hueflight.reconstruction.quality import Quality


@pytest.fixture(scope="module")
def instrument(small):
    return small(rows=24, cols=24)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    return hf.calibrate(draw(instrument, depth=0.4, photons=50_000), instrument, distance=0.4)


@pytest.fixture(scope="module")
def image(instrument, calibration, draw):
    return hf.reconstruct(
        draw(instrument, depth=0.9, photons=2000, seed=5),
        calibration,
        method="paper",
        range_correction=False,
    )


def test_depth_and_reflectance_of_a_white_plane(image):
    # the bound is 1.4 cm a pixel, .06 cm for the mean of 576; tails bias by millimetres
    assert float(image.depth.mean()) == pytest.approx(0.9, abs=0.006)
    # amber has 44 photons a pixel, 25 000 in all: .6 %; tails cut at the windows' edges
    assert image.reflectance.mean(("row", "col")).values == pytest.approx(0.04, rel=0.03)


def test_claimed_depth_deviation_is_the_measured_one(image):
    # the deviation of 576 pixels is itself known to 2.9 %; 15 % is five of those
    claimed = float(np.sqrt((image.depth_std**2).mean()))
    assert float(image.depth.std()) == pytest.approx(claimed, rel=0.15)


def test_claimed_reflectance_deviation_is_the_measured_one(image):
    claimed = np.sqrt((image.reflectance_std**2).mean(("row", "col")))
    assert image.reflectance.std(("row", "col")).values == pytest.approx(claimed.values, rel=0.16)


def test_spread_against_the_bound(image, calibration):
    bound = hf.depth_bound(calibration, photons=2000, depth=0.9)
    assert 0.85 * bound < float(image.depth.std()) < 1.3 * bound


def test_eq_2_reads_dark_bands_too_high_under_background(instrument, calibration, draw):
    blue = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1.0])
    seen = draw(instrument, depth=0.4, photons=2000, reflectance=blue, background=600)
    image = hf.reconstruct(seen, calibration, method="paper")
    reflectance = image.reflectance.mean(("row", "col")).values
    assert reflectance[:6].max() > 0.2 * reflectance[6:].mean()


def test_a_pixel_without_photons_has_no_depth_and_says_why(instrument, calibration, draw):
    seen = draw(instrument, photons=500)
    seen[3, 4, 1:] = 0
    image = hf.reconstruct(seen, calibration, method="paper")
    assert np.isnan(image.depth[3, 4])
    assert np.isnan(image.reflectance[3, 4]).all()
    assert int(image.quality[3, 4]) & Quality.LOW_SIGNAL
    assert np.isfinite(image.depth).sum() == 24 * 24 - 1


def test_photons_in_broken_pixels_alone_give_no_depth(instrument, calibration, draw):
    seen = draw(instrument, photons=500)
    broken = np.zeros((24, 24), bool)
    broken[3, 4] = True
    seen[~broken, 1:] = 0
    image = hf.reconstruct(seen, dataclasses.replace(calibration, dead=broken), method="paper")
    assert np.isnan(image.depth).all()
    assert (image.quality.values[~broken] & Quality.LOW_SIGNAL).all()


def test_background_is_unknown_where_windows_take_all_bins(instrument, calibration):
    widest = dataclasses.replace(calibration.windows[0], start=0, stop=calibration.bins.count)
    filled = dataclasses.replace(calibration, windows=(widest, *calibration.windows[1:]))
    assert np.isnan(_background(np.ones((3, calibration.bins.count)), filled)).all()
    assert _background(np.ones((3, calibration.bins.count)), calibration) == pytest.approx(1)


def test_hot_and_dead_pixels_are_flagged(instrument, draw):
    reference = draw(instrument, depth=0.4, photons=5000)
    bins = instrument.time_bins()
    reference[1, 2, bins.codes] = 300
    reference[5, 6, 1:] = 0
    calibration = hf.calibrate(reference, instrument, distance=0.4)
    image = hf.reconstruct(draw(instrument, photons=500), calibration, method="paper")
    assert int(image.quality[1, 2]) & Quality.HOT
    assert int(image.quality[5, 6]) & Quality.DEAD
    assert np.isnan(image.depth[1, 2])
    assert np.isnan(image.depth[5, 6])


def test_lost_photons_are_made_up_for(instrument, calibration, draw):
    hits, frames = 3000, 4000  # −ln(1 − .75) = 1.386 arrived per exposure
    seen = draw(instrument, depth=0.4, photons=hits, frames=frames)
    image = hf.reconstruct(seen, calibration, method="paper")
    plain = hf.reconstruct(seen, calibration, method="paper", pileup_correction=False)
    ratio = float(image.reflectance.mean() / plain.reflectance.mean())
    # the reference lost 2.5 % of its own
    assert ratio == pytest.approx(1.386 / 0.75 / 1.025, rel=0.01)


def test_image_carries_units_wavelengths_and_provenance(image, instrument):
    assert image.depth.dims == ("row", "col")
    assert image.reflectance.dims == ("row", "col", "band")
    assert image.depth.attrs["units"] == "m"
    np.testing.assert_array_equal(image.wavelength, instrument.wavelengths_nm)
    assert image.attrs["instrument_fingerprint"] == instrument.fingerprint()
    assert image.attrs["method"] == "paper"
