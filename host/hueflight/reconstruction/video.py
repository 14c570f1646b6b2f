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
from hueflight.fit.change_detection import ChangeReference, no_reference
from hueflight.fit.solver import Survey, change_reference, survey_changes
from hueflight.fit.tables import ModelTables
from hueflight.reconstruction.conversion import put_results
from hueflight.reconstruction.conversion_rules import Conversion
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.image import as_image, like_image
from hueflight.reconstruction.inputs import (
    PreparedHistogram,
    assumed_exposures,
    prepare_histogram,
    prepare_pixels,
)
from hueflight.reconstruction.joint import (
    fit_chosen,
    search_range_ns,
    tables_for_calibration,
)
from hueflight.reconstruction.options import DEFAULT_SKIPS, Skips
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import resolve
from hueflight.reconstruction.result_planes import ResultPlanes, empty_planes


@dataclass
class _Kept:
    """Of every pixel what was found when it was last fitted, and what changes are told by."""

    planes: ResultPlanes
    frames: NDArray[np.float64] | None
    fitted: NDArray[np.bool_]
    reference: ChangeReference


@dataclass
class _Watch:
    """Tells which pixels of a histogram differ from their last fit, while its counts are read."""

    kept: _Kept
    calibration: Calibration
    frames: ArrayLike | None
    tables: ModelTables
    gaps: NDArray[np.floating] | None = None

    def look(self, counts: NDArray[Any], lit: slice) -> Survey:
        """What `survey` finds in counts (pixel, code)."""
        exposures = None  # the counts of all codes
        if self.frames is not None or not self.calibration.instrument.sensor.reports_empty:
            exposures = assumed_exposures(counts, self.calibration, self.frames)
        codes = self.calibration.bins.codes
        backwards = bool(codes[-1] < codes[0])
        found, self.gaps = self._compare(counts, lit, exposures, backwards=backwards)
        return found

    def differs(self, seen: PreparedHistogram, most: float) -> NDArray[np.bool_]:
        """Pixels (row, col) whose difference exceeds so many standard deviations."""
        gaps = self.gaps
        if gaps is None:  # only whole numbers are looked at
            light = seen.light.reshape(-1, seen.light.shape[-1])
            _, gaps = self._compare(light, slice(None), seen.exposures, backwards=False)
        apart = (gaps > most).reshape(seen.photons.shape)
        return np.where(self.kept.fitted, apart, seen.photons > 0)

    def _compare(
        self,
        counts: NDArray[Any],
        lit: slice,
        exposures: NDArray[np.float64] | None,
        *,
        backwards: bool,
    ) -> tuple[Survey, NDArray[np.floating]]:
        earlier = self.kept.frames
        if exposures is None and not self.calibration.instrument.sensor.reports_empty:
            earlier = None
        return survey_changes(
            counts,
            lit,
            self.kept.reference,
            self.tables,
            backwards=backwards,
            exposures=None if exposures is None else np.ascontiguousarray(exposures).reshape(-1),
            earlier=None if earlier is None else earlier.reshape(-1),
        )


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
        self._conversion = Conversion(
            calibration, self._search_ns, resolve(range_correction, calibration), pileup_correction
        )
        self._assessed = skips.of_fit(calibration).assessment
        self._skips = skips
        self._threads = threads
        self._kept: _Kept | None = None
        self._seen: PreparedHistogram | None = None  # without its counts
        self._labels: dict[bool, xr.Dataset] = {}  # by whether exposures are known

    def next(
        self,
        histogram: ArrayLike,
        /,
        *,
        frames: ArrayLike | None = None,
        due: NDArray[np.bool_] | None = None,
        changed: NDArray[np.bool_] | None = None,
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
        changed : ndarray of bool, shape (row, col), optional
            Pixels that have changed, if that is known. The counts of pixels that are neither due
            nor here are not read then, and no change of theirs is noticed.

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
        told = False
        if changed is not None and self._seen is not None and self._change_sigma > 0:
            told = True
            chosen = changed.copy() if due is None else changed | due
            seen = prepare_pixels(histogram, calibration, frames, self._seen, chosen)
        else:
            seen, chosen = self._compared(histogram, frames)
            if due is not None:
                chosen |= due
        self._seen = replace(seen, counts=None, light=None)  # the counts belong to the caller
        chosen &= calibration.usable
        flat = seen.light.reshape(-1, seen.light.shape[-1])
        kept = self._kept = self._fitted(flat, seen.photons, seen.exposures, chosen, told=told)
        planes = kept.planes.copy()
        planes.quality[calibration.usable & ~chosen] |= int(Quality.SKIPPED)
        planes.quality[seen.full] |= int(Quality.SATURATED)
        exposures_known = frames is not None or calibration.instrument.sensor.reports_empty
        return self._labeled(planes.estimates(assessed=self._assessed), exposures_known)

    def _labeled(self, estimates: Estimates, exposures_known: bool) -> xr.Dataset:
        """Estimates as an image; the labels of the first one serve all others."""
        labels = self._labels.get(exposures_known)
        if labels is not None:
            return like_image(labels, estimates)
        image = as_image(
            estimates,
            self.calibration,
            method="joint",
            range_correction=self._conversion.range_correction,
            exposures_known=exposures_known,
        )
        self._labels[exposures_known] = image.copy()
        return image

    def _compared(
        self, histogram: ArrayLike, frames: ArrayLike | None
    ) -> tuple[PreparedHistogram, NDArray[np.bool_]]:
        """A histogram, and its pixels (row, col) that differ from their last fit."""
        if self._kept is None or self._change_sigma == 0:
            seen = prepare_histogram(histogram, self.calibration, frames)
            return seen, np.ones(seen.photons.shape, bool)
        watch = _Watch(self._kept, self.calibration, frames, self._tables)
        seen = prepare_histogram(histogram, self.calibration, frames, look=watch.look)
        return seen, watch.differs(seen, self._change_sigma)

    def _fitted(
        self,
        flat: NDArray[Any],
        photons: NDArray[np.float64],
        exposures: NDArray[np.float64] | None,
        changed: NDArray[np.bool_],
        *,
        told: bool,
    ) -> _Kept:
        """What is kept, pixels (row, col) that have changed fitted again.

        Where changes are `told` by the caller, nothing is kept to compare later counts with.
        """
        calibration, tables, kept = self.calibration, self._tables, self._kept
        chosen = changed & (photons > 0)
        found = fit_chosen(
            flat,
            chosen,
            photons,
            exposures if self._conversion.pileup_correction else None,
            calibration,
            tables,
            skips=self._skips,
            threads=self._threads,
        )
        if kept is None or self._change_sigma == 0:
            kept = _nothing_kept(photons.shape, exposures, tables)
            changed = np.ones(photons.shape, bool)  # pixels that are not usable have flags, too
        put_results(kept.planes, found, changed, chosen, photons, exposures, self._conversion)
        if self._change_sigma == 0:
            return kept
        if told:
            kept.fitted[changed] = False  # nothing to compare later counts with
            return kept
        pixels, offsets_ns = np.flatnonzero(chosen), calibration.pixel_delay_ns[chosen]
        kept.reference.put(pixels, change_reference(flat, pixels, found, offsets_ns, tables))
        kept.fitted[changed] = chosen[changed]
        if exposures is not None and kept.frames is not None:
            kept.frames[changed] = exposures[changed]
        return kept


def _nothing_kept(
    shape: tuple[int, ...], exposures: NDArray[np.float64] | None, tables: ModelTables
) -> _Kept:
    return _Kept(
        planes=empty_planes(shape, tables.bands),
        frames=None if exposures is None else np.array(exposures),
        fitted=np.zeros(shape, bool),
        reference=no_reference(int(np.prod(shape)), tables),
    )
