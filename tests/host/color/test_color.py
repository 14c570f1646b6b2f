# SPDX-License-Identifier: Apache-2.0
"""Colours and spectra behind the bands, against measured LEDs, measured surfaces and the CIE."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import hueflight as hf
from hueflight.analysis import delta_e_2000, lab
from hueflight.color import SpectralModel, color_picture, in_color, srgb_of, tristimulus
from hueflight.color.recovery import NODES_NM
from hueflight.errors import HueflightError, ImageError
from hueflight.files.image_schema import instrument_of
from hueflight.model.emission import Emission

SPECTRA = Path(__file__).parents[4] / "shared" / "data" / "spectra"
measured = pytest.mark.skipif(
    not SPECTRA.is_dir(), reason=f"measured spectra are not in {SPECTRA}: colour is not compared"
)


@pytest.fixture(scope="module")
def chart() -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths and measured reflectance (patch, wavelength) of a ColorChecker."""
    table = np.loadtxt(SPECTRA / "colorchecker_iso17321_1nm.csv", delimiter=",", skiprows=1)
    return table[:, 0], table[:, 1:].T


@pytest.fixture(scope="module")
def leds() -> Emission:
    return Emission.load(SPECTRA / "led9_closest_1nm.csv", hf.Instrument.load("paper"))


def true_colours(chart) -> np.ndarray:
    wavelengths, reflectance = chart
    weights = tristimulus(wavelengths)
    return lab(reflectance @ weights.T, white=weights.sum(axis=1))


def colours(xyz: np.ndarray) -> np.ndarray:
    return lab(np.maximum(xyz, 0), white=tristimulus(NODES_NM).sum(axis=1))


@measured
def test_colorchecker_without_noise(chart, leds):
    instrument = hf.Instrument.load("paper")
    bands = chart[1] @ leds.shares(instrument, chart[0]).T
    model = SpectralModel.of(instrument, leds)
    xyz, _ = model.recover(bands, np.zeros_like(bands), model.to_xyz())
    error = delta_e_2000(colours(xyz), true_colours(chart))
    # a map trained on 1269 Munsell spectra reaches 0.58 on average; this one saw no surface
    assert error.mean() < 0.8
    assert error.max() < 3


@measured
@pytest.mark.parametrize(("photons_on_white", "most"), [(10_000, 2.5), (620, 7.7)])
def test_colorchecker_through_the_fit(chart, leds, small, draw, photons_on_white, most):
    instrument = small(rows=16, cols=20)
    one_by_one = [draw(instrument, photons=20_000, reflectance=led) for led in np.eye(9)]
    calibration = hf.calibrate(
        draw(instrument, photons=50_000), instrument, distance=0.5, bands=np.stack(one_by_one)
    )
    bands = chart[1] @ leds.shares(instrument, chart[0]).T
    share = instrument.band_brightness() / instrument.band_brightness().sum()
    true = true_colours(chart)
    frames = 10**6
    level = calibration.brightness.sum() * frames / photons_on_white  # white's light against ours
    errors = []
    for patch, reflectance in enumerate(bands):
        photons = photons_on_white * float(reflectance @ share)
        counts = draw(
            instrument, depth=0.6, photons=photons, reflectance=reflectance, frames=frames,
            seed=patch,
        )  # fmt: skip
        image = hf.reconstruct(counts, calibration, range_correction=False)
        image["reflectance"] = image["reflectance"] * level
        image["reflectance_std"] = image["reflectance_std"] * level
        image = image.assign_coords(white_photons=image["white_photons"] / level)
        xyz = in_color(image, instrument=instrument, emission=leds)
        # of the black patch, with 20 photons, some pixels show no surface and have no colour
        seen = np.isfinite(image["depth"].values)
        assert seen.mean() > 0.2
        errors.append(delta_e_2000(colours(xyz.values[seen]), true[patch]).mean())
    # 320 pixels a patch: the mean over patches is good to 0.05 at 620 photons, 0.02 at 10 000
    assert np.mean(errors) < most


@measured
def test_narrow_reflectance_is_nearer_than_the_bands(chart, leds):
    instrument = hf.Instrument.load("paper")
    bands = chart[1] @ leds.shares(instrument, chart[0]).T
    model = SpectralModel.of(instrument, leds)
    peaks = instrument.wavelengths_nm
    narrow, deviation = model.recover(bands, np.zeros_like(bands), model.at(peaks))
    truth = np.array([np.interp(peaks, chart[0], patch) for patch in chart[1]])
    uncorrected = np.sqrt(np.mean((bands - truth) ** 2))
    corrected = np.sqrt(np.mean((narrow - truth) ** 2))
    assert uncorrected == pytest.approx(0.0145, abs=0.001)
    assert corrected < 0.5 * uncorrected
    # greys that turn dark towards the violet are a little less sure than the prior thinks
    assert np.mean(((narrow - truth) / deviation) ** 2) < 1.4


def test_grey_stays_grey():
    instrument = hf.Instrument.load("paper")
    model = SpectralModel.of(instrument)
    for level in (0.02, 0.4, 1.0):
        xyz, _ = model.recover(np.full(9, level), np.full(9, 0.02), model.to_xyz())
        assert np.abs(colours(xyz / level)[1:]).max() < 1e-6


@given(st.floats(1e-6, 1e6), st.integers(0, 2**32 - 1))
def test_light_level_only_scales(level, seed):
    model = SpectralModel.of(hf.Instrument.load("paper"))
    rng = np.random.default_rng(seed)
    values, deviation = rng.uniform(0.05, 1, 9), rng.uniform(0.01, 0.3, 9)
    xyz, doubt = model.recover(values, deviation, model.to_xyz())
    scaled, scaled_doubt = model.recover(values * level, deviation * level, model.to_xyz())
    np.testing.assert_allclose(scaled, xyz * level, rtol=1e-9, atol=1e-9 * level)
    np.testing.assert_allclose(scaled_doubt, doubt * level, rtol=1e-6)


def test_less_noise_never_leaves_more_doubt():
    model = SpectralModel.of(hf.Instrument.load("paper"))
    values = np.linspace(0.2, 0.8, 9)
    doubts = [
        model.recover(values, np.full(9, noise), model.to_xyz())[1]
        for noise in (0.5, 0.1, 0.03, 0.01, 0.0)
    ]
    assert (np.diff(doubts, axis=0) <= 0).all()


def test_unknown_bands_are_left_out():
    model = SpectralModel.of(hf.Instrument.load("paper"))
    values = np.full(9, 0.5)
    values[3] = np.nan
    xyz, _ = model.recover(values, np.full(9, 0.01), model.to_xyz())
    full, _ = model.recover(np.full(9, 0.5), np.full(9, 0.01), model.to_xyz())
    np.testing.assert_allclose(xyz, full, atol=0.01)
    nothing, doubt = model.recover(np.full(9, np.nan), np.full(9, np.nan), model.to_xyz())
    assert np.isnan(nothing).all()
    assert np.isnan(doubt).all()


def test_bands_that_hardly_differ_do_not_ring():
    """Emitters on top of one another: the estimate stays bounded and says how unsure it is."""
    instrument = hf.Instrument.load("paper")
    one = Emission.nominal(instrument)
    power = one.power.copy()
    power[1] = power[2] * (1 + 1e-9)
    twins = Emission(one.wavelengths_nm, power)
    assert twins.overlap(instrument)[1, 2] == pytest.approx(1)
    model = SpectralModel.of(instrument, twins)
    values = np.full(9, 0.5)
    values[1] += 0.05
    spectrum, _ = model.recover(values, np.full(9, 0.05), model.at(np.arange(400.0, 701.0, 10)))
    assert np.abs(spectrum - 0.5).max() < 0.06


def test_srgb_of_known_colours():
    white = tristimulus(NODES_NM).sum(axis=1)
    np.testing.assert_allclose(srgb_of(white), 1, atol=1e-12)
    np.testing.assert_allclose(srgb_of(0.0 * white), 0, atol=1e-12)
    # 21.4 % of white's light is 0.5 on the screen (IEC 61966-2-1)
    np.testing.assert_allclose(srgb_of(0.21404114 * white), 0.5, atol=1e-6)
    # D65: x = 0.3127, y = 0.3290; illuminant C: x = 0.3101, y = 0.3162 (CIE 15)
    for name, x, y in (("D65", 0.3127, 0.3290), ("C", 0.3101, 0.3162)):
        xyz = tristimulus(NODES_NM, illuminant=name).sum(axis=1)
        np.testing.assert_allclose(xyz[:2] / xyz.sum(), [x, y], atol=2e-4)


@pytest.fixture(scope="module")
def image(small, draw) -> tuple[xr.Dataset, hf.Instrument]:
    instrument = small(rows=4, cols=5)
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    red = np.where(instrument.wavelengths_nm > 600, 1.0, 0.05)
    return hf.reconstruct(draw(instrument, photons=5000, reflectance=red), calibration), instrument


def test_picture_of_a_red_wall_is_red(image):
    picture = color_picture(image[0], instrument=image[1])
    assert picture.shape == (4, 5, 3)
    assert (picture[..., 0] > 2 * picture[..., 1:].max(axis=-1)).all()
    brighter = color_picture(image[0], instrument=image[1], white=10.0)
    assert brighter.max() < picture.max()


def test_some_of_the_bands_suffice(image):
    some = image[0].isel(band=[0, 4, 7])
    picture = color_picture(some, instrument=image[1])
    assert (picture[..., 0] > 2 * picture[..., 1:].max(axis=-1)).all()


def test_pictures_that_cannot_be(image):
    with pytest.raises(HueflightError, match=r"white = -1\.0"):
        color_picture(image[0], instrument=image[1], white=-1.0)
    with pytest.raises(ImageError, match="does not describe its instrument"):
        color_picture(image[0])
    blank = image[0].assign(reflectance=image[0]["reflectance"] * np.nan)
    with pytest.raises(HueflightError, match="nothing to show"):
        color_picture(blank, instrument=image[1])
    assert instrument_of(image[0], image[1]) is image[1]
