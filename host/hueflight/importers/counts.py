# SPDX-License-Identifier: Apache-2.0
"""Counts of any camera from files, through an `Instrument`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from hueflight.arguments import PATH, TEXT, WHOLE, takes
from hueflight.errors import InputNotFoundError
from hueflight.importers.options import AXES, ReadOptions
from hueflight.importers.readers import reader_of, refuse_results
from hueflight.model.histograms import check_histogram
from hueflight.model.instrument import Instrument


@takes(path=PATH, instrument=Instrument, dataset=TEXT, axes=TEXT, channel=WHOLE)
def read_counts(
    path: str | Path,
    instrument: Instrument | None = None,
    /,
    *,
    dataset: str | None = None,
    axes: str = AXES,
    channel: int | None = None,
) -> tuple[NDArray[Any], Instrument]:
    """Read a histogram from a file, and the instrument that it belongs to.

    Parameters
    ----------
    path : str or pathlib.Path
        File whose extension selects the reader: ``.npy``, ``.npz``, ``.zarr``, ``.h5``,
        ``.hdf5``, ``.hdf``, ``.ptu``, ``.sdt``, or that of an installed reader.
    instrument : Instrument, optional
        Instrument that made the counts; needed unless the file describes it.
    dataset : str, optional
        Name of the array in the file. It may be left out if there is only one, or one called
        ``histogram``. For SDT files it is the number of the data block.
    axes : str
        Names of the axes of the array, in its order. With ``frame`` instead of ``code`` the
        array holds one raw code per pixel and frame, which are counted. An axis of length one
        may be called ``-``.
    channel : int, optional
        Detection channel of a PTU or SDT file, counted from 0; by default the only one
        with photons.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The histogram.
    instrument : Instrument
        The instrument that made it.

    Raises
    ------
    InputNotFoundError
        If there is no such file.
    FileFormatError
        If the file can't be read, is incomplete or is not what its extension says, or an option
        is not one of its reader.
    InstrumentError
        If no instrument is known, or the file describes another one.
    HistogramError
        If the counts do not fit the instrument.
    """
    path = Path(path)
    if not path.exists():
        raise InputNotFoundError(f"no counts {str(path)!r}: there is no such file")
    refuse_results(path, dataset)
    reader = reader_of(path)
    options = ReadOptions(dataset=dataset, axes=axes, channel=channel)
    counts, chosen = reader(path, instrument, options)
    return check_histogram(counts, chosen, name=path.name), chosen
