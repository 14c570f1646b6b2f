# SPDX-License-Identifier: Apache-2.0
"""Pixels of a picture that are fitted to check it: trusted ones, evenly spaced."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError
from hueflight.fit.tables import ModelTables
from hueflight.fit.tiles import summed
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.model.pileup import coates_correction, photons_per_period
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.joint import fit_chosen, search_range_ns, tables_for_calibration
from hueflight.reconstruction.options import Skips
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.shared_scores import FittedPixels, SharedModel

MOST_PIXELS = 8192  #: pixels that are fitted, evenly spaced
FEWEST_PIXELS = 30  #: pixels below which nothing is concluded
COMMON_MISFIT = 0.2  #: share of misfits from which the calibration is suspected, not the scene
TAILS_NS = (3.0, 15.0)  #: mean delays of exponential tails
DECAYS_NS = (20.0, 30.0, 40.0, 50.0, 65.0, 80.0, 120.0)  #: time constants of a decaying background
FLARES_NS = (0.0, 2.0, 4.0, 8.0)  #: delays of lens flare after the mean arrival

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampledPixels:
    """Fitted pixels of a picture.

    Attributes
    ----------
    fitted : FittedPixels
        Pixels at the bins of the scores.
    sums : ndarray of float, shape (bin,)
        Counts of all these pixels together at the bins of the fit.
    model : SharedModel
        Model and directions.
    fine_edges_ns : ndarray of float, shape (bin + 1,)
        Edges of the bins of the fit, ns.
    """

    fitted: FittedPixels
    sums: _Floats
    model: SharedModel
    fine_edges_ns: _Floats


def trusted_pixels(image: xr.Dataset) -> NDArray[np.bool_]:
    """Return the pixels of an image that the check may use.

    Parameters
    ----------
    image : Dataset
        The image.

    Returns
    -------
    ndarray of bool, shape (row, col)
        Unflagged pixels with a depth. Where many are misfits, these count as well, because then
        the calibration is suspected, not the scene.
    """
    planes = image.transpose("row", "col", ...)
    return trusted(planes["depth"].values, planes["quality"].values)


def background_of(image: xr.Dataset) -> BackgroundShape:
    """Return the shape of the background that an image was made with.

    Parameters
    ----------
    image : Dataset
        The image.

    Returns
    -------
    BackgroundShape
        The shape that it states; flat where it states none.
    """
    stated = image["background"].attrs
    if "shape" not in stated:
        return FLAT
    return BackgroundShape(**{field.name: float(stated[field.name]) for field in fields(FLAT)})


def state_background(image: xr.Dataset, shape: BackgroundShape) -> None:
    """Let an image state the shape of the background that it was made with.

    Parameters
    ----------
    image : Dataset
        The image, whose attributes are changed; a flat background is not stated.
    shape : BackgroundShape
        The shape.
    """
    if shape != FLAT:
        image["background"].attrs |= {"shape": str(shape), **asdict(shape)}


def trusted(depth: NDArray[np.floating], quality: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Return the pixels that the check may use; see `trusted_pixels`.

    Parameters
    ----------
    depth : ndarray of float, shape (row, col)
        Depth, m.
    quality : ndarray of uint16, shape (row, col)
        Flags.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True for these pixels.
    """
    misfit_only = (quality == 0) | (quality == int(Quality.MISFIT))
    known = np.isfinite(depth) & misfit_only
    misfit = known & (quality != 0)
    return known if misfit.sum() > COMMON_MISFIT * known.sum() else known & ~misfit


def sample_pixels(
    prepared: PreparedHistogram,
    calibration: Calibration,
    trusted: NDArray[np.bool_],
    *,
    depth_range: tuple[float, float] | None = None,
    pileup_correction: bool = True,
    background: BackgroundShape = FLAT,
    pixels: int = MOST_PIXELS,
    threads: int = 1,
) -> SampledPixels:
    """Fit some pixels, evenly spaced over those that are trusted.

    Parameters
    ----------
    prepared : PreparedHistogram
        The histogram.
    calibration : Calibration
        Calibration of the same instrument.
    trusted : ndarray of bool, shape (row, col)
        Pixels to choose from.
    depth_range : tuple of float, optional
        Nearest and farthest depth to search, m.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    background : BackgroundShape
        Shape of the background.
    pixels : int
        Largest number of pixels.
    threads : int
        Threads that share the pixels.

    Returns
    -------
    SampledPixels
        Their fits.

    Raises
    ------
    HistogramError
        If too few pixels are trusted.
    HueflightError
        If the bins are too wide for the pulses.
    """
    numbers = np.flatnonzero(trusted & calibration.usable & (prepared.photons > 0))
    if numbers.size < FEWEST_PIXELS:
        raise HistogramError(
            f"only {numbers.size} pixels are without a flag: a check of the whole picture needs "
            f"{FEWEST_PIXELS}"
        )
    numbers = numbers[:: -(-numbers.size // pixels)]
    chosen = np.zeros(trusted.shape, bool)
    chosen.flat[numbers] = True
    search_ns = search_range_ns(calibration, depth_range)
    tables = tables_for_calibration(calibration, search_ns, background)
    if not tables.resolved:
        raise HueflightError(
            "the bins are too wide for the pulses: counts are smoothed before they are fitted, so "
            "that their residuals do not tell what is off"
        )
    exposures = prepared.exposures if pileup_correction else None
    light = prepared.light.reshape(-1, prepared.light.shape[-1])
    found = fit_chosen(
        light,
        chosen,
        prepared.photons,
        exposures,
        calibration,
        tables,
        skips=Skips(assessment=False),
        threads=threads,
    )
    rates = None
    if exposures is not None:
        rates = photons_per_period(
            prepared.photons[chosen], exposures[chosen], calibration.instrument
        )
    counts = np.asarray(coates_correction(light[numbers], rates), np.float64)
    fine, wide, edges = _grouping(tables, calibration.bins.edges_ns)
    fine_counts = summed(counts, fine)
    offsets = calibration.pixel_delay_ns[chosen]
    fitted = FittedPixels(
        counts=summed(fine_counts, wide),
        arrival_ns=found.delay_ns + offsets,
        offset_ns=offsets,
        amplitudes=np.maximum(found.amplitudes, 0.0),
        background=np.maximum(found.background, 0.0),
    )
    model = SharedModel(
        edges_ns=edges[np.append(wide, -1)],
        templates=calibration.templates,
        background=background,
        step_ns=tables.fine.phase_ns,
        tails_ns=TAILS_NS,
        decays_ns=(background.decay_ns,) if background.decay_share else DECAYS_NS,
        flares_ns=FLARES_NS,
    )
    return SampledPixels(fitted, fine_counts.sum(axis=0), model, edges)


def _grouping(
    tables: ModelTables, edges_ns: _Floats
) -> tuple[NDArray[np.intp], NDArray[np.intp], _Floats]:
    """First sensor bin of each fine bin, first fine bin of each wide one, edges of fine bins."""
    fine = tables.fine.starts
    edges = edges_ns[np.append(fine, -1)]
    same = tables.wide is tables.fine
    return fine, np.arange(fine.size) if same else tables.wide.starts, edges
