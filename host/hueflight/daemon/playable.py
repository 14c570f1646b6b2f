# SPDX-License-Identifier: Apache-2.0
"""What can be played: recordings, counts and images, each as a sequence of photons or of images."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import HueflightError
from hueflight.files.image_schema import SERIES_DIM, captures, instrument_of
from hueflight.importers import read_image
from hueflight.importers.captures import read_capture
from hueflight.importers.images import is_image
from hueflight.ingest.accumulator import Counts
from hueflight.model.instrument import Instrument
from hueflight.recording import (
    RecordedSums,
    Recording,
    SumsReader,
    SumsTotal,
    holds_recorded_sums,
    open_recording,
)

MOST_FRAMES = 200_000  #: that are counted for one picture
MOST_PICTURES = 500  #: of sums that are added up for one picture
NEEDED = ("depth_std", "reflectance_std", "photons")  #: of an image, besides what every image has
_NOTHING = np.empty(0, np.uint16)


class PlaybackError(HueflightError):
    """A file that can't be played, or not in the way that was asked for."""


@dataclass(frozen=True)
class Piece:
    """Part of a file from which one picture is made.

    Attributes
    ----------
    histogram : array, shape (row, col, code)
        Counts; empty for an image.
    image : xarray.Dataset or None
        The image, if it need not be reconstructed.
    frames : int or array of int, shape (row, col)
        Frames in the histogram.
    unix_s : float
        Time of its end, in seconds since 1970; 0 where it is not known.
    sums : RecordedSums or None
        Sums instead of counts.
    """

    histogram: Counts
    image: xr.Dataset | None
    frames: int | NDArray[np.int64]
    unix_s: float = 0.0
    sums: RecordedSums | None = None


class Playable(Protocol):
    """A file that is open to be played.

    Attributes
    ----------
    kind : str
        ``"recording"``, ``"counts"`` or ``"image"``.
    capture : str
        Kind of capture, such as ``"scene"``.
    instrument : Instrument
        Instrument that made it.
    length : int
        Number of frames of a recording, otherwise of pictures.
    unit : str
        What is counted: ``"frames"`` or, in recordings of sums and all else, ``"pictures"``.
    seconds : float or None
        Time from the first frame or picture of a recording to the last; None for anything else.
    simulated : bool
        True if its photons are simulated.
    calibration : str
        Name of the calibration that a recording was made with; empty if it names none.
    """

    kind: str
    capture: str
    instrument: Instrument
    length: int
    unit: str
    seconds: float | None
    simulated: bool
    calibration: str

    def piece(self, start: int, stop: int, /) -> Piece:
        """Return the frames or the picture from `start` to before `stop`.

        Raises
        ------
        HueflightError
            If there are no such frames, or the file can't be read.
        """
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class PlayedRecording:
    """A recording, whose frames are counted as they are asked for.

    Where a piece begins with the one before, only the frames that are new are counted.

    Parameters
    ----------
    recording : Recording
        The open recording.
    """

    kind, unit = "recording", "frames"

    def __init__(self, recording: Recording, /) -> None:
        self._recording = recording
        info, notes = recording.info(), recording.metadata
        self.capture, self.calibration = notes.get("capture", "scene"), notes.get("calibration", "")
        self.simulated = notes.get("simulated", "").lower() == "true"
        self.instrument = recording.instrument
        self.length, self.seconds = info.frames, info.seconds
        self._began_s = datetime.fromisoformat(info.started).timestamp()
        self._start = self._stop = 0
        self._sum: NDArray[np.uint32] | None = None

    def piece(self, start: int, stop: int, /) -> Piece:
        """Return the sum of the frames from `start` to before `stop`."""
        if not 0 <= start < stop <= self.length:
            raise PlaybackError(
                f"frames {start} to {stop}: the recording has frames 0 to {self.length}"
            )
        goes_on = self._sum is not None and self._start == start and self._stop <= stop
        first = self._stop if goes_on else start
        if stop - first > MOST_FRAMES:
            raise PlaybackError(
                f"{stop - first:,} frames would have to be counted for this picture, and at most "
                f"{MOST_FRAMES:,} are: take fewer frames together"
            )
        counts = self._recording.histogram(first, stop)
        total = counts.astype(np.uint32)
        if goes_on and self._sum is not None:
            total += self._sum
        self._start, self._stop, self._sum = start, stop, total
        share = stop / self.length
        return Piece(total, None, stop - start, self._began_s + share * (self.seconds or 0.0))

    def close(self) -> None:
        """Close the recording."""
        self._recording.close()


class PlayedSums:
    """A recording of sums, whose pictures are added up as they are asked for.

    Where a piece begins with the one before, only the pictures that are new are added.

    Parameters
    ----------
    recording : Recording
        The open recording.
    """

    kind, unit = "recording", "pictures"

    def __init__(self, recording: Recording, /) -> None:
        self._recording, self._reader = recording, SumsReader(recording)
        info, notes = recording.info(), recording.metadata
        self.capture, self.calibration = notes.get("capture", "scene"), notes.get("calibration", "")
        self.simulated = notes.get("simulated", "").lower() == "true"
        self.instrument = recording.instrument
        self.length: int = self._reader.pictures
        self.seconds: float | None = self._reader.seconds
        self._began_s = datetime.fromisoformat(info.started).timestamp()
        self._start = self._stop = 0
        self._total: SumsTotal | None = None

    def piece(self, start: int, stop: int, /) -> Piece:
        """Return the sum of the pictures from `start` to before `stop`."""
        if not 0 <= start < stop <= self.length:
            raise PlaybackError(
                f"pictures {start} to {stop}: the recording has pictures 0 to {self.length}"
            )
        total = self._total
        if total is None or self._start != start or self._stop > stop:
            total = SumsTotal(self._reader.description, where=str(self._recording.path))
            self._stop = start
        self._total = None  # until all are added, after which it may go on
        if stop - self._stop > MOST_PICTURES:
            raise PlaybackError(
                f"{stop - self._stop:,} pictures would have to be added for this picture, and at "
                f"most {MOST_PICTURES:,} are: take fewer pictures together"
            )
        self._reader.add_to(total, self._stop, stop)
        self._start, self._stop, self._total = start, stop, total
        sums = total.finish()
        share = stop / self.length
        ended_s = self._began_s + share * (self.seconds or 0.0)
        return Piece(_NOTHING, None, sums.frames, ended_s, sums)

    def close(self) -> None:
        """Close the recording."""
        self._recording.close()


class PlayedCounts:
    """Counts of any camera, which are one picture.

    Parameters
    ----------
    path : Path
        File of counts.
    instrument : Instrument
        Instrument that made them where the file does not say so.
    """

    kind, capture, length, unit = "counts", "scene", 1, "pictures"
    seconds: float | None = None
    simulated, calibration = False, ""

    def __init__(self, path: Path, instrument: Instrument, /) -> None:
        try:
            found = read_capture(path)
        except HueflightError:  # the file does not describe its instrument
            found = read_capture(path, instrument)
        self.instrument = found.instrument
        self._counts = found.counts

    def piece(self, start: int, stop: int, /) -> Piece:
        """Return all counts."""
        _check_picture(start, stop, self.length)
        reports_empty = self.instrument.sensor.reports_empty
        frames = self._counts.sum(axis=-1, dtype=np.int64)
        return Piece(self._counts, None, frames if reports_empty else int(frames.max(initial=0)))

    def close(self) -> None:
        """Do nothing: the counts are in memory."""


class PlayedImages:
    """An image or a series of images.

    Parameters
    ----------
    path : Path
        Zarr store or NetCDF file.
    """

    kind, capture, simulated, calibration = "image", "scene", False, ""
    unit = "pictures"
    seconds: float | None = None

    def __init__(self, path: Path, /) -> None:
        image = read_image(path)
        self.instrument = instrument_of(image)
        missing = [name for name in NEEDED if name not in image]
        if missing:
            raise PlaybackError(f"the image lacks {', '.join(missing)}, which the page shows")
        ordered = image.transpose(..., "row", "col", "band")
        self._images = captures(ordered)
        self.length = len(self._images)
        if ordered.sizes["band"] != len(self.instrument.bands):
            raise PlaybackError(
                f"the image has {ordered.sizes['band']} of {len(self.instrument.bands)} bands: the "
                "page needs all of them"
            )
        shape = ordered.sizes["row"], ordered.sizes["col"]
        if shape != self.instrument.image_shape:
            raise PlaybackError(
                f"the image has {shape[0]} × {shape[1]} pixels, its instrument "
                f"{' × '.join(map(str, self.instrument.image_shape))}: the page needs all of them"
            )

    def piece(self, start: int, stop: int, /) -> Piece:
        """Return one image."""
        _check_picture(start, stop, self.length)
        return Piece(_NOTHING, self._images[start].drop_vars(SERIES_DIM, errors="ignore"), 0)

    def close(self) -> None:
        """Do nothing: the images are in memory."""


def open_played(path: Path, /) -> Playable:
    """Open a recording of codes or of sums.

    Parameters
    ----------
    path : Path
        First file of the recording.

    Returns
    -------
    Playable
        The open recording.

    Raises
    ------
    HueflightError
        If it can't be read.
    """
    recording = open_recording(path)
    try:
        if not recording.frames and holds_recorded_sums(recording):
            return PlayedSums(recording)
        return PlayedRecording(recording)
    except BaseException:
        recording.close()
        raise


def open_result(path: Path, instrument: Instrument, /) -> Playable:
    """Open an image, a series of images or counts.

    Parameters
    ----------
    path : Path
        Path of the file.
    instrument : Instrument
        Instrument of counts that do not say which.

    Returns
    -------
    Playable
        The file in memory.

    Raises
    ------
    HueflightError
        If it can't be read.
    """
    return PlayedImages(path) if is_image(path) else PlayedCounts(path, instrument)


def _check_picture(start: int, stop: int, length: int) -> None:
    if not 0 <= start < length or stop != start + 1:
        raise PlaybackError(
            f"pictures {start} to {stop}: there are pictures 0 to {length}, shown one at a time"
        )
