# SPDX-License-Identifier: Apache-2.0
"""Series of captures: stacked, and their trends with honest errors."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from hueflight.analysis import region_spectra, stack, trend
from hueflight.errors import HueflightError

Noisy = Callable[..., xr.Dataset]


def test_stack_keeps_every_image(noisy: Noisy) -> None:
    images = [noisy(seed=seed) for seed in range(3)]
    series = stack(images, names=["a", "b", "c"], time=[0, 60, 120])
    for name, image in zip("abc", images, strict=True):
        one = series.sel(capture=name).drop_vars(["capture", "time"])
        xr.testing.assert_identical(one, image)
    assert series["time"].attrs["units"] == "s"
    assert list(stack(images)["capture"].values) == ["0", "1", "2"]


def test_images_that_make_no_series(noisy: Noisy) -> None:
    image = noisy()
    with pytest.raises(HueflightError, match="at least one image"):
        stack([])
    with pytest.raises(HueflightError, match="image 1 has instrument 'other', image 0 'paper'"):
        stack([image, image.assign_attrs(instrument="other")])
    with pytest.raises(HueflightError, match="reconstruct them alike"):
        stack([image, image.isel(row=slice(5))])
    with pytest.raises(HueflightError, match="reconstruct them alike"):
        stack([image, image.drop_vars("depth_std")])
    with pytest.raises(HueflightError, match="1 names for 2 images"):
        stack([image, image], names=["a"])
    with pytest.raises(HueflightError, match=r"time has shape \(3,\) for 2 images"):
        stack([image, image], time=[0, 1, 2])


def test_trend_recovers_the_line_with_its_errors(noisy: Noisy) -> None:
    times = np.array([0.0, 1.0, 2.5, 7.0, 8.0])
    images = [noisy(seed=i, depth=1.0 + 0.01 * t) for i, t in enumerate(times)]
    series = stack(images, time=times)
    found = trend(series["depth"], series["depth_std"])
    scores = ((found["slope"] - 0.01) / found["slope_std"]).values.ravel()
    # false alarm 1e-6 each: slopes are normal, residuals follow χ² with 3 degrees of freedom
    assert stats.kstest(scores, "norm").pvalue > 1e-6
    residual = 3 * found["chi2_per_degree"].values.ravel()
    assert stats.kstest(residual, "chi2", args=(3,)).pvalue > 1e-6


def test_trend_by_scipy(noisy: Noisy) -> None:
    images = [noisy(seed=i) for i in range(6)]
    times = np.array([0.0, 2.0, 3.0, 5.0, 8.0, 13.0])
    regions = {"a": (slice(0, 5), slice(0, 5)), "b": (slice(5, 9), slice(0, 9))}
    spectra = region_spectra(stack(images, time=times), regions)
    found = trend(spectra["reflectance"], spectra["reflectance_std"])
    assert found["slope"].dims == ("region", "band")
    for region in range(2):
        values = spectra["reflectance"].values[:, region, 4]
        line = stats.linregress(times, values)  # equal errors: weights play no part
        assert float(found["slope"][region, 4]) == pytest.approx(line.slope)


def test_trend_skips_captures_without_a_value(noisy: Noisy) -> None:
    series = stack([noisy(seed=i, depth=1 + 0.5 * i, depth_std=1e-6) for i in range(4)])
    series["depth"][1, 0, 0] = np.nan
    series["depth"][1:, 0, 1] = np.nan  # one left: no line through it
    found = trend(series["depth"], series["depth_std"])
    assert float(found["slope"][0, 0]) == pytest.approx(0.5, abs=1e-4)
    assert np.isnan(found["slope"][0, 1])


def test_trend_by_dates(noisy: Noisy) -> None:
    series = stack([noisy(seed=i, depth=1 + 0.1 * i, depth_std=1e-9) for i in range(3)])
    days = np.array(["2026-01-01", "2026-01-02", "2026-01-03"], dtype="datetime64[ns]")
    dated = series.assign_coords(time=("capture", days))
    slope = trend(dated["depth"], dated["depth_std"])["slope"]
    np.testing.assert_allclose(slope, 0.1 / 86400, rtol=1e-6)


def test_no_trend_without_two_times(noisy: Noisy) -> None:
    one = stack([noisy()])
    with pytest.raises(HueflightError, match="at least two captures"):
        trend(one["depth"], one["depth_std"])
    same = stack([noisy(), noisy()], time=[5, 5])
    with pytest.raises(HueflightError, match="the same time"):
        trend(same["depth"], same["depth_std"])
