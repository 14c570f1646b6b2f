"""Captures from files: recordings of packets, or counts as NumPy wrote them."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import HistogramError, InstrumentError
from hueflight.instrument import Instrument
from hueflight.recording import open_recording

COUNTS, INSTRUMENT = "histogram", "instrument"  #: names inside an .npz file


@dataclass(frozen=True)
class Capture:
    """Counts and the instrument that made them.

    Attributes
    ----------
    counts : (row, col, code), or (step, row, col, code) where read by step.
    """

    counts: NDArray[np.generic]
    instrument: Instrument


def read_capture(
    path: Path,
    *,
    instrument: str | None = None,
    default: Instrument | None = None,
    by_step: bool = False,
) -> Capture:
    """Counts of a recording (.mcap) or of a NumPy file (.npz, .npy).

    Parameters
    ----------
    instrument : preset or TOML file that overrides what the file says.
    default : used where neither the file nor `instrument` says.
    by_step : one histogram per step marker (one LED at a time), stacked on a first axis.

    Raises
    ------
    HistogramError
        If the file is no capture, or nobody says which instrument made it.
    RecordingError
        If a recording can't be read.
    """
    chosen = None if instrument is None else Instrument.load(instrument)
    if not path.exists():
        raise HistogramError(f"no capture {str(path)!r}: there is no such file")
    if path.suffix == ".mcap":
        with open_recording(path) as recording:
            counts = recording.histograms_by_step() if by_step else recording.histogram()
            return Capture(counts, chosen or recording.instrument)
    if path.suffix not in (".npz", ".npy"):
        raise HistogramError(
            f"{str(path)!r}: a capture is a recording (.mcap) or counts (.npz, .npy); this ends "
            f"in {path.suffix or 'nothing'!r}"
        )
    counts, described = _read_numpy(path)
    known = chosen or described or default
    if known is None:
        raise InstrumentError(
            f"{path} does not say which instrument made it: name it with --instrument"
        )
    return Capture(counts, known)


def write_counts(path: Path, counts: NDArray[np.generic], instrument: Instrument) -> None:
    """Counts with their instrument as a compressed .npz file."""
    np.savez_compressed(path, **{COUNTS: counts, INSTRUMENT: np.array(instrument.to_json())})


def _read_numpy(path: Path) -> tuple[NDArray[np.generic], Instrument | None]:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return loaded, None
        with loaded:
            arrays = {name: loaded[name] for name in loaded.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise HistogramError(f"{path} is not a NumPy file that can be read: {error}") from None
    described = arrays.pop(INSTRUMENT, None)
    instrument = (
        None if described is None else Instrument.from_json(str(described), where=str(path))
    )
    if COUNTS in arrays:
        return arrays[COUNTS], instrument
    if len(arrays) == 1:
        return next(iter(arrays.values())), instrument
    raise HistogramError(
        f"{path} holds {sorted(arrays)}: name the counts {COUNTS!r}, or store them alone"
    )
