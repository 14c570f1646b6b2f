# SPDX-License-Identifier: Apache-2.0
"""Counts in MATLAB files: version 5 to 7 by SciPy, version 7.3, which is HDF5, by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, HueflightError
from hueflight.files import import_optional
from hueflight.importers.arrays import arranged, choose_array
from hueflight.importers.options import ReadOptions, require_instrument
from hueflight.model.instrument import Instrument
from hueflight.recognition import why_unreadable

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
    given = require_instrument(instrument, path)
    try:
        # single numbers, such as a bin width, are no counts
        names = [name for name, (shape, _) in matlab_arrays(path).items() if np.prod(shape) > 1]
        array = read_variable(path, choose_array(path, names, options.dataset))
    except HueflightError:
        raise
    except Exception as error:  # the libraries raise many kinds of errors for damaged files
        raise FileFormatError(why_unreadable(path, error)) from error
    return arranged(array, options.axes, given), given


def matlab_arrays(path: Path, /) -> dict[str, tuple[tuple[int, ...], str]]:
    """List the numeric variables of a MATLAB file.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.

    Returns
    -------
    dict of str to tuple
        Shape as MATLAB shows it, and type, of each variable by its name.
    """
    if _is_hdf5(path):
        h5py = import_optional("h5py", extra="import")
        with h5py.File(path, "r") as file:
            return {
                name: (node.shape[::-1], str(node.dtype))
                for name, node in file.items()
                if isinstance(node, h5py.Dataset) and node.dtype.kind in "uif"
            }
    from scipy.io import whosmat  # loading it takes longer than reading other files

    numeric = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
    numeric |= {"double", "single", "logical"}
    return {
        name: (tuple(shape), kind) for name, shape, kind in whosmat(str(path)) if kind in numeric
    }


def read_variable(path: Path, name: str, /) -> NDArray[Any]:
    """Read a variable of a MATLAB file, with the axes in MATLAB's order.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    name : str
        Name of the variable.

    Returns
    -------
    numpy.ndarray
        Its values.
    """
    if _is_hdf5(path):
        h5py = import_optional("h5py", extra="import")
        with h5py.File(path, "r") as file:
            # HDF5 has the last axis first in memory order, MATLAB the first one
            return file[name][...].T
    from scipy.io import loadmat

    return loadmat(str(path), variable_names=[name])[name]


def _is_hdf5(path: Path) -> bool:
    """Tell version 7.3 from those before."""
    with path.open("rb") as file:
        begin = file.read(HDF5_AT + len(HDF5_SIGNATURE))
    return HDF5_SIGNATURE in (begin[: len(HDF5_SIGNATURE)], begin[HDF5_AT:])
