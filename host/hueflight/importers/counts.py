"""Counts of any camera, from NumPy, Zarr, HDF5, PTU or SDT files, through an `Instrument`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, InputNotFoundError, InstrumentError
from hueflight.importers.arrays import read_array
from hueflight.importers.tcspc import read_ptu, read_sdt
from hueflight.model.histograms import check_histogram
from hueflight.model.instrument import Instrument

AXES = ("row", "col", "code")
ARRAY_ENDINGS = (".npy", ".npz", ".zarr", ".h5", ".hdf5", ".hdf")
ENDINGS = (*ARRAY_ENDINGS, ".ptu", ".sdt")


def read_counts(
    path: str | Path,
    instrument: Instrument | None = None,
    /,
    *,
    dataset: str | None = None,
    axes: str = "row,col,code",
    channel: int | None = None,
) -> tuple[NDArray[Any], Instrument]:
    """Histogram (row, col, code) from a file, and the instrument that it belongs to.

    Parameters
    ----------
    path : ``.npy``, ``.npz``, ``.zarr``, ``.h5``, ``.hdf5``, ``.ptu`` or ``.sdt``.
    instrument : that made the counts; needed unless the file says, as our own do.
    dataset : name of the array inside the file; may be left out if there is one only, or one
        called ``histogram``. For SDT the number of the data block.
    axes : what the array's axes are, in its order. With ``frame`` instead of ``code`` the
        array holds one raw code per pixel and frame, and is counted. Axes of length one may
        be called ``-``.
    channel : detection channel of a PTU file; default the only one.

    Returns
    -------
    counts, instrument.

    Raises
    ------
    FileFormatError
        If the file can't be read or is not what its name says.
    InstrumentError
        If nobody says which instrument made the counts, or the file says another one.
    HistogramError
        If the counts are not that instrument's.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise FileFormatError(
            f"{str(path)!r} ends in {ending or 'nothing'!r}: counts are read from "
            f"{', '.join(ENDINGS)}"
        )
    if not path.exists():
        raise InputNotFoundError(f"no counts {str(path)!r}: there is no such file")
    if ending in ARRAY_ENDINGS:
        array, described = read_array(path, dataset)
        chosen = _agreed(path, instrument, described)
        return check_histogram(arranged(array, axes, chosen), chosen, name=path.name), chosen
    if instrument is None:
        raise InstrumentError(
            f"{str(path)!r} does not say which bands there are: give an instrument "
            "(importers.tcspc_instrument makes one from the file and your bands)"
        )
    if ending == ".ptu":
        counts = read_ptu(path, instrument, channel=channel)
    else:
        counts = read_sdt(path, instrument, block=dataset)
    return check_histogram(counts, instrument, name=path.name), instrument


def arranged(array: NDArray[Any], axes: str, instrument: Instrument) -> NDArray[Any]:
    """The array with axes (row, col, code); frames of codes are counted.

    Raises
    ------
    FileFormatError
        If the axes don't describe the array.
    """
    names = [name.strip() for name in axes.split(",")]
    if len(names) != array.ndim:
        raise FileFormatError(
            f"axes = {axes!r} names {len(names)} axes but the array has shape {array.shape}"
        )
    for name, size in zip(names, array.shape, strict=True):
        if name == "-" and size != 1:
            raise FileFormatError(
                f"axes = {axes!r}: an axis called '-' has length {size}, not 1; select one first"
            )
    array = array.reshape([n for name, n in zip(names, array.shape, strict=True) if name != "-"])
    names = [name for name in names if name != "-"]
    if sorted(names) == sorted(AXES):
        return array.transpose([names.index(name) for name in AXES])
    if sorted(names) == ["col", "frame", "row"]:
        order = [names.index(name) for name in ("frame", "row", "col")]
        return count_codes(array.transpose(order), instrument)
    raise FileFormatError(
        f"axes = {axes!r}: name row, col and code, or row, col and frame, each once"
    )


def count_codes(codes: NDArray[Any], instrument: Instrument) -> NDArray[np.uint32]:
    """Histogram (row, col, code) of frames (frame, row, col) of raw codes.

    Raises
    ------
    FileFormatError
        If a code is not one of the sensor's, or not a whole number.
    """
    limit = instrument.sensor.codes
    if codes.dtype.kind not in "ui":
        raise FileFormatError(f"codes are whole numbers; the array has type {codes.dtype}")
    if codes.size and (int(codes.min()) < 0 or int(codes.max()) >= limit):
        wild = (codes < 0) | (codes >= limit)
        where = tuple(int(i) for i in np.argwhere(wild)[0])
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
    """The instrument given or the one the file describes; they must not contradict."""
    if given is None and described is None:
        raise InstrumentError(
            f"{str(path)!r} does not say which instrument made its counts: give one"
        )
    if given is not None and described is not None and (apart := described.differences(given)):
        raise InstrumentError(
            f"{str(path)!r} was made by instrument {described.name!r}, not {given.name!r}: "
            f"{'; '.join(apart[:3])}"
        )
    chosen = given or described
    assert chosen is not None  # one of them is there
    return chosen
