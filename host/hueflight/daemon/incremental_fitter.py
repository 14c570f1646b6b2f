# SPDX-License-Identifier: Apache-2.0
"""The joint fit from picture to picture, which fits again only the pixels that have changed."""

from __future__ import annotations

import math
import time
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.ingest.accumulator import Counts
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.video import Video

CHANGE_SIGMA = 4.0  #: see `hueflight.reconstruction.video.Video`
REFRESH_S = 10.0  #: within this time every pixel is fitted again: chance may have misled a kept fit
GROWTH = 1.1  #: a pixel is fitted again if its frames exceed those of the kept fit by this factor
GROWN_S = 1.0  #: within this time, for pictures in time matter more than a tenth more frames
MOST_STEPS = 7  #: of growth, with which frames have nearly doubled: a pixel is fitted at once
_GOLDEN = 0.618033988749895  #: spreads numbers evenly over 0 to 1


class IncrementalFitter:
    """The joint fit of a sequence of histograms; pixels that did not change keep their estimates.

    All pixels are fitted again within `REFRESH_S`, a few in each picture, so that no picture takes
    much longer than others.

    Parameters
    ----------
    change_sigma : float
        Standard deviations by which a pixel must have changed to be fitted again, where all pixels
        have the same frames; 0 fits every pixel of every histogram.
    threads : int
        Threads over pixels.
    """

    def __init__(self, *, change_sigma: float = CHANGE_SIGMA, threads: int = 1) -> None:
        self._change_sigma, self._threads = change_sigma, threads
        self._video: Video | None = None
        self._frames = 0
        self._steps: NDArray[np.int64] | None = None
        self._latest_s = 0.0
        self._next = 0  # pixel of which the growth is looked at first

    def fit(
        self, histogram: Counts, calibration: Calibration, frames: int | NDArray[np.int64]
    ) -> xr.Dataset:
        """Return the image of the next histogram.

        Every pixel is fitted if the calibration is a new one, or if the kept fits are of fewer
        frames. Where each pixel has frames of its own, it is fitted again within `GROWN_S` when
        they have grown by another tenth, and at once when they have doubled or begun anew; as they
        grow alike, the steps differ from pixel to pixel. Whoever gathers such counts has looked for
        changes already, so that those of other pixels are not read.

        Parameters
        ----------
        histogram : array, shape (row, col, code)
            Counts of the newest frames.
        calibration : Calibration
            Calibration of the instrument.
        frames : int or array of int, shape (row, col)
            Frames in the histogram, of all pixels alike or of each one.

        Returns
        -------
        xarray.Dataset
            Image as `hueflight.reconstruct` gives it; pixels that keep their estimates are flagged
            as skipped.
        """
        now = time.monotonic()
        video, alike = self._video, isinstance(frames, int)
        if (
            video is None
            or video.calibration is not calibration
            or alike != (self._steps is None)
            or (alike and frames > GROWTH * self._frames)
        ):
            video = Video(calibration, change_sigma=self._change_sigma, threads=self._threads)
            self._video, self._frames = video, int(np.max(frames))
            self._steps = None if alike else np.zeros(calibration.usable.shape, np.int64)
        due = self._due(calibration.usable.shape, now)
        known = None if alike or calibration.instrument.sensor.reports_empty else frames
        if self._steps is None:
            image = video.next(histogram, frames=known, due=due)
        else:
            steps = growth_steps(np.asarray(frames))
            due |= self._grown(steps - self._steps, now)
            image = video.next(histogram, frames=known, changed=due)
            fitted = image["quality"].values & int(Quality.SKIPPED) == 0
            self._steps[fitted] = steps[fitted]
        self._latest_s = now
        return image

    def _grown(self, steps: NDArray[np.int64], now: float) -> NDArray[np.bool_]:
        """Pixels that are fitted again as their frames have grown by so many steps since."""
        due = (steps < 0) | (steps >= MOST_STEPS)
        waiting = np.flatnonzero((steps > 0) & ~due)
        most = int(due.size * min(1.0, (now - self._latest_s) / GROWN_S))
        # from the pixel on at which the last picture ended, so that each one has its turn
        chosen = np.roll(waiting, -int(np.searchsorted(waiting, self._next)))[:most]
        due.flat[chosen] = True
        if chosen.size:
            self._next = int(chosen[-1]) + 1
        return due

    def _due(self, shape: tuple[int, ...], now: float) -> NDArray[np.bool_]:
        """Pixels whose turn to be fitted again has come since the latest picture."""
        due = np.zeros(shape, bool)
        per_s = due.size / REFRESH_S
        first, stop = int(per_s * self._latest_s), int(per_s * now)
        due.flat[np.arange(first, min(stop, first + due.size)) % due.size] = True
        return due


def growth_steps(frames: NDArray[np.int64], /) -> NDArray[np.int64]:
    """Return how often the frames of each pixel have grown by `GROWTH`.

    Parameters
    ----------
    frames : array of int, shape (row, col)
        Frames of each pixel.

    Returns
    -------
    array of int, shape (row, col)
        Steps, which are 1 or more. The places of the steps are spread over the pixels, so that of
        pixels which have the same frames only some take a step at a time.
    """
    grown = np.log(np.maximum(frames, 1))
    grown /= np.log(GROWTH)
    grown += _phases(frames.shape)
    steps = grown.astype(np.int64)  # rounds down: nothing is below 0
    steps += 1
    return steps


@lru_cache(4)
def _phases(shape: tuple[int, ...]) -> NDArray[np.floating]:
    """Where each pixel's steps lie, from 0 to 1."""
    places = np.arange(1, math.prod(shape) + 1)
    return (places * _GOLDEN % 1).reshape(shape)
