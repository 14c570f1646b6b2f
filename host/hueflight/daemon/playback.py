# SPDX-License-Identifier: Apache-2.0
"""Recordings, counts and images as pictures like the live ones, on request.

Nothing runs by itself: who plays a file asks for one picture after another. They are made one at a
time, by a thread that gives way to acquisition.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.acquisition.plan import CaptureError
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.calibration import Calibration
from hueflight.color.live_color import LiveColor
from hueflight.daemon.calibration_job import CALIBRATION_NAME
from hueflight.daemon.picture import Picture, count_photons
from hueflight.daemon.pixel import inspect
from hueflight.daemon.playable import Piece, Playable, PlaybackError, open_played, open_result
from hueflight.daemon.recordings_folder import (
    NAME,
    RecordingMissingError,
    RecordingNameError,
    RecordingsFolder,
)
from hueflight.daemon.results_folder import ResultsFolder
from hueflight.daemon.status import describe_instrument
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.entry_point import reconstruct
from hueflight.reconstruction.sums.recorded import reconstruct_recorded_sums
from hueflight.reconstruction.video import Video

MOST_WAITING = 8  #: requests that are answered or wait; others are refused
T = TypeVar("T")


class Playback:
    """Makes pictures of files.

    Parameters
    ----------
    recordings : RecordingsFolder
        Folder of the recordings.
    results : ResultsFolder
        Folder of images and counts.
    calibrations : Path
        Folder of the calibrations.
    instrument : Instrument
        Instrument of the daemon.
    calibration : callable
        Returns the calibration in use, or None. It is taken for files that name none.
    method : callable
        Returns the method of reconstruction that live pictures have.
    """

    def __init__(
        self,
        recordings: RecordingsFolder,
        results: ResultsFolder,
        calibrations: Path,
        instrument: Instrument,
        /,
        *,
        calibration: Callable[[], Calibration | None],
        method: Callable[[], str],
    ) -> None:
        self._recordings, self._results = recordings, results
        self._calibrations, self._instrument = calibrations, instrument
        self._calibration_in_use, self._method = calibration, method
        self._open: _Opened | None = None
        self._room = threading.BoundedSemaphore(MOST_WAITING)
        self._worker = ThreadPoolExecutor(
            1,
            thread_name_prefix="playback",
            initializer=lambda: set_thread_priority(ThreadPriority.RECONSTRUCTION),
        )

    def describe(self, name: str, /) -> dict[str, Any]:
        """Return what a file holds.

        Parameters
        ----------
        name : str
            Name of a recording, or of a result with its ending.

        Returns
        -------
        dict
            Kind, length, duration, instrument, and the calibration that its pictures are made with.

        Raises
        ------
        HueflightError
            If there is no such file, it can't be read, or too many requests wait.
        """
        return self._work(lambda: self._opened(name).describe())

    def picture(self, name: str, start: int, stop: int, /) -> tuple[Picture, LiveColor]:
        """Return the picture of some frames of a recording, or a picture of a result.

        Parameters
        ----------
        name : str
            Name of a recording, or of a result with its ending.
        start, stop : int
            First frame, and the frame after the last one; of a recording of sums, pictures; of a
            result, the number of a picture and the next.

        Returns
        -------
        tuple of (Picture, LiveColor)
            The picture, and the colours of its instrument.

        Raises
        ------
        HueflightError
            If there is no such file or part of it, it can't be read, or too many requests wait.
        """

        def make() -> tuple[Picture, LiveColor]:
            opened = self._opened(name)
            return opened.picture(start, stop, self._method()), opened.live_color

        return self._work(make)

    def pixel(self, name: str, start: int, stop: int, /, *, row: int, col: int) -> dict[str, Any]:
        """Return all that is known of one pixel of a picture; see `hueflight.daemon.pixel`.

        Parameters
        ----------
        name, start, stop : str, int, int
            As of `picture`.
        row, col : int
            Coordinates of the pixel.

        Returns
        -------
        dict
            Numbers by name.

        Raises
        ------
        HueflightError
            As `picture`, or if there is no such pixel.
        """

        def look() -> dict[str, Any]:
            opened = self._opened(name)
            picture = opened.picture(start, stop, self._method())
            instrument = opened.file.instrument
            return inspect(picture, instrument, opened.calibration, row=row, col=col)

        return self._work(look)

    def close(self) -> None:
        """Close the file that is open."""
        self._worker.shutdown(cancel_futures=True)
        if self._open is not None:
            self._open.file.close()

    def _work(self, work: Callable[[], T]) -> T:
        if not self._room.acquire(blocking=False):
            raise CaptureError(
                f"{MOST_WAITING} requests for pictures of files wait already: try again later"
            )
        try:
            return self._worker.submit(work).result()
        finally:
            self._room.release()

    def _opened(self, name: str) -> _Opened:
        path = self._path(name)
        with _told(name):
            stat = path.stat()
            version = (path, stat.st_mtime_ns, stat.st_size)
            before = self._open
            if before is not None and before.version == version and not self._is_outdated(before):
                return before
            if before is not None:
                self._open = None
                before.file.close()
            self._open = self._opening(name, path, version)
            return self._open

    def _path(self, name: str) -> Path:
        if "." in name:
            return self._results.path(name)
        path = self._recordings.path(name)
        if not path.exists():
            raise RecordingMissingError(
                f"there is no finished recording called {name!r}: GET /api/recordings lists what "
                "there is"
            )
        return path

    def _is_outdated(self, opened: _Opened) -> bool:
        """Whether another calibration is in use since, where the file itself names none."""
        return not opened.named and opened.offered is not self._calibration_in_use()

    def _opening(self, name: str, path: Path, version: tuple[Any, ...]) -> _Opened:
        file: Playable
        file = open_result(path, self._instrument) if "." in name else open_played(path)
        offered = self._calibration_in_use()
        named = self._named_calibration(file.calibration)
        chosen, label = (named[1], named[0]) if named else (offered, "the one in use")
        if chosen is not None:
            try:
                chosen.require(file.instrument)
            except HueflightError:
                chosen = None
        if chosen is None or file.kind == "image":
            label = ""
        return _Opened(name, file, version, chosen, label, offered, named is not None)

    def _named_calibration(self, name: str) -> tuple[str, Calibration] | None:
        """The calibration that a recording names, if it is still there."""
        if not re.fullmatch(NAME, name):
            return None
        path = self._calibrations / name / CALIBRATION_NAME
        try:
            return (name, Calibration.load(path)) if path.exists() else None
        except HueflightError:
            return None


class _Opened:
    """A file that is open, with what its pictures are made with, and the latest of them."""

    def __init__(
        self,
        name: str,
        file: Playable,
        version: tuple[Any, ...],
        calibration: Calibration | None,
        calibration_name: str,
        offered: Calibration | None,
        named: bool,
    ) -> None:
        self.name, self.file, self.version = name, file, version
        self.calibration = None if file.kind == "image" else calibration
        self._calibration_name = calibration_name
        self.offered, self.named = offered, named
        emission = None if calibration is None else calibration.emission
        self.live_color = LiveColor(file.instrument, emission)
        self._latest: tuple[tuple[int, int, str], Picture] | None = None

    def describe(self) -> dict[str, Any]:
        """Return what the file holds."""
        file = self.file
        return {
            "name": self.name,
            "kind": file.kind,
            "capture": file.capture,
            "length": file.length,
            "unit": file.unit,
            "seconds": file.seconds,
            "simulated": file.simulated,
            "calibration": self._calibration_name,
            "instrument": describe_instrument(file.instrument),
        }

    def picture(self, start: int, stop: int, method: str) -> Picture:
        """Return a picture, the latest one without making it anew."""
        wanted = (start, stop, method)
        if self._latest is not None and self._latest[0] == wanted:
            return self._latest[1]
        begun_s = time.monotonic()
        with _told(self.name):
            piece = self.file.piece(start, stop)
            image = piece.image
            if image is None:
                image = self._reconstruct(piece, method)
            photons = _photons_of(piece, image, self.file.instrument)
        frames = np.broadcast_to(np.asarray(piece.frames, np.int64), photons.shape)
        ready_s = time.monotonic()
        received_s = ready_s - (time.time() - piece.unix_s)
        picture = Picture(
            number=start,
            kind=self.file.capture,
            histogram=piece.histogram,
            image=image,
            photons=photons,
            frames=int(frames.max(initial=0)),
            frames_by_pixel=frames,
            device_s=0.0,
            received_s=received_s,
            begun_s=received_s,
            ready_s=received_s + ready_s - begun_s,
        )
        self._latest = wanted, picture
        return picture

    def _reconstruct(self, piece: Piece, method: str) -> xr.Dataset | None:
        calibration = self.calibration
        if calibration is None or self.file.capture not in ("scene", "reference"):
            return None
        if piece.sums is not None:
            return (
                reconstruct_recorded_sums(piece.sums, calibration) if piece.sums.pictures else None
            )
        known = None if self.file.instrument.sensor.reports_empty else piece.frames
        if method == "joint":  # as live pictures are made
            return Video(calibration, change_sigma=0).next(piece.histogram, frames=known)
        return reconstruct(piece.histogram, calibration, method=method, frames=known)


def _photons_of(
    piece: Piece, image: xr.Dataset | None, instrument: Instrument
) -> NDArray[np.integer]:
    if piece.sums is not None:
        return piece.sums.values[..., 0].astype(np.int64)  # the first sum counts photons
    return count_photons(piece.histogram, image, instrument, piece.frames)


@contextmanager
def _told(name: str) -> Iterator[None]:
    """Say of which file an error is."""
    try:
        yield
    except (PlaybackError, RecordingMissingError, RecordingNameError):
        raise
    except (HueflightError, OSError) as error:
        raise PlaybackError(f"{name} can't be played: {error}") from error
