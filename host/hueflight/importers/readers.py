# SPDX-License-Identifier: Apache-2.0
"""Registry of the readers of files of counts, by file extension.

A reader of another kind of file is one more line in `READERS`, or, in another package, an entry
point in the group `hueflight.importers` whose name is the extension without its dot::

    [project.entry-points."hueflight.importers"]
    xyz = "my_package:read_xyz"
"""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from hueflight.errors import FileFormatError
from hueflight.importers.arrays import read_array_counts
from hueflight.importers.matlab import read_mat
from hueflight.importers.options import ReadOptions
from hueflight.importers.photon_hdf5 import read_hdf5
from hueflight.importers.tcspc import read_ptu, read_sdt
from hueflight.importers.text import read_csv, read_json_log
from hueflight.model.instrument import Instrument
from hueflight.recognition import CALIBRATION, IMAGE, what_is

ENTRY_POINT_GROUP = "hueflight.importers"


class CountsReader(Protocol):
    """Reads the counts in one kind of file.

    It raises a `FileFormatError` if the file can't be read, an `InstrumentError` if no instrument
    is known or the file contradicts it, and calls `ReadOptions.refuse_all_but` with the options
    that it uses. What it returns is checked against the instrument.
    """

    def __call__(
        self, path: Path, instrument: Instrument | None, options: ReadOptions, /
    ) -> tuple[NDArray[Any], Instrument]:
        """Read a file.

        Parameters
        ----------
        path : pathlib.Path
            Path of the file.
        instrument : Instrument, optional
            Instrument given by the caller.
        options : ReadOptions
            What to take from the file.

        Returns
        -------
        counts : numpy.ndarray, shape (row, col, code)
            The counts.
        instrument : Instrument
            The instrument that made them.
        """
        ...


READERS: dict[str, CountsReader] = {
    ".npy": read_array_counts,
    ".npz": read_array_counts,
    ".zarr": read_array_counts,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".hdf": read_hdf5,
    ".mat": read_mat,
    ".csv": read_csv,
    ".json": read_json_log,
    ".jsonl": read_json_log,
    ".ptu": read_ptu,
    ".sdt": read_sdt,
}
"""The readers of this package by extension, in lower case."""


def reader_of(path: Path, /) -> CountsReader:
    """Return the reader for a file, by its extension in upper or lower case.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.

    Returns
    -------
    CountsReader
        Reader of this package or of an installed one.

    Raises
    ------
    FileFormatError
        If there is no reader for this extension.
    """
    extension = path.suffix.lower()
    if extension in READERS:
        return READERS[extension]
    installed = {f".{entry.name.lower()}": entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
    if extension in installed:
        return installed[extension].load()
    raise FileFormatError(
        f"{str(path)!r} is {what_is(path)}, and counts are not read from "
        f"{f'files that end in {extension!r}' if extension else 'names without an extension'}: "
        f"give a recording (.mcap) or one of {', '.join([*READERS, *sorted(installed)])}"
    )


def refuse_results(path: Path, dataset: str | None, /) -> None:
    """Raise an error for an image or a calibration where counts are wanted.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    dataset : str, optional
        Name of an array; if one is given, it is meant.

    Raises
    ------
    FileFormatError
        If the file is a result and no counts.
    """
    seems = what_is(path)
    if dataset is None and seems in (CALIBRATION, IMAGE):
        raise FileFormatError(
            f"{str(path)!r} is {seems}, not a capture: give the recording (.mcap) or the counts "
            "that it was made from"
        )
