# SPDX-License-Identifier: Apache-2.0
"""Changes between two captures of one scene, and their significance."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr

from hueflight.analysis.regions import reliable
from hueflight.arguments import NUMBER, takes
from hueflight.errors import HueflightError
from hueflight.files.image_schema import finite
from hueflight.reconstruction.range_correction import require_same_range_correction


@takes(before=xr.Dataset, after=xr.Dataset, false_discovery_rate=NUMBER)
def compare(
    before: xr.Dataset, after: xr.Dataset, /, *, false_discovery_rate: float = 0.05
) -> xr.Dataset:
    """Compare two images in depth and spectrum, pixel by pixel, with significance.

    Parameters
    ----------
    before, after : Dataset
        Images of the same instrument, as `hueflight.reconstruct` gives.
    false_discovery_rate : float
        Expected share of false positives among the pixels that are called changed, in 0..1.

    Returns
    -------
    Dataset
        Over (row, col): `depth_difference` (after − before, m) with `depth_difference_std`, and
        `depth_p`, the two-sided probability of such a difference by chance; over (row, col, band):
        `reflectance_difference` with `reflectance_difference_std`; over (row, col): `spectrum_p`,
        the probability for all bands together, `spectral_angle` (rad), `depth_changed` and
        `spectrum_changed`. NaN and False where either image has no reliable value.

    Raises
    ------
    HueflightError
        If the images come from different instruments or differ in shape, bands or range
        correction, or the rate lies outside 0..1.

    Notes
    -----
    Differences divided by their standard deviation are taken as normal; `spectrum_p` is the
    tail of χ² with as many degrees of freedom as bands. Which pixels changed is decided by
    the procedure of Benjamini and Hochberg (J. R. Stat. Soc. B 57, 289, 1995).
    """
    _require_comparable(before, after)
    if not 0 < false_discovery_rate < 1:
        raise HueflightError(f"false_discovery_rate = {false_discovery_rate}: must lie in 0..1")
    good = reliable(before) & reliable(after)
    depth, depth_std = _difference(before, after, "depth", good)
    colour, colour_std = _difference(before, after, "reflectance", good)
    depth_p = xr.apply_ufunc(lambda z: 2 * ndtr(-np.abs(z)), depth / depth_std)
    scores = (colour / colour_std) ** 2
    degrees = finite(scores).sum("band")
    spectrum_p = xr.apply_ufunc(chdtrc, degrees, scores.sum("band")).where(degrees > 0)
    angle = spectral_angle(before["reflectance"].where(good), after["reflectance"].where(good))
    found = {
        "depth_difference": depth.assign_attrs(units="m"),
        "depth_difference_std": depth_std.assign_attrs(units="m"),
        "depth_p": depth_p.assign_attrs(units="1", long_name="probability by chance alone"),
        "reflectance_difference": colour.assign_attrs(units="1"),
        "reflectance_difference_std": colour_std.assign_attrs(units="1"),
        "spectrum_p": spectrum_p.assign_attrs(units="1", long_name="probability by chance alone"),
        "spectral_angle": angle.assign_attrs(units="rad"),
        "depth_changed": depth_p.copy(data=discoveries(depth_p.values, false_discovery_rate)),
        "spectrum_changed": spectrum_p.copy(
            data=discoveries(spectrum_p.values, false_discovery_rate)
        ),
    }
    attributes = {
        "title": "Difference of two images",
        "false_discovery_rate": false_discovery_rate,
        **{key: after.attrs[key] for key in ("instrument", "software") if key in after.attrs},
    }
    return xr.Dataset(found, attrs=attributes)


def spectral_angle(first: xr.DataArray, second: xr.DataArray, /) -> xr.DataArray:
    """Compute the angle between spectra, which does not depend on their brightness.

    Bands without a value in either spectrum are left out. Kruse et al., Remote Sens. Environ. 44,
    145 (1993).

    Parameters
    ----------
    first, second : DataArray, dims (..., band)
        Spectra; other dimensions are broadcast.

    Returns
    -------
    DataArray
        Angles in radians over the other dimensions; NaN where either spectrum is 0 or unknown.

    Examples
    --------
    >>> red = xr.DataArray([0.2, 0.6], dims="band")
    >>> print(spectral_angle(red, 2 * red).item())
    0.0
    """
    both = finite(first) & finite(second)
    a, b = first.where(both, 0.0).astype(np.float64), second.where(both, 0.0).astype(np.float64)
    length_a, length_b = (a**2).sum("band") ** 0.5, (b**2).sum("band") ** 0.5
    seen = (length_a > 0) & (length_b > 0)
    unit_a, unit_b = a / length_a.where(seen), b / length_b.where(seen)
    # half-angle form: exact for small angles, where the cosine's digits run out (Kahan, 2006)
    apart = ((unit_a - unit_b) ** 2).sum("band") ** 0.5
    along = ((unit_a + unit_b) ** 2).sum("band") ** 0.5
    return 2 * xr.apply_ufunc(np.arctan2, apart, along).where(seen)


def discoveries(probabilities: NDArray[np.floating], rate: float, /) -> NDArray[np.bool_]:
    """Decide which null hypotheses to reject at a given false discovery rate.

    Benjamini and Hochberg, J. R. Stat. Soc. B 57, 289 (1995).

    Parameters
    ----------
    probabilities : ndarray of float
        Probability of each observation under its null hypothesis; NaN where there is none.
    rate : float
        Expected share of wrong rejections among all rejections.

    Returns
    -------
    ndarray of bool
        True where to reject, in the shape of `probabilities`; never for NaN.

    Examples
    --------
    >>> discoveries(np.array([0.001, 0.03, 0.5, np.nan]), 0.05).tolist()
    [True, True, False, False]
    """
    known = np.isfinite(probabilities)
    ordered = np.sort(probabilities[known])
    passing = np.flatnonzero(ordered <= rate * np.arange(1, ordered.size + 1) / ordered.size)
    if not passing.size:
        return np.zeros(probabilities.shape, dtype=bool)
    return known & (probabilities <= ordered[passing[-1]])


def _difference(
    before: xr.Dataset, after: xr.Dataset, name: str, good: xr.DataArray
) -> tuple[xr.DataArray, xr.DataArray]:
    """After − before and its standard deviation."""
    difference = (after[name].astype(np.float64) - before[name]).where(good)
    variances = [image[f"{name}_std"].astype(np.float64) ** 2 for image in (before, after)]
    deviation = (variances[0] + variances[1]) ** 0.5
    return difference, deviation.where(finite(difference) & (deviation > 0))


def _require_comparable(before: xr.Dataset, after: xr.Dataset) -> None:
    require_same_range_correction([before, after])
    made_by = [image.attrs.get("instrument_fingerprint") for image in (before, after)]
    if made_by[0] != made_by[1]:
        names = [image.attrs.get("instrument") for image in (before, after)]
        raise HueflightError(
            f"the images come from different instruments: {names[0]!r} ({made_by[0]}) and "
            f"{names[1]!r} ({made_by[1]}); only images of one instrument can be compared"
        )
    for dim in ("row", "col", "band"):
        if before.sizes.get(dim) != after.sizes.get(dim):
            raise HueflightError(
                f"the images differ in size: {dict(before.sizes)} and {dict(after.sizes)}"
            )
    if not np.array_equal(before["wavelength"].values, after["wavelength"].values):
        raise HueflightError(
            f"the images have different bands: {before['wavelength'].values.tolist()} and "
            f"{after['wavelength'].values.tolist()} nm"
        )
