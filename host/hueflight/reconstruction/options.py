"""What a scene may not need: each skip has a name and can be switched off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError
from hueflight.fit.reference import DEFAULT, FitOptions
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.image import Estimates
from hueflight.reconstruction.quality import Quality

Region = tuple[slice, slice] | NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Skips:
    """What the joint fit leaves out; the image stays the same but for what is stated.

    Attributes
    ----------
    empty : pixels without a photon are not fitted: nothing is known of them either way.
    defects : dead and hot pixels are not fitted: their results are never shown.
    depth_target : m; pixels whose depth is known this well after the search's wide bins keep that
        result, within 0.3 of its standard deviation of the full one. 0 for none.
    switches : steps of the fit; see `FitOptions`.
    """

    empty: bool = True
    defects: bool = True
    depth_target: float = 0.0
    switches: FitOptions = DEFAULT

    def __post_init__(self) -> None:
        if not (isfinite(self.depth_target) and self.depth_target >= 0):
            raise HueflightError(
                f"depth_target = {self.depth_target!r}: a standard deviation in metres, or 0"
            )

    def of_fit(self, calibration: Calibration) -> FitOptions:
        """FitOptions of the fit with the target as a delay."""
        if not self.depth_target:
            return self.switches
        steepest = float(calibration.instrument.ray_cosine().max())
        target_ns = 2 * self.depth_target / (SPEED_OF_LIGHT_M_PER_NS * steepest)
        return replace(self.switches, target_ns=target_ns)


NO_SKIPS = Skips(
    empty=False,
    defects=False,
    switches=FitOptions(settle=False),
)
DEFAULT_SKIPS = Skips()


def region_mask(region: Region | None, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels (row, col) of a region: two slices, or a mask.

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
    """Pixels (row, col) that were not asked for: no results, flagged skipped."""
    if not pixels.any():
        return
    for values in (estimates.depth, estimates.depth_std, estimates.background):
        values[pixels] = np.nan
    for values in (estimates.reflectance, estimates.reflectance_std):
        values[:, pixels] = np.nan
    if estimates.other_depth is not None:
        estimates.other_depth[pixels] = np.nan
    estimates.quality[pixels] &= ~np.uint16(Quality.LOW_SIGNAL | Quality.AMBIGUOUS)
    estimates.quality[pixels] |= int(Quality.SKIPPED)


def band_numbers(bands: Any, calibration: Calibration) -> list[int]:
    """Places of the bands asked for, by name or number, in the order given.

    Raises
    ------
    HistogramError
        If one is not the instrument's, or none is asked for.
    """
    names = [band.name for band in calibration.instrument.bands]
    if bands is None:
        return list(range(len(names)))
    numbers = []
    for band in bands:
        number = names.index(band) if isinstance(band, str) and band in names else band
        if isinstance(number, str) or not 0 <= int(number) < len(names):
            raise HistogramError(f"bands: there is no {band!r}; choose from {', '.join(names)}")
        numbers.append(int(number))
    if not numbers or len(set(numbers)) < len(numbers):
        raise HistogramError(f"bands = {bands!r}: name each band once, one at least")
    return numbers
