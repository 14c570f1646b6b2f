# SPDX-License-Identifier: Apache-2.0
"""Images of successive histograms: pixels that have not changed keep their result.

A pixel is fitted again when its counts differ from those behind its last fit by more than chance
explains; see `hueflight.fit.change_detection`. Because they are compared with the last *fit*, not
the last image, slow drifts add up until they are noticed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.fit.solver import change_reference, change_significance
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.image import as_image
from hueflight.reconstruction.inputs import prepare_histogram
from hueflight.reconstruction.joint import (
    fit_chosen,
    in_metres,
    search_range_ns,
    tables_for_calibration,
)
from hueflight.reconstruction.options import DEFAULT_SKIPS, Skips
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import resolve


@dataclass
class _Kept:
    """Of every pixel what was found when it was last fitted, and what changes are told by."""

    estimates: Estimates
    frames: NDArray[np.float64] | None
    fitted: NDArray[np.bool_]
    delays_ns: NDArray[np.float64]
    memory: NDArray[np.float32]


class Video:
    """The joint fit of successive histograms, without the pixels that stay the same.

    Parameters
    ----------
    calibration : Calibration
        Calibration of the instrument.
    change_sigma : float
        Standard deviations by which counts must differ from the last fit to be a change. At 4, a
        pixel of a still scene is fitted again by chance in about one image of a thousand, and a
        change of depth by 8 of its standard deviations is noticed in nearly every one. 0 fits every
        pixel of every image.
    depth_range : tuple of float, optional
        Nearest and farthest depth to search, m; see `reconstruct`.
    range_correction : bool, optional
        Correct reflectance for the distance; see `reconstruct`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    skips : Skips
        What the fit may leave out.
    threads : int
        Threads that share the pixels.

    Raises
    ------
    HueflightError
        If `change_sigma` is negative or not finite, or range correction is asked for and the
        distance of the reference is not known.
    """

    def __init__(
        self,
        calibration: Calibration,
        /,
        *,
        change_sigma: float = 4.0,
        depth_range: tuple[float, float] | None = None,
        range_correction: bool | None = None,
        pileup_correction: bool = True,
        skips: Skips = DEFAULT_SKIPS,
        threads: int = 1,
    ) -> None:
        if not (isfinite(change_sigma) and change_sigma >= 0):
            raise HueflightError(f"change_sigma = {change_sigma!r}: must be 0 or above")
        self.calibration = calibration
        self._change_sigma = change_sigma
        self._search_ns = search_range_ns(calibration, depth_range)
        self._tables = tables_for_calibration(calibration, self._search_ns)
        self._corrections = {
            "range_correction": resolve(range_correction, calibration),
            "pileup_correction": pileup_correction,
        }
        self._skips = skips
        self._threads = threads
        self._kept: _Kept | None = None

    def next(
        self,
        histogram: ArrayLike,
        /,
        *,
        frames: ArrayLike | None = None,
        due: NDArray[np.bool_] | None = None,
    ) -> xr.Dataset:
        """Return the image of the next histogram; kept pixels are flagged skipped.

        Parameters
        ----------
        histogram : array_like, shape (row, col, code)
            Counts, raw codes on the last axis.
        frames : array_like, shape (row, col), or float, optional
            Exposures behind the histogram; see `reconstruct`.
        due : ndarray of bool, shape (row, col), optional
            Pixels that are fitted again whether they have changed or not.

        Returns
        -------
        Dataset
            Image as `reconstruct` gives it.

        Raises
        ------
        HistogramError
            If the histogram does not fit the instrument, or is empty.
        """
        calibration = self.calibration
        seen = prepare_histogram(histogram, calibration, frames)
        flat = seen.light.reshape(-1, seen.light.shape[-1])
        changed = self._differs(flat, seen.photons, seen.exposures)
        if due is not None:
            changed |= due
        changed &= calibration.usable
        kept = self._kept = self._fitted(flat, seen.photons, seen.exposures, changed)
        quality = kept.estimates.quality.copy()
        quality[calibration.usable & ~changed] |= int(Quality.SKIPPED)
        quality[seen.full] |= int(Quality.SATURATED)
        return as_image(
            replace(kept.estimates, quality=quality),
            calibration,
            method="joint",
            range_correction=self._corrections["range_correction"],
        )

    def _fitted(
        self,
        flat: NDArray[Any],
        photons: NDArray[np.float64],
        exposures: NDArray[np.float64] | None,
        changed: NDArray[np.bool_],
    ) -> _Kept:
        """What is kept, pixels (row, col) that have changed fitted again."""
        calibration, tables, kept = self.calibration, self._tables, self._kept
        chosen = changed & (photons > 0)
        found = fit_chosen(
            flat,
            chosen,
            photons,
            exposures if self._corrections["pileup_correction"] else None,
            calibration,
            tables,
            skips=self._skips,
            threads=self._threads,
        )
        estimates = in_metres(
            found,
            chosen,
            photons,
            exposures,
            calibration,
            search_ns=self._search_ns,
            assessed=self._skips.of_fit(calibration).assessment,
            **self._corrections,
        )
        if self._change_sigma == 0:
            return _Kept(estimates, None, chosen, found.delay_ns, np.empty(0, np.float32))
        pixels, offsets_ns = np.flatnonzero(chosen), calibration.pixel_delay_ns[chosen]
        memory = change_reference(flat, pixels, found, offsets_ns, tables)
        if kept is None:
            frames = None if exposures is None else np.array(exposures)
            everywhere = np.zeros((photons.size, *memory.shape[1:]), np.float32)
            kept = _Kept(estimates, frames, chosen, np.zeros(photons.size), everywhere)
        else:
            _take_over(kept.estimates, estimates, changed)
            kept.fitted[changed] = chosen[changed]
            if exposures is not None and kept.frames is not None:
                kept.frames[changed] = exposures[changed]
        kept.delays_ns[pixels] = found.delay_ns + offsets_ns
        kept.memory[pixels] = memory
        return kept

    def _differs(
        self,
        flat: NDArray[Any],
        photons: NDArray[np.float64],
        exposures: NDArray[np.float64] | None,
    ) -> NDArray[np.bool_]:
        """Pixels (row, col) whose counts are no longer those of their fit."""
        kept = self._kept
        if kept is None or self._change_sigma == 0:
            return np.ones(photons.shape, bool)
        differs = ~kept.fitted & (photons > 0)
        pixels = np.flatnonzero(kept.fitted)
        scales = np.ones(pixels.size)
        if exposures is not None and kept.frames is not None:
            scales = exposures[kept.fitted] / kept.frames[kept.fitted]
        delays_ns = kept.delays_ns[pixels]
        gaps = change_significance(flat, kept.memory, pixels, scales, delays_ns, self._tables)
        differs[kept.fitted] = gaps > self._change_sigma
        return differs


def _take_over(kept: Estimates, found: Estimates, changed: NDArray[np.bool_]) -> None:
    """Estimates of pixels (row, col) that have changed, in place of those that were kept."""
    rows, cols = np.nonzero(changed)  # a mask would be searched once for every band
    for name in Estimates.__dataclass_fields__:
        old, new = getattr(kept, name), getattr(found, name)
        if old is not None and new is not None:
            old[..., rows, cols] = new[..., rows, cols]
