"""Captures from files: recordings of packets, or counts of any camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import HistogramError
from hueflight.importers import read_counts
from hueflight.importers.arrays import read_array
from hueflight.instrument import Instrument
from hueflight.recording import open_recording


@dataclass(frozen=True)
class Capture:
    """Counts and the instrument that made them.

    Attributes
    ----------
    counts : (row, col, code), or (step, row, col, code) where read by step.
    """

    counts: NDArray[Any]
    instrument: Instrument


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
            counts = recording.histograms_by_step() if by_step else recording.histogram()
            return Capture(counts, recording.instrument)
    if not by_step:
        return Capture(*read_counts(path, instrument))
    if not path.exists():
        raise HistogramError(f"no capture {str(path)!r}: there is no such file")
    stacked, described = read_array(path, None)
    known = described or instrument
    if known is None or stacked.shape[1:] != known.histogram_shape:
        raise HistogramError(
            f"{path} has shape {stacked.shape}; one LED at a time is (step, row, col, code)"
        )
    return Capture(stacked, known)


def write_counts(path: Path, counts: NDArray[Any], instrument: Instrument) -> None:
    """Counts with their instrument as a compressed .npz file, as `read_capture` reads them."""
    np.savez_compressed(path, histogram=counts, instrument=np.array(instrument.to_json()))
