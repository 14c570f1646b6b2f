# SPDX-License-Identifier: Apache-2.0
"""Options of reconstruction, and the parts of an image that are asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError, ImageError
from hueflight.files.bands import find_band
from hueflight.fit.reference import DEFAULT, FitOptions
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.quality import Quality

ABOUT_COUNTS = Quality.DEAD | Quality.HOT | Quality.SATURATED  #: flags that need no estimate

Region = tuple[slice, slice] | NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Skips:
    """What the joint fit may leave out; the image stays the same except as stated.

    Attributes
    ----------
    empty : bool
        Do not fit pixels without a photon: nothing is known of them either way.
    defects : bool
        Do not fit dead and hot pixels: their results are never shown.
    depth_target : float
        Standard deviation of depth, m. Pixels whose depth is known this well after the wide bins
        of the search keep that result, which is within 0.3 standard deviations of the full one.
        0 for none.
    assessment : bool
        Test whether one surface explains the counts. Without it, an image has no `fit_chi_square`
        and no `fit_p_value`, no pixel is flagged as a misfit, and deviations do not contain the
        misfit that all pixels have in common; all else stays the same.
    switches : FitOptions
        Steps of the fit.

    Raises
    ------
    HueflightError
        If `depth_target` is negative or not finite.
    """

    empty: bool = True
    defects: bool = True
    depth_target: float = 0.0
    assessment: bool = True
    switches: FitOptions = DEFAULT

    def __post_init__(self) -> None:
        if not (isfinite(self.depth_target) and self.depth_target >= 0):
            raise HueflightError(
                f"depth_target = {self.depth_target!r}: a standard deviation in metres, or 0"
            )

    def of_fit(self, calibration: Calibration) -> FitOptions:
        """Return the options of the fit, with the target as a delay.

        Parameters
        ----------
        calibration : Calibration
            Calibration of the instrument, which gives the angles of the rays.

        Returns
        -------
        FitOptions
            Options of the fit.
        """
        switches = self.switches
        if not self.assessment:
            switches = replace(switches, assessment=False)
        if not self.depth_target:
            return switches
        steepest = float(calibration.instrument.ray_cosine().max())
        target_ns = 2 * self.depth_target / (SPEED_OF_LIGHT_M_PER_NS * steepest)
        return replace(switches, target_ns=target_ns)


NO_SKIPS = Skips(
    empty=False,
    defects=False,
    switches=FitOptions(settle=False),
)
DEFAULT_SKIPS = Skips()


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions:
    """Options that every method receives.

    Attributes
    ----------
    depth_range : tuple of float, or None
        Nearest and farthest depth to search, m; None for half the spacing of the pulses about the
        distance of the reference.
    range_correction : bool
        Multiply reflectance by the squared ratio of the distance to that of the reference.
    pileup_correction : bool
        Undo the loss of photons that arrive after the first one of an exposure.
    background : BackgroundShape or {"sloped"}
        How the background is distributed over the time bins; "sloped" until it is known.
    region : ndarray of bool, shape (row, col), or None
        Pixels that are asked for, None for all. A method may estimate more.
    skips : Skips
        What a method may leave out.
    threads : int
        Threads that a method may use.
    mixed : bool
        Find the pixels at edges that see two surfaces, of an instrument with a lens.
    second_returns : bool or {"auto"}
        Fit two surfaces to pixels whose counts one surface does not explain; "auto" to leave out
        those that departures of the whole picture explain.
    """

    depth_range: tuple[float, float] | None = None
    range_correction: bool = False
    pileup_correction: bool = True
    background: BackgroundShape | Literal["sloped"] = FLAT
    region: NDArray[np.bool_] | None = None
    skips: Skips = DEFAULT_SKIPS
    threads: int = 1
    mixed: bool = False
    second_returns: bool | Literal["auto"] = False

    def __post_init__(self) -> None:
        if self.depth_range is not None:  # a list or an array would be no key of kept tables
            near, far = self.depth_range
            object.__setattr__(self, "depth_range", (float(near), float(far)))


#: fields of `EstimatorOptions` that change the result, so that a method must not ignore them
BINDING_OPTIONS = frozenset(
    {
        "depth_range",
        "range_correction",
        "pileup_correction",
        "background",
        "mixed",
        "second_returns",
    }
)


def region_mask(region: Region | None, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the pixels of a region as a mask.

    Parameters
    ----------
    region : tuple of two slices, ndarray of bool of shape (row, col), or None
        Rows and columns, a mask, or None for all pixels.
    shape : tuple of int
        Rows and columns of the image.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True for pixels of the region.

    Raises
    ------
    HistogramError
        If it is neither, or has no pixel.
    """
    if region is None:
        return np.ones(shape, bool)
    mask = np.zeros(shape, bool)
    if isinstance(region, np.ndarray):
        if region.shape != shape or region.dtype != np.bool_:
            raise HistogramError(
                f"region is an array {region.shape} of {region.dtype}: a mask must be {shape} of "
                "bool"
            )
        mask |= region
    elif isinstance(region, tuple) and all(isinstance(part, slice) for part in region):
        if len(region) != 2:
            raise HistogramError(f"region = {region!r}: give a slice of rows and one of columns")
        mask[region] = True
    else:
        raise HistogramError(f"region = {region!r}: give two slices (np.s_[a:b, c:d]) or a mask")
    if not mask.any():
        raise HistogramError(f"region = {region!r} holds no pixel of the {shape} image")
    return mask


def leave_out(estimates: Estimates, pixels: NDArray[np.bool_]) -> None:
    """Remove the results of pixels that were not asked for, and flag them skipped.

    Parameters
    ----------
    estimates : Estimates
        Results, which are changed.
    pixels : ndarray of bool, shape (row, col)
        Pixels to leave out.
    """
    if not pixels.any():
        return
    for values in (estimates.depth, estimates.depth_std, estimates.background):
        values[pixels] = np.nan
    for values in (estimates.reflectance, estimates.reflectance_std):
        values[:, pixels] = np.nan
    planes = ("other_depth", "fit_chi_square", "fit_p_value", "second_depth", "second_depth_std")
    for name in (*planes, "near_share", "near_share_std"):
        values = getattr(estimates, name)
        if values is not None:
            values[pixels] = np.nan
    estimates.quality[pixels] &= np.uint16(ABOUT_COUNTS)
    estimates.quality[pixels] |= int(Quality.SKIPPED)


def band_numbers(bands: Any, calibration: Calibration) -> list[int]:
    """Return the numbers of the bands that are asked for, in the order given.

    Parameters
    ----------
    bands : sequence of str or int, or None
        Names, numbers or wavelengths such as ``"532 nm"``; None for all bands.
    calibration : Calibration
        Calibration of the instrument.

    Returns
    -------
    list of int
        Numbers of the bands.

    Raises
    ------
    HistogramError
        If one is not the instrument's, or none is asked for.
    """
    instrument = calibration.instrument
    if bands is None:
        return list(range(len(instrument.bands)))
    names = [band.name for band in instrument.bands]
    known = xr.Dataset(
        coords={"wavelength": ("band", instrument.wavelengths_nm), "band_name": ("band", names)}
    )
    try:
        numbers = [find_band(known, band) for band in bands]
    except ImageError as error:
        raise HistogramError(f"bands: {error}") from None
    if not numbers or len(set(numbers)) < len(numbers):
        raise HistogramError(f"bands = {bands!r}: name each band once, one at least")
    return numbers
