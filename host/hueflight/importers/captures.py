# SPDX-License-Identifier: Apache-2.0
"""Captures from files: recordings of packets, or counts of any camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.arguments import COUNTS, PATH, SWITCH, TEXT, WHOLE, takes
from hueflight.errors import FileFormatError, HistogramError, InputNotFoundError
from hueflight.files import staged
from hueflight.files.ages import age
from hueflight.importers.arrays import arranged, read_array, read_array_counts
from hueflight.importers.counts import read_counts
from hueflight.importers.options import AXES, ReadOptions
from hueflight.importers.readers import reader_of, refuse_results
from hueflight.ingest import IngestReport
from hueflight.model.instrument import Instrument
from hueflight.recording import open_recording

SAME_DISTANCE_M = 1e-3  #: difference between stated distances that means nothing
#: counters of an ingest report that mean a loss
LOSSES = ("damaged", "missing", "dropped", "aborted", "foreign", "skipped_bytes", "clipped")


@dataclass(frozen=True)
class Capture:
    """Counts and the instrument that made them.

    Attributes
    ----------
    counts : numpy.ndarray, shape (row, col, code) or (step, row, col, code)
        The counts; with an axis of steps if they were read by step.
    instrument : Instrument
        The instrument that made them.
    losses : Mapping of str to int
        What is missing from the counts, by kind; empty if nothing is. For recordings these are
        counters of `IngestReport`. For files of counts, ``outside_period`` is the number of
        counts in codes that lie beyond the period of the instrument.
    notes : Mapping of str to str
        What a recording states about itself: its kind as ``capture``, such as ``"reference"``, the
        distance of the target as ``distance_m``, and others; empty for files of counts.
    started : str or None
        Time at which a recording started, ISO 8601 in UTC.
    """

    counts: NDArray[Any]
    instrument: Instrument
    losses: Mapping[str, int] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    started: str | None = None

    def __repr__(self) -> str:
        made = f", recorded {self.started} ({age(self.started)})" if self.started else ""
        kind = self.notes.get("capture", "capture")
        away = f" at {self.notes['distance_m']} m" if "distance_m" in self.notes else ""
        return f"<{kind}{away} of {self.instrument.name!r}, {self.counts.shape}{made}>"

    def contradictions(self, *, kind: str, distance: float | None = None) -> list[str]:
        """Return where the notes of a recording contradict what is believed of it.

        Parameters
        ----------
        kind : str
            Kind of capture, such as ``"reference"``.
        distance : float, optional
            Distance of the target, m.

        Returns
        -------
        list of str
            Contradictions, as parts of a sentence; empty if the notes agree or say nothing.
        """
        found = []
        if self.notes.get("capture", kind) != kind:
            found.append(f"it was recorded as {self.notes['capture']!r}, not as {kind!r}")
        try:
            stated = float(self.notes.get("distance_m", "nan"))
        except ValueError:
            return found
        if distance is not None and abs(stated - distance) > SAME_DISTANCE_M:
            found.append(f"it states a distance of {stated:g} m, not {distance:g} m")
        return found


@takes(path=PATH, instrument=Instrument, by_step=SWITCH, dataset=TEXT, axes=TEXT, channel=WHOLE)
def read_capture(
    path: Path,
    instrument: Instrument | None = None,
    /,
    *,
    by_step: bool = False,
    dataset: str | None = None,
    axes: str = AXES,
    channel: int | None = None,
) -> Capture:
    """Read a recording (``.mcap``) or a file of counts of any camera.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument, optional
        Instrument that made the counts; needed unless the file describes it, and refused if the
        file describes another one.
    by_step : bool
        Whether to keep one histogram per step of the illuminator (one LED at a time), on a first
        axis.
    dataset : str, optional
        Name of the array in a file of counts, as in `read_counts`.
    axes : str
        Names of the axes of that array, as in `read_counts`. With `by_step`, an axis ``step`` is
        one of them, or it comes before those that are named.
    channel : int, optional
        Detection channel of a PTU file, as in `read_counts`.

    Returns
    -------
    Capture
        Counts, instrument and losses.

    Raises
    ------
    InputNotFoundError
        If there is no such file.
    RecordingError, FileFormatError
        If the file can't be read.
    InstrumentError
        If no instrument is known.
    HistogramError
        If a recording was made by another instrument, or steps are missing.
    """
    options = ReadOptions(dataset=dataset, axes=axes, channel=channel)
    if path.suffix.lower() == ".mcap":
        options.refuse_all_but(path=path)
        with open_recording(path) as recording:
            if instrument and (apart := recording.instrument.differences(instrument)):
                raise HistogramError(
                    f"{path} was recorded by instrument {recording.instrument.name!r}, not "
                    f"{instrument.name!r}: {'; '.join(apart[:3])}"
                )
            about = recording.metadata, recording.info().started
            if not by_step:
                counts, report = recording.accumulate()
                return Capture(counts, recording.instrument, losses(report), *about)
            by_number, report = recording.accumulate_by_step()
            if not by_number:
                raise HistogramError(f"{path} has no frames: nothing was captured")
            stacked = np.stack(list(by_number.values()))
            return Capture(stacked, recording.instrument, losses(report), *about)
    if not by_step:
        counts, chosen = read_counts(path, instrument, dataset=dataset, axes=axes, channel=channel)
        return Capture(counts, chosen, _outside_period(counts, chosen))
    if not path.exists():
        raise InputNotFoundError(f"no capture {str(path)!r}: there is no such file")
    refuse_results(path, dataset)
    if reader_of(path) is not read_array_counts:
        raise FileFormatError(
            f"{str(path)!r} can't hold one LED at a time: store an array (step, row, col, code) as "
            ".npz, .npy, .zarr or .h5"
        )
    options.refuse_all_but("dataset", "axes", path=path)
    array, described = read_array(path, dataset)
    known = described or instrument
    stacked = None if known is None else _steps(array, axes, known)
    if known is None or stacked is None or stacked.shape[1:] != known.histogram_shape:
        raise HistogramError(
            f"{path} has shape {array.shape}; one LED at a time is (step, row, col, code)"
        )
    return Capture(stacked, known)


def _steps(array: NDArray[Any], axes: str, instrument: Instrument) -> NDArray[Any] | None:
    """Return an array with axes (step, row, col, code); None if it has too few or too many."""
    names = [name.strip() for name in axes.split(",")]
    if "step" not in names:
        names.insert(0, "step")
    if array.ndim != len(names):
        return None
    by_step = np.moveaxis(array, names.index("step"), 0)
    names.remove("step")
    if names == AXES.split(","):
        return by_step
    return np.stack([arranged(each, ",".join(names), instrument) for each in by_step])


def losses(report: IngestReport) -> dict[str, int]:
    """Return the losses of a stream of packets by kind, without those that are 0."""
    lost = {name: getattr(report, name) for name in LOSSES}
    return {name: count for name, count in lost.items() if count}


@takes(path=PATH, counts=COUNTS, instrument=Instrument)
def write_counts(path: Path, counts: NDArray[Any], instrument: Instrument) -> None:
    """Write counts with their instrument as a compressed ``.npz`` file.

    The file replaces an existing one, but only when it is complete.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    counts : numpy.ndarray, shape (row, col, code) or (step, row, col, code)
        The counts.
    instrument : Instrument
        The instrument that made them.

    Raises
    ------
    OutputError
        If the file can't be written.
    """
    with staged(path, overwrite=True) as partial:
        np.savez_compressed(partial, histogram=counts, instrument=np.array(instrument.to_json()))


def _outside_period(counts: NDArray[Any], instrument: Instrument) -> dict[str, int]:
    """Return the number of counts in codes beyond the period, if there are any."""
    unused = np.ones(instrument.sensor.codes, dtype=bool)
    unused[instrument.time_bins().codes] = False
    if instrument.sensor.reports_empty:
        unused[0] = False
    outside = int(counts[..., unused].sum(dtype=np.float64))
    return {"outside_period": outside} if outside else {}
