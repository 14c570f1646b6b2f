# SPDX-License-Identifier: Apache-2.0
"""A filter and a slab in the light's way, through the whole chain."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.analysis import transmittance
from hueflight.errors import HueflightError, ImageError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS


def test_filter_and_slab_are_measured(small: Callable[..., hf.Instrument], draw: Any) -> None:
    """A filter's transmittance per band and the longer path through 10 cm of glass."""
    camera = small(rows=12, cols=12)
    through = np.array([0.9, 0.8, 0.7, 0.5, 0.3, 0.2, 0.5, 0.9, 0.9])
    index, thickness = 1.5, 0.10
    # the draw's `depth` is half the light's way
    extra_depth = (index - 1) * thickness / 2
    # light that comes straight through is bright: as many photons per band as the filter leaves
    white = camera.band_brightness()
    bright = 40_000.0
    open_path = draw(camera, depth=0.4, photons=bright, seed=1)
    sample = draw(
        camera,
        depth=0.4 + extra_depth,
        photons=bright * (white @ through) / white.sum(),
        reflectance=through,
        seed=2,
    )
    calibration = hf.calibrate(open_path, camera, distance=0.4)
    found = transmittance(
        hf.reconstruct(sample, calibration, range_correction=False), instrument=camera
    )
    mean = found["transmittance"].mean(("row", "col"))
    # 144 pixels of some thousand photons a band, so 0.2 %; 3 % allows for the windows, which cut
    # the pulses' feet at slightly different places
    np.testing.assert_allclose(mean, through, rtol=0.03)
    np.testing.assert_allclose(
        found["absorbance"].mean(("row", "col")), -np.log10(through), atol=0.02
    )
    path = float(found["optical_path"].mean())
    assert path == pytest.approx((index - 1) * thickness, abs=0.01)
    assert float(found["optical_path_std"].mean()) > 0
    assert SPEED_OF_LIGHT_M_PER_NS * 1e9 == 299_792_458


def test_errors_propagate(noisy: Callable[..., xr.Dataset]) -> None:
    camera = hf.Instrument.load("paper")
    image = noisy(rows=192, cols=128, reflectance=0.25, reflectance_std=0.01, depth=0.45)
    found = transmittance(image.drop_attrs(deep=False).assign_attrs(reference_distance_m=0.4),
                          instrument=camera)  # fmt: skip
    # log10 is nearly straight over 4 %: its scatter is what the propagated error says
    np.testing.assert_allclose(found["absorbance"].std(), found["absorbance_std"].mean(), rtol=0.01)
    centre = float(found["optical_path"][95:97, 63:65].mean())
    assert centre == pytest.approx(2 * (float(image["depth"][95:97, 63:65].mean()) - 0.4), rel=1e-3)
    cosine = camera.ray_cosine()
    np.testing.assert_allclose(found["optical_path_std"], 2 * 0.02 / cosine)


def test_what_it_cannot_do_is_said(noisy: Callable[..., xr.Dataset]) -> None:
    image = noisy()
    with pytest.raises(ImageError, match="does not describe its instrument"):
        transmittance(image)
    corrected = image.copy()
    corrected["reflectance"].attrs["range_correction"] = "inverse square"
    with pytest.raises(HueflightError, match="range_correction=False"):
        transmittance(corrected)
    with pytest.raises(HueflightError, match="reference_distance_m"):
        transmittance(image.drop_attrs(deep=False))


def test_no_light_has_no_absorbance(noisy: Callable[..., xr.Dataset]) -> None:
    camera = hf.Instrument.load("paper")
    image = noisy(rows=192, cols=128).drop_attrs(deep=False).assign_attrs(reference_distance_m=0.4)
    image["reflectance"][0, 0] = 0.0
    image["reflectance"][0, 1] = -0.01
    found = transmittance(image, instrument=camera)
    assert np.isnan(found["absorbance"][0, :2]).all()
    assert (found["transmittance"][0, 1] == -0.01).all()
