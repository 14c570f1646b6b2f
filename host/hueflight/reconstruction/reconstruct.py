"""The door to reconstruction: one histogram and a calibration in, one image out."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr
from numpy.typing import ArrayLike

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError
from hueflight.reconstruction import joint, paper
from hueflight.reconstruction.image import as_image
from hueflight.reconstruction.inputs import prepare_histogram
from hueflight.reconstruction.options import (
    DEFAULT_SKIPS,
    Region,
    Skips,
    band_numbers,
    leave_out,
    region_mask,
)
from hueflight.reconstruction.pooled import estimate as few_photons
from hueflight.reconstruction.quality import Quality

METHODS = ("joint", "paper", "pooled")


def reconstruct(
    histogram: ArrayLike,
    calibration: Calibration,
    /,
    *,
    method: str = "joint",
    depth_range: tuple[float, float] | None = None,
    frames: ArrayLike | None = None,
    range_correction: bool = False,
    pileup_correction: bool = True,
    bands: Sequence[str | int] | None = None,
    region: Region | None = None,
    skips: Skips = DEFAULT_SKIPS,
    threads: int = 1,
) -> xr.Dataset:
    """Depth and reflectance in every band from one histogram per pixel.

    Parameters
    ----------
    histogram : (row, col, code) counts, raw codes on the last axis.
    calibration : of the same instrument.
    method : ``"joint"``, maximum likelihood of delay, every band's amplitude and background
        together; ``"pooled"``, the same for few photons: neighbours lend where a pixel's own
        don't suffice; or ``"paper"``, the published correlation method.
    depth_range : nearest and farthest depth to search, m (not for ``"paper"``); default half the
        pulses' spacing about the reference's distance.
    frames : exposures behind the histogram, a number or (row, col); by default the sum over
        codes where the sensor reports its empty exposures, else as many as the reference had.
    range_correction : multiply reflectance by the squared ratio of distances.
    pileup_correction : undo the loss of later photons of an exposure, where the sensor reports
        its empty exposures or `frames` says how many there were.
    bands : names or numbers of those whose reflectance is wanted, default all. All are fitted:
        depth rests on every band's light.
    region : two slices (``np.s_[10:20, 30:40]``) or a mask (row, col): pixels outside are left
        out and flagged skipped (``"joint"`` only saves time by it).
    skips : what ``"joint"`` may leave out.
    threads : that share the pixels (not for ``"paper"``).

    Returns
    -------
    Dataset with `depth`, `depth_std` (m), `reflectance`, `reflectance_std`, `background`
    (counts per code), `photons` and `quality`; what can't be known is NaN with a flag. Method
    ``"pooled"`` adds `resolution`, the width in pixels of what an estimate rests on.

    Raises
    ------
    HistogramError
        If the histogram does not fit the calibration's instrument, or is empty.
    """
    if method not in METHODS:
        raise HistogramError(f"method = {method!r}: choose one of {', '.join(METHODS)}")
    instrument = calibration.instrument
    seen = prepare_histogram(histogram, calibration, frames)
    counts, light, exposures = seen.counts, seen.light, seen.frames
    wanted = region_mask(region, instrument.image_shape)
    numbers = band_numbers(bands, calibration)
    if method == "pooled":
        estimates = few_photons.estimate(
            counts,
            exposures,
            calibration,
            range_correction=range_correction,
            pileup_correction=pileup_correction,
            depth_range=depth_range,
            threads=threads,
        )
    elif method == "joint":
        estimates = joint.estimate(
            light,
            exposures,
            calibration,
            photons=seen.photons,
            range_correction=range_correction,
            pileup_correction=pileup_correction,
            depth_range=depth_range,
            region=wanted,
            skips=skips,
            threads=threads,
        )
    elif depth_range is not None:
        raise HueflightError(
            f"depth_range = {depth_range!r}: method {method!r} searches half the pulses' spacing "
            "only; use method='joint'"
        )
    else:
        estimates = paper.estimate(
            light,
            exposures,
            calibration,
            photons=seen.photons,
            range_correction=range_correction,
            pileup_correction=pileup_correction,
        )
    estimates.quality[seen.full] |= int(Quality.SATURATED)
    leave_out(estimates, ~wanted)
    image = as_image(estimates, calibration, method=method)
    return image if bands is None else image.isel(band=numbers)
