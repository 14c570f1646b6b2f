# SPDX-License-Identifier: Apache-2.0
"""One live picture: the histogram of the newest frames, the image made of it, and its times."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.ingest.accumulator import Counts
from hueflight.model.instrument import Instrument

NO_HISTOGRAM = np.empty(0, np.uint16)  #: where only the image is known


@dataclass(frozen=True, eq=False)
class Picture:
    """Data that viewers see at one moment.

    Attributes
    ----------
    number : int
        Number of the picture, counted from 1 since the daemon started.
    kind : str
        Kind of capture, such as ``"scene"`` or ``"reference"``.
    histogram : array, shape (row, col, code)
        Counts of the frames; empty if the camera sent sums. The memory is reused once nothing
        refers to this array any more; a view of it does not keep it.
    image : xarray.Dataset or None
        Reconstruction of the histogram; None without a calibration.
    photons : array, shape (row, col)
        Photons of each pixel.
    frames : int
        Frames in the histogram; of the pixel that has most.
    frames_by_pixel : array of int, shape (row, col)
        Frames behind each pixel.
    device_s : float
        Device clock at the start of the last exposure, in seconds.
    received_s : float
        Monotonic clock when the last photon had arrived, in seconds.
    begun_s : float
        Monotonic clock when reconstruction began, in seconds.
    ready_s : float
        Monotonic clock when reconstruction was done, in seconds.
    """

    number: int
    kind: str
    histogram: Counts
    image: xr.Dataset | None
    photons: NDArray[np.integer]
    frames: int
    frames_by_pixel: NDArray[np.integer]
    device_s: float
    received_s: float
    begun_s: float
    ready_s: float

    @cached_property
    def spread_of_frames(self) -> dict[str, int]:
        """Frames behind the pixels: of the fewest, of half of them, and the most."""
        frames = self.frames_by_pixel
        return {
            "least": int(frames.min()),
            "median": int(np.median(frames)),
            "most": self.frames,
        }

    def received_unix_s(self) -> float:
        """Return the time at which the last photon had arrived, in seconds since 1970."""
        return time.time() - (time.monotonic() - self.received_s)

    def without_histogram(self) -> Picture:
        """Return the same picture without the histogram, whose memory can then be reused."""
        return replace(self, histogram=NO_HISTOGRAM)

    def exact(self) -> xr.Dataset:
        """Return the image, or a dataset with only ``photons`` if there is none."""
        if self.image is not None:
            return self.image
        attributes = {"units": "count", "long_name": "photons in the pixel's histogram"}
        return xr.Dataset({"photons": (("row", "col"), self.photons.astype(np.uint32), attributes)})


def count_photons(
    histogram: Counts,
    image: xr.Dataset | None,
    instrument: Instrument,
    frames: int | NDArray[np.integer],
    /,
) -> NDArray[np.integer]:
    """Return the photons of each pixel.

    Parameters
    ----------
    histogram : array, shape (row, col, code)
        Counts of the frames.
    image : xarray.Dataset or None
        Reconstruction of the histogram, which has the photons already.
    instrument : Instrument
        Instrument that the histogram is of.
    frames : int or array of int, shape (row, col)
        Frames in the histogram.

    Returns
    -------
    array of int, shape (row, col)
        Photons of each pixel.
    """
    if image is not None:
        return image["photons"].values.astype(np.int64)
    if instrument.sensor.reports_empty:
        return frames - histogram[..., 0].astype(np.int64)
    return histogram.sum(axis=-1, dtype=np.int64)
