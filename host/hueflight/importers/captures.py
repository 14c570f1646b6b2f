"""Captures from files: recordings of packets, or counts of any camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import HistogramError, InputNotFoundError
from hueflight.files import staged
from hueflight.importers import read_counts
from hueflight.importers.arrays import read_array
from hueflight.ingest import IngestReport
from hueflight.model.instrument import Instrument
from hueflight.recording import open_recording

#: counters of an ingest report that mean that something is missing
LOSSES = ("damaged", "missing", "dropped", "aborted", "foreign", "skipped_bytes", "clipped")


@dataclass(frozen=True)
class Capture:
    """Counts and the instrument that made them.

    Attributes
    ----------
    counts : (row, col, code), or (step, row, col, code) where read by step.
    losses : what the stream of a recording lost, by place; empty if nothing was.
    """

    counts: NDArray[Any]
    instrument: Instrument
    losses: Mapping[str, int] = field(default_factory=dict)


def read_capture(
    path: Path, instrument: Instrument | None = None, /, *, by_step: bool = False
) -> Capture:
    """Counts of a recording (.mcap) or of a file of counts that `read_counts` knows.

    Parameters
    ----------
    instrument : that made them; needed unless the file says, refused if it says another.
    by_step : one histogram per step of the illuminator (one LED at a time), on a first axis.

    Raises
    ------
    RecordingError, FileFormatError
        If the file can't be read.
    InstrumentError
        If nobody says which instrument made the counts.
    HistogramError
        If a recording was made by another instrument, or steps are missing.
    """
    if path.suffix == ".mcap":
        with open_recording(path) as recording:
            if instrument and (apart := recording.instrument.differences(instrument)):
                raise HistogramError(
                    f"{path} was recorded by instrument {recording.instrument.name!r}, not "
                    f"{instrument.name!r}: {'; '.join(apart[:3])}"
                )
            if not by_step:
                counts, report = recording.accumulate()
                return Capture(counts, recording.instrument, losses(report))
            by_number, report = recording.accumulate_by_step()
            if not by_number:
                raise HistogramError(f"{path} has no frames: nothing was captured")
            stacked = np.stack(list(by_number.values()))
            return Capture(stacked, recording.instrument, losses(report))
    if not by_step:
        return Capture(*read_counts(path, instrument))
    if not path.exists():
        raise InputNotFoundError(f"no capture {str(path)!r}: there is no such file")
    stacked, described = read_array(path, None)
    known = described or instrument
    if known is None or stacked.shape[1:] != known.histogram_shape:
        raise HistogramError(
            f"{path} has shape {stacked.shape}; one LED at a time is (step, row, col, code)"
        )
    return Capture(stacked, known)


def losses(report: IngestReport) -> dict[str, int]:
    """What a stream lost, by place; only what is not zero."""
    lost = {name: getattr(report, name) for name in LOSSES}
    return {name: count for name, count in lost.items() if count}


def write_counts(path: Path, counts: NDArray[Any], instrument: Instrument) -> None:
    """Write counts with their instrument to a compressed .npz file, which `read_capture` reads.

    Parameters
    ----------
    path : Path
        Name of the file; numpy appends ``.npz`` where it is missing.
    counts : ndarray, shape (row, col, code) or (step, row, col, code)
        Photon counts.
    instrument : Instrument
        The instrument that made them.

    Raises
    ------
    OutputError
        If the file can't be written.
    """
    with staged(path, overwrite=True) as partial:
        np.savez_compressed(partial, histogram=counts, instrument=np.array(instrument.to_json()))
