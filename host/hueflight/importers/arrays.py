# SPDX-License-Identifier: Apache-2.0
"""Counts in NumPy, Zarr and HDF5 files, and the instrument that such a file may describe."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, HueflightError, InstrumentError
from hueflight.files import import_optional
from hueflight.importers.options import AXES, ReadOptions, require_instrument
from hueflight.model.instrument import Instrument
from hueflight.recognition import why_unreadable

COUNTS = "histogram"  #: name of the array that is read by default if there are several
DESCRIPTIONS = ("instrument_description", "instrument")  #: entries with an instrument as JSON


def read_array_counts(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[Any], Instrument]:
    """Read the counts in a NumPy, Zarr or HDF5 file.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument, optional
        Instrument that made the counts; needed unless the file describes it.
    options : ReadOptions
        Name of the array and its axes.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The counts.
    instrument : Instrument
        The instrument that made them.

    Raises
    ------
    FileFormatError
        If the file can't be read, or it is not clear which array is meant.
    InstrumentError
        If no instrument is known, or the file describes another one.
    """
    options.refuse_all_but("dataset", "axes", path=path)
    array, described = read_array(path, options.dataset)
    chosen = _agreed(path, instrument, described)
    return arranged(array, options.axes, chosen), chosen


def read_array(path: Path, dataset: str | None) -> tuple[NDArray[Any], Instrument | None]:
    """Read an array and the instrument that the file describes.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    dataset : str, optional
        Name of the array. By default the only one, or the one called ``histogram``.

    Returns
    -------
    array : numpy.ndarray
        The array.
    instrument : Instrument or None
        The instrument, if the file describes one.

    Raises
    ------
    FileFormatError
        If the file can't be read, or it is not clear which array is meant.
    """
    readers = {".npy": _read_npy, ".npz": _read_npz, ".zarr": _read_zarr}
    reader = readers.get(path.suffix.lower(), _read_hdf5)
    try:
        array, description = reader(path, dataset)
    except HueflightError:
        raise
    except Exception as error:  # the libraries raise many kinds of errors for damaged files
        raise FileFormatError(why_unreadable(path, error)) from error
    if description is None:
        return array, None
    return array, Instrument.from_json(description, where=f"instrument in {path}")


def _read_npy(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    if dataset is not None:
        raise FileFormatError(
            f"{str(path)!r} holds one array without a name; leave dataset out (--dataset)"
        )
    # no pickles: loading one can run any code
    return np.load(path, allow_pickle=False), None


def _read_npz(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    if not zipfile.is_zipfile(path):
        raise ValueError("it has no list of its contents")
    with np.load(path, allow_pickle=False) as file:
        described = next((name for name in DESCRIPTIONS if name in file.files), None)
        names = [name for name in file.files if name not in DESCRIPTIONS]
        text = None if described is None else str(file[described])
        if text is not None and not text.lstrip().startswith("{"):
            raise FileFormatError(
                f"{str(path)!r}: the entry {described!r} is reserved for the description of an "
                f"instrument as JSON, but it holds {text[:60]!r}: rename this entry, or store "
                "Instrument.to_json() there"
            )
        return file[choose_array(path, names, dataset)], text


def _read_zarr(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    node = zarr.open(path, mode="r")
    text = description_in(dict(node.attrs))
    if isinstance(node, zarr.Array):
        if dataset is not None:
            raise FileFormatError(
                f"{str(path)!r} is one array; leave dataset = {dataset!r} out (--dataset)"
            )
        return np.asarray(node[...]), text
    names = [name for name, member in node.members(max_depth=None) if hasattr(member, "dtype")]
    chosen = node[choose_array(path, names, dataset)]
    assert isinstance(chosen, zarr.Array)  # `names` has only arrays
    return np.asarray(chosen[...]), text


def _read_hdf5(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    h5py = import_optional("h5py", extra="import")
    with h5py.File(path, "r") as file:
        names: list[str] = []
        file.visititems(
            lambda name, node: names.append(name) if isinstance(node, h5py.Dataset) else None
        )
        array = file[choose_array(path, names, dataset)]
        if array.dtype.kind not in "uif":
            raise FileFormatError(f"{str(path)!r}: {array.name} holds {array.dtype}, not numbers")
        return array[...], description_in(dict(file.attrs))


def choose_array(path: Path, names: list[str], dataset: str | None) -> str:
    """Choose one of the arrays of a file: the one asked for, the only one, or ``histogram``.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file, for messages.
    names : list of str
        Names of its arrays.
    dataset : str or None
        Name that was asked for.

    Returns
    -------
    str
        Name of the array.

    Raises
    ------
    FileFormatError
        If there is no such array, or it is not clear which is meant.
    """
    if dataset is not None:
        if dataset.strip("/") not in names:
            raise FileFormatError(
                f"{str(path)!r} has no array {dataset!r}: it has {', '.join(names) or 'none'}"
            )
        return dataset.strip("/")
    if len(names) == 1:
        return names[0]
    if COUNTS in names:
        return COUNTS
    raise FileFormatError(
        f"{str(path)!r} holds {len(names)} arrays ({', '.join(names[:8])}): say which with dataset "
        "(--dataset)"
    )


def description_in(attributes: dict[str, Any]) -> str | None:
    """Return the description of an instrument as JSON, if attributes of a file hold one."""
    for name in DESCRIPTIONS:
        value = attributes.get(name)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str) and value.lstrip().startswith("{"):
            return value
    return None


def arranged(array: NDArray[Any], axes: str, instrument: Instrument) -> NDArray[Any]:
    """Return an array with axes (row, col, code); frames of codes are counted.

    Parameters
    ----------
    array : numpy.ndarray
        Counts, or raw codes with an axis ``frame``.
    axes : str
        Names of the axes, separated by commas; ``-`` for an axis of length one.
    instrument : Instrument
        Instrument that states the number of codes.

    Returns
    -------
    numpy.ndarray, shape (row, col, code)
        The counts.

    Raises
    ------
    FileFormatError
        If the axes don't describe the array.
    """
    names = [name.strip() for name in axes.split(",")]
    if len(names) != array.ndim:
        raise FileFormatError(
            f"axes = {axes!r} names {len(names)} axes but the array has shape {array.shape}: name "
            "each of its axes (--axes)"
        )
    for name, size in zip(names, array.shape, strict=True):
        if name == "-" and size != 1:
            raise FileFormatError(
                f"axes = {axes!r}: an axis called '-' has length {size}, not 1; select one first"
            )
    array = array.reshape([n for name, n in zip(names, array.shape, strict=True) if name != "-"])
    names = [name for name in names if name != "-"]
    wanted = AXES.split(",")
    if sorted(names) == sorted(wanted):
        return array.transpose([names.index(name) for name in wanted])
    if sorted(names) == ["col", "frame", "row"]:
        order = [names.index(name) for name in ("frame", "row", "col")]
        return count_codes(array.transpose(order), instrument)
    raise FileFormatError(
        f"axes = {axes!r}: name row, col and code, or row, col and frame, each once"
    )


def count_codes(codes: NDArray[Any], instrument: Instrument) -> NDArray[np.uint32]:
    """Count frames of raw codes.

    Parameters
    ----------
    codes : numpy.ndarray of int, shape (frame, row, col)
        One code for each pixel and frame.
    instrument : Instrument
        Instrument that states the number of codes.

    Returns
    -------
    numpy.ndarray, uint32, shape (row, col, code)
        The counts.

    Raises
    ------
    FileFormatError
        If a code is not a whole number, or the sensor has no such code.
    """
    limit = instrument.sensor.codes
    if codes.dtype.kind not in "ui":
        raise FileFormatError(f"codes are whole numbers; the array has type {codes.dtype}")
    if codes.size and (int(codes.min()) < 0 or int(codes.max()) >= limit):
        outside = (codes < 0) | (codes >= limit)
        where = tuple(int(i) for i in np.argwhere(outside)[0])
        raise FileFormatError(
            f"code {codes[where]} at (frame, row, col) = {where} is outside 0..{limit - 1} of "
            f"instrument {instrument.name!r}"
        )
    rows, cols = codes.shape[1:]
    counts = np.zeros((rows, cols, limit), dtype=np.uint32)
    pixel = np.arange(cols) * limit
    for row in range(rows):  # one row at a time bounds the memory of the indices
        index = codes[:, row].astype(np.intp) + pixel
        flat = np.bincount(index.ravel(), minlength=cols * limit)
        counts[row] = flat.reshape(cols, limit)
    return counts


def _agreed(path: Path, given: Instrument | None, described: Instrument | None) -> Instrument:
    """Return the instrument given or described by the file; they must not contradict."""
    if given is not None and described is not None and (apart := described.differences(given)):
        raise InstrumentError(
            f"{str(path)!r} was made by instrument {described.name!r}, not {given.name!r}: "
            f"{'; '.join(apart[:3])}"
        )
    return require_instrument(given or described, path)
