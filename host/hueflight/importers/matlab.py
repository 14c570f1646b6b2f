# SPDX-License-Identifier: Apache-2.0
"""Counts in MATLAB files: version 5 to 7 by SciPy, version 7.3, which is HDF5, by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, HueflightError, InstrumentError
from hueflight.files import import_optional
from hueflight.importers.arrays import arranged, choose_array
from hueflight.importers.options import ReadOptions
from hueflight.model.instrument import Instrument

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
HDF5_AT = 512  #: bytes of MATLAB's own header before the HDF5 file


def read_mat(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[Any], Instrument]:
    """Read the counts in a MATLAB file of any version since 5.

    Axes have the order that MATLAB shows with ``size``, in files of all versions.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument
        Instrument that made the counts, which such files do not describe.
    options : ReadOptions
        Name of the variable and its axes.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The counts.
    instrument : Instrument
        The instrument.

    Raises
    ------
    FileFormatError
        If the file can't be read, or it is not clear which variable is meant.
    InstrumentError
        If the instrument is missing.
    """
    options.refuse_all_but("dataset", "axes", path=path)
    if instrument is None:
        raise InstrumentError(
            f"{str(path)!r} does not say which instrument made its counts: give one"
        )
    try:
        with path.open("rb") as file:
            begin = file.read(HDF5_AT + len(HDF5_SIGNATURE))
        hdf5 = HDF5_SIGNATURE in (begin[: len(HDF5_SIGNATURE)], begin[HDF5_AT:])
        read = _read_hdf5 if hdf5 else _read_version_5
        array = read(path, options.dataset)
    except HueflightError:
        raise
    except Exception as error:  # the libraries raise many kinds of errors for damaged files
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(f"{str(path)!r} can't be read as a MATLAB file: {reason}") from error
    return arranged(array, options.axes, instrument), instrument


def _read_version_5(path: Path, dataset: str | None) -> NDArray[Any]:
    from scipy.io import loadmat, whosmat  # loading it takes longer than reading other files

    numeric = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
    numeric |= {"double", "single", "logical"}
    found = {name: (shape, kind) for name, shape, kind in whosmat(str(path))}
    # single numbers, such as a bin width, are no counts
    names = [
        name for name, (shape, kind) in found.items() if kind in numeric and np.prod(shape) > 1
    ]
    chosen = choose_array(path, names, dataset)
    return loadmat(str(path), variable_names=[chosen])[chosen]


def _read_hdf5(path: Path, dataset: str | None) -> NDArray[Any]:
    h5py = import_optional("h5py", extra="import")
    with h5py.File(path, "r") as file:
        names = [
            name
            for name, node in file.items()
            if isinstance(node, h5py.Dataset) and node.dtype.kind in "uif" and node.size > 1
        ]
        # HDF5 has the last axis first in memory order, MATLAB the first one
        return file[choose_array(path, names, dataset)][...].T
