# SPDX-License-Identifier: Apache-2.0
"""Filling for the eye, the three-band picture, colours of wavelengths."""

import numpy as np
import pytest
import xarray as xr

from hueflight.color.display import fill_missing, three_band_rgb, wavelength_colour
from hueflight.errors import HueflightError


def image_of(reflectance: np.ndarray, wavelengths: list[float]) -> xr.Dataset:
    return xr.Dataset(
        {"reflectance": (("row", "col", "band"), reflectance)},
        coords={"wavelength": ("band", wavelengths)},
    )


def test_a_single_hole_gets_the_mean_of_its_neighbours() -> None:
    plane = np.full((5, 5), 2.0)
    plane[2, 2] = np.nan
    np.testing.assert_allclose(fill_missing(plane), 2.0)
    assert np.isnan(plane[2, 2]), "the data themselves stay as they are"


def test_known_pixels_are_never_changed() -> None:
    rng = np.random.default_rng(1)
    plane = rng.random((20, 30))
    plane[rng.random(plane.shape) < 0.3] = np.nan
    filled = fill_missing(plane)
    known = np.isfinite(plane)
    np.testing.assert_array_equal(filled[known], plane[known])
    assert np.isfinite(filled).all()
    assert filled.min() >= np.nanmin(plane)
    assert filled.max() <= np.nanmax(plane)


def test_a_plane_without_any_value_stays_so() -> None:
    assert np.isnan(fill_missing(np.full((3, 3), np.nan))).all()


def test_rgb_takes_the_nearest_bands() -> None:
    wavelengths = [659.0, 623.0, 525.0, 445.0]
    reflectance = np.zeros((4, 4, 4))
    reflectance[..., 1] = 0.5  # only the 623 nm band is lit
    picture = three_band_rgb(image_of(reflectance, wavelengths))
    np.testing.assert_allclose(picture[..., 0], 1)
    np.testing.assert_allclose(picture[..., 1:], 0)


def test_a_dark_band_is_named() -> None:
    reflectance = np.full((2, 2, 3), np.nan)
    with pytest.raises(HueflightError, match="band at 623 nm has no pixel with a value"):
        three_band_rgb(image_of(reflectance, [623.0, 525.0, 445.0]))


def test_wavelengths_look_like_themselves() -> None:
    red, green, blue = (wavelength_colour(nm) for nm in (640, 530, 450))
    assert np.argmax(red) == 0
    assert np.argmax(green) == 1
    assert np.argmax(blue) == 2
    assert wavelength_colour(940) == (0.45, 0.45, 0.45)
