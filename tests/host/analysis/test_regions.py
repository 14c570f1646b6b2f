# SPDX-License-Identifier: Apache-2.0
"""Means of regions and cuts: by hand, and their errors by repetition."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from hueflight.analysis import parse_region, profile, region_spectra, reliable
from hueflight.errors import HueflightError
from hueflight.reconstruction.quality import Quality

Noisy = Callable[..., xr.Dataset]
PATCH = {"patch": (slice(5, 15), slice(10, 30))}


def test_means_by_hand(noisy: Noisy) -> None:
    image = noisy(seed=1)
    image["reflectance"][6, 12, 3] = np.nan  # one band of one pixel
    image["quality"][7, 13] = int(Quality.HOT)
    spectra = region_spectra(image, PATCH).sel(region="patch")
    values = image["reflectance"].values[5:15, 10:30].copy()
    values[2, 3] = np.nan
    np.testing.assert_allclose(spectra["reflectance"], np.nanmean(values, axis=(0, 1)), rtol=1e-12)
    np.testing.assert_allclose(
        spectra["reflectance_scatter"], np.nanstd(values, axis=(0, 1), ddof=1), rtol=1e-12
    )
    count = np.isfinite(values).sum(axis=(0, 1))
    assert list(count) == [199, 199, 199, 198, 199, 199, 199, 199, 199]
    np.testing.assert_allclose(spectra["reflectance_std"], 0.05 / np.sqrt(count))
    assert int(spectra["pixels"]) == 199
    assert float(spectra["depth_std"]) == pytest.approx(0.02 / np.sqrt(199))


def test_standard_errors_are_what_repetition_shows(noisy: Noisy) -> None:
    scores = []
    for seed in range(60):
        found = region_spectra(noisy(seed=seed), PATCH).sel(region="patch")
        scores.append(((found["reflectance"] - 0.5) / found["reflectance_std"]).values)
        scores.append(np.atleast_1d(((found["depth"] - 1.0) / found["depth_std"]).values))
    # false alarm 1e-6: the scores are standard normal
    assert stats.kstest(np.concatenate(scores), "norm").pvalue > 1e-6


def test_masks_slices_and_text_name_the_same_region(noisy: Noisy) -> None:
    image = noisy(seed=2)
    mask = np.zeros((40, 50), dtype=bool)
    mask[20:, :40] = True
    name, slices = parse_region("wall=20:,:40")
    both = region_spectra(image, {name: slices, "mask": mask})
    assert list(both["region"].values) == ["wall", "mask"]
    np.testing.assert_array_equal(both["reflectance"][0], both["reflectance"][1])


@pytest.mark.parametrize("text", ["wall", "wall=1:2", "=1:2,3:4", "w=a:2,3:4", "w=1:2:3,4:5"])
def test_regions_written_wrongly_are_quoted(text: str) -> None:
    with pytest.raises(HueflightError, match="write NAME=ROW:ROW,COL:COL"):
        parse_region(text)


def test_every_flag_that_matters_is_heeded(noisy: Noisy) -> None:
    image = noisy()
    # pixels with these flags are NaN already; the flag alone takes nothing away
    without_result = Quality.LOW_SIGNAL | Quality.NO_RETURN | Quality.OUT_OF_RANGE
    for flag in Quality:
        flagged = image.assign(quality=image["quality"] + np.uint16(flag))
        assert bool(reliable(flagged).all()) == (flag in without_result)
    none = region_spectra(image.assign(quality=image["quality"] + np.uint16(1)), PATCH)
    assert np.isnan(none["reflectance"]).all()
    assert np.isnan(none["depth_std"]).all()
    assert int(none["pixels"][0]) == 0


def test_no_regions_is_an_error(noisy: Noisy) -> None:
    with pytest.raises(HueflightError, match="regions is empty"):
        region_spectra(noisy(), {})


def test_profile_by_hand(noisy: Noisy) -> None:
    steps = np.linspace(0.8, 1.2, 50)
    image = noisy(depth=steps, seed=3)
    image["quality"][19, 7] = int(Quality.DEAD)
    image["depth"][20, 8] = np.nan
    cut = profile(image, row=20, half_width=1)
    depth = image["depth"].values[19:22].copy()
    depth[0, 7] = np.nan
    np.testing.assert_allclose(cut["depth"], np.nanmean(depth, axis=0))
    used = np.isfinite(depth).sum(axis=0)
    np.testing.assert_allclose(cut["depth_std"], 0.02 / np.sqrt(used))
    assert set(used) == {2, 3}
    # false alarm about 50 * 6e-7: no column five standard deviations off
    assert (np.abs(cut["depth"] - steps) < 5 * cut["depth_std"]).all()
    assert cut["depth"].attrs["units"] == "m"
    upright = profile(image, col=4)
    np.testing.assert_array_equal(upright["reflectance"], image["reflectance"][:, 4])


def test_profile_at_the_edge_and_beyond(noisy: Noisy) -> None:
    image = noisy()
    np.testing.assert_allclose(
        profile(image, row=0, half_width=3)["depth"], image["depth"][:4].mean("row")
    )
    with pytest.raises(HueflightError, match="the image has rows 0 to 39"):
        profile(image, row=40)
    for wrong in ({}, {"row": 1, "col": 1}):
        with pytest.raises(HueflightError, match="give exactly one"):
            profile(image, **wrong)
    with pytest.raises(HueflightError, match="half_width = -1"):
        profile(image, row=1, half_width=-1)
