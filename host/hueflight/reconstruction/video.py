"""Images of one scene after another: pixels that have not changed keep what was found.

A pixel is fitted again when its counts differ from those behind its last fit by more than chance
would have it; see `changes`. Since they are compared with the last *fit*, not the last image, slow
drifts add up until they are seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.reconstruction.door import check_in
from hueflight.reconstruction.fit import Fit, no_fit
from hueflight.reconstruction.image import as_image
from hueflight.reconstruction.joint import fit_chosen, in_metres, plan_for, search_range_ns
from hueflight.reconstruction.kernels import contrasts, wide_sums
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.skips import DEFAULT_SKIPS, Skips


@dataclass
class _Kept:
    """What was last fitted of every pixel; of its counts, what changes are told by."""

    wide: NDArray[np.float32]
    photons: NDArray[np.float64]
    frames: NDArray[np.float64] | None
    fit: Fit
    fitted: NDArray[np.bool_]


class Video:
    """The joint fit of histograms in sequence, pixels that stay the same left out.

    Parameters
    ----------
    calibration : of the instrument.
    change_sigma : standard deviations by which a contrast of counts must differ from the last fit
        to be a change. At 4 a pixel of a still scene is fitted again by chance in about one image
        of a thousand; a change of depth by 8 of its deviations is seen in nearly every one. 0
        fits every pixel of every image.
    depth_range, range_correction, pileup_correction, skips, threads : as in `reconstruct`.

    Raises
    ------
    HueflightError
        If `change_sigma` is negative or not finite.
    """

    def __init__(
        self,
        calibration: Calibration,
        /,
        *,
        change_sigma: float = 4.0,
        depth_range: tuple[float, float] | None = None,
        range_correction: bool = False,
        pileup_correction: bool = True,
        skips: Skips = DEFAULT_SKIPS,
        threads: int = 1,
    ) -> None:
        if not (isfinite(change_sigma) and change_sigma >= 0):
            raise HueflightError(f"change_sigma = {change_sigma!r}: must be 0 or above")
        self.calibration = calibration
        self._change_sigma = change_sigma
        self._search_ns = search_range_ns(calibration, depth_range)
        self._plan = plan_for(calibration, self._search_ns)
        self._corrections = {
            "range_correction": range_correction,
            "pileup_correction": pileup_correction,
        }
        self._skips = skips
        self._threads = threads
        self._kept: _Kept | None = None

    def next(self, histogram: ArrayLike, /, *, frames: ArrayLike | None = None) -> xr.Dataset:
        """Image of the next histogram (row, col, code); what pixels kept is flagged skipped.

        Raises
        ------
        HistogramError
            If the histogram does not fit the instrument, or is empty.
        """
        calibration = self.calibration
        seen = check_in(histogram, calibration, frames)
        rows, cols, bins = seen.light.shape
        flat = seen.light.reshape(rows * cols, bins)
        changed = self._update(flat, seen.photons, seen.frames)
        kept = self._kept
        assert kept is not None  # the update has made it
        estimates = in_metres(
            kept.fit if kept.fitted.all() else kept.fit.take(kept.fitted.ravel()),
            kept.fitted,
            kept.photons,
            kept.frames,
            calibration,
            search_ns=self._search_ns,
            **self._corrections,
        )
        estimates.quality[calibration.usable & ~changed] |= int(Quality.SKIPPED)
        estimates.quality[seen.full] |= int(Quality.SATURATED)
        return as_image(estimates, calibration, method="joint")

    def _update(
        self,
        flat: NDArray[Any],
        photons: NDArray[np.float64],
        exposures: NDArray[np.float64] | None,
    ) -> NDArray[np.bool_]:
        """Fit what has changed; returns those pixels (row, col)."""
        usable = self.calibration.usable
        kept = self._kept
        if kept is None:
            changed = usable.copy()
            kept = self._kept = _Kept(
                wide=wide_sums(flat, np.arange(len(flat)), self._plan),
                photons=photons,
                frames=exposures,
                fit=no_fit(flat.shape[0], self._plan.bands),
                fitted=np.zeros(photons.shape, bool),
            )
        else:
            changed = usable & self._differs(flat, photons, exposures, kept)
            pixels = np.flatnonzero(changed)
            kept.wide[pixels] = wide_sums(flat, pixels, self._plan)
            kept.photons = np.where(changed, photons, kept.photons)
            if exposures is not None and kept.frames is not None:
                kept.frames = np.where(changed, exposures, kept.frames)
        chosen = changed & (photons > 0)
        found = fit_chosen(
            flat,
            chosen,
            photons,
            exposures if self._corrections["pileup_correction"] else None,
            self.calibration,
            self._plan,
            skips=self._skips,
            threads=self._threads,
        )
        kept.fitted[changed] = photons[changed] > 0
        kept.fit.put(chosen.ravel(), found)
        return changed

    def _differs(
        self,
        flat: NDArray[Any],
        photons: NDArray[np.float64],
        exposures: NDArray[np.float64] | None,
        kept: _Kept,
    ) -> NDArray[np.bool_]:
        if self._change_sigma == 0:
            return np.ones_like(kept.fitted)
        differs = ~kept.fitted & (photons > 0)
        pixels = np.flatnonzero(kept.fitted)
        scales = np.ones(pixels.size)
        if exposures is not None and kept.frames is not None:
            scales = exposures[kept.fitted] / kept.frames[kept.fitted]
        found = kept.fit if kept.fitted.all() else kept.fit.take(pixels)
        offsets_ns = self.calibration.pixel_delay_ns[kept.fitted]
        gaps = contrasts(flat, kept.wide, pixels, scales, found, offsets_ns, self._plan)
        differs[kept.fitted] = gaps > self._change_sigma
        return differs
