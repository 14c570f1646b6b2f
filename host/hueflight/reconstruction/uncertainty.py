# SPDX-License-Identifier: Apache-2.0
"""Confidence intervals of reflectance that have the stated coverage with few photons, too.

The number of photons of a band has a variance that grows with the band's own light. An interval of
some standard deviations about an estimate uses the variance at the estimate: it is too short where
the photons came out few, and covers the truth less often than stated. The score interval asks
instead which true values make the estimate likely, each with the variance that it would have
(Wilson, J. Am. Stat. Assoc. 22, 209, 1927, for proportions).
"""

from __future__ import annotations

import xarray as xr
from scipy.special import ndtri

from hueflight.arguments import NUMBER, takes
from hueflight.errors import ImageError


@takes(image=xr.Dataset, level=NUMBER)
def reflectance_interval(
    image: xr.Dataset, /, *, level: float = 0.95
) -> tuple[xr.DataArray, xr.DataArray]:
    """Return the lowest and the highest plausible reflectance.

    With variance V at the estimate â, in photons, that of a true a is V + a − â; the interval holds
    all a ≥ 0 with (â − a)² ≤ z² (V + a − â). Where a band expects fewer than about three photons,
    the interval covers more than stated, because photons are whole.

    Parameters
    ----------
    image : Dataset
        Image from ``method="joint"``; reflectances may be below 0, as noise makes them.
    level : float
        Share of intervals that cover the truth, above 0 and below 1.

    Returns
    -------
    low : DataArray, shape (…, row, col, band)
        Lower bound.
    high : DataArray, shape (…, row, col, band)
        Upper bound.

    Raises
    ------
    ImageError
        If the level is out of range, or the image does not tell how many photons white would give.
    """
    if not 0 < level < 1:
        raise ImageError(f"level = {level!r}: must lie between 0 and 1, e.g. 0.95")
    if "white_photons" not in image.coords:
        raise ImageError(
            "the image does not say how many photons a white surface would have given, which "
            "intervals need: reconstruct with method='joint'"
        )
    z = float(ndtri((1 + level) / 2))
    photon = 1 / (image["white_photons"] * image["white_share"])  # reflectance of one photon
    estimate, deviation = image["reflectance"], image["reflectance_std"]
    # the stated variance holds half a photon more, for those that could have come
    counted = (deviation**2 - photon**2 / 2).clip(min=0)
    variance = counted + photon * (-estimate).clip(min=0)
    center = estimate + z**2 / 2 * photon
    half = z * (variance + (z / 2 * photon) ** 2) ** 0.5

    def bound(values: xr.DataArray) -> xr.DataArray:
        return values.clip(min=0).drop_vars("white_photons").assign_attrs(units="1")

    return bound(center - half), bound(center + half)
