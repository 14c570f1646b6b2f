"""One array out of a NumPy, Zarr or HDF5 file, and what the file says of its instrument."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, HueflightError
from hueflight.files import import_optional
from hueflight.model.instrument import Instrument

COUNTS = "histogram"  #: name that is taken where there are several arrays
DESCRIPTIONS = ("instrument_description", "instrument")  #: where files keep it, as JSON


def read_array(path: Path, dataset: str | None) -> tuple[NDArray[Any], Instrument | None]:
    """The array of that name (or the obvious one) and the instrument, if the file has it.

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
    except Exception as error:  # readers fail in many ways on what is damaged
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(f"{str(path)!r} can't be read: {reason}") from error
    if description is None:
        return array, None
    return array, Instrument.from_json(description, where=f"instrument in {path}")


def _read_npy(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    if dataset is not None:
        raise FileFormatError(f"{str(path)!r} holds one array without a name; leave dataset out")
    # no pickles: they run what they contain
    return np.load(path, allow_pickle=False), None


def _read_npz(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    if not zipfile.is_zipfile(path):
        raise FileFormatError(f"{str(path)!r} is not an .npz file: it is damaged or cut short")
    with np.load(path, allow_pickle=False) as file:
        described = next((name for name in DESCRIPTIONS if name in file.files), None)
        names = [name for name in file.files if name not in DESCRIPTIONS]
        text = None if described is None else str(file[described])
        return file[_choose(path, names, dataset)], text


def _read_zarr(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    node = zarr.open(path, mode="r")
    text = _description(dict(node.attrs))
    if isinstance(node, zarr.Array):
        if dataset is not None:
            raise FileFormatError(f"{str(path)!r} is one array; leave dataset = {dataset!r} out")
        return np.asarray(node[...]), text
    names = [name for name, member in node.members(max_depth=None) if hasattr(member, "dtype")]
    chosen = node[_choose(path, names, dataset)]
    assert isinstance(chosen, zarr.Array)  # only arrays were offered
    return np.asarray(chosen[...]), text


def _read_hdf5(path: Path, dataset: str | None) -> tuple[NDArray[Any], str | None]:
    h5py = import_optional("h5py", extra="import")
    with h5py.File(path, "r") as file:
        names: list[str] = []
        file.visititems(
            lambda name, node: names.append(name) if isinstance(node, h5py.Dataset) else None
        )
        array = file[_choose(path, names, dataset)]
        if array.dtype.kind not in "uif":
            raise FileFormatError(f"{str(path)!r}: {array.name} holds {array.dtype}, not numbers")
        return array[...], _description(dict(file.attrs))


def _choose(path: Path, names: list[str], dataset: str | None) -> str:
    """The name asked for, the only one, or the one called like counts."""
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
        f"{str(path)!r} holds {len(names)} arrays ({', '.join(names[:8])}): say which with dataset="
    )


def _description(attributes: dict[str, Any]) -> str | None:
    for name in DESCRIPTIONS:
        value = attributes.get(name)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str) and value.lstrip().startswith("{"):
            return value
    return None
