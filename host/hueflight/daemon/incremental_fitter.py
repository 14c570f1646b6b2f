# SPDX-License-Identifier: Apache-2.0
"""The joint fit from picture to picture, which fits again only the pixels that have changed."""

from __future__ import annotations

import time

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.ingest.accumulator import Counts
from hueflight.reconstruction.video import Video

CHANGE_SIGMA = 4.0  #: see `hueflight.reconstruction.video.Video`
REFRESH_S = 10.0  #: within this time every pixel is fitted again: chance may have misled a kept fit
GROWTH = 1.1  #: all pixels are fitted again if frames exceed those of the kept fits by this factor


class IncrementalFitter:
    """The joint fit of a sequence of histograms; pixels that did not change keep their estimates.

    All pixels are fitted again within `REFRESH_S`, a few in each picture, so that no picture takes
    much longer than others.

    Parameters
    ----------
    change_sigma : float
        Standard deviations by which a pixel must have changed to be fitted again; 0 fits every
        pixel of every histogram.
    threads : int
        Threads over pixels.
    """

    def __init__(self, *, change_sigma: float = CHANGE_SIGMA, threads: int = 1) -> None:
        self._change_sigma, self._threads = change_sigma, threads
        self._video: Video | None = None
        self._frames = 0
        self._latest_s = 0.0

    def fit(self, histogram: Counts, calibration: Calibration, frames: int) -> xr.Dataset:
        """Return the image of the next histogram.

        Every pixel is fitted if the calibration is a new one, or if the kept fits are of fewer
        frames.

        Parameters
        ----------
        histogram : array, shape (row, col, code)
            Counts of the newest frames.
        calibration : Calibration
            Calibration of the instrument.
        frames : int
            Frames in the histogram.

        Returns
        -------
        xarray.Dataset
            Image as `hueflight.reconstruct` gives it; pixels that keep their estimates are flagged
            as skipped.
        """
        now = time.monotonic()
        video = self._video
        if video is None or video.calibration is not calibration or frames > GROWTH * self._frames:
            video = Video(calibration, change_sigma=self._change_sigma, threads=self._threads)
            self._video, self._frames = video, frames
        due = self._due(calibration.usable.shape, now)
        self._latest_s = now
        return video.next(histogram, due=due)

    def _due(self, shape: tuple[int, ...], now: float) -> NDArray[np.bool_]:
        """Pixels whose turn to be fitted again has come since the latest picture."""
        due = np.zeros(shape, bool)
        per_s = due.size / REFRESH_S
        first, stop = int(per_s * self._latest_s), int(per_s * now)
        due.flat[np.arange(first, min(stop, first + due.size)) % due.size] = True
        return due
