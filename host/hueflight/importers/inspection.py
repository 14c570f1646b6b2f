# SPDX-License-Identifier: Apache-2.0
"""What a file of counts, a calibration, an image or an instrument description is and holds."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from hueflight.calibration import Calibration
from hueflight.calibration.store import FORMAT as CALIBRATION_FORMAT
from hueflight.errors import FileFormatError, HueflightError, InputNotFoundError
from hueflight.files import import_optional, verify_checksums
from hueflight.files.ages import age
from hueflight.files.image_schema import SERIES_DIM
from hueflight.files.inspection import (
    CHECKED,
    READ,
    FileDescription,
    array_text,
    checked,
)
from hueflight.importers.arrays import DESCRIPTIONS, description_in
from hueflight.importers.foreign_inspection import (
    describe_csv,
    describe_json,
    describe_mat,
    describe_ptu,
    describe_sdt,
)
from hueflight.importers.images import read_image
from hueflight.model.instrument import Instrument
from hueflight.recognition import what_is, why_unreadable

PIECE_BYTES = 1 << 26  #: of an array that are read at a time


def describe_file(path: Path, /, *, check: bool = False) -> FileDescription:
    """Describe a file that this software reads or writes, apart from recordings.

    Parameters
    ----------
    path : Path
        Counts (``.npz``, ``.npy``, ``.zarr``, ``.h5``, ``.mat``, ``.csv``, ``.json``, ``.ptu``,
        ``.sdt``), a calibration (``.zarr``), an image (``.zarr``, ``.nc``) or an instrument
        description (``.toml``).
    check : bool, default False
        Whether to read all of the content and to compare it with checksums, where there are any.

    Returns
    -------
    FileDescription
        Kind and content of the file.

    Raises
    ------
    InputNotFoundError
        If there is no such file.
    FileFormatError
        If it is of no known kind, or its description can't be read.
    HueflightError
        If it is an instrument description or a calibration that can't be used.
    """
    ending = path.suffix.lower()
    if not path.exists():
        raise InputNotFoundError(f"{str(path)!r}: there is no such file")
    if ending not in _DESCRIBERS:
        raise FileFormatError(
            f"{str(path)!r} is {what_is(path)}, of which info says no more: it describes .mcap, "
            f"{', '.join(_DESCRIBERS)}"
        )
    try:
        return _DESCRIBERS[ending](path, check)
    except HueflightError:
        raise
    except Exception as error:  # the libraries raise many kinds of errors for damaged files
        raise FileFormatError(why_unreadable(path, error)) from error


def instrument_facts(instrument: Instrument) -> dict[str, Any]:
    """Return what describes an instrument, as plain values.

    Parameters
    ----------
    instrument : Instrument
        The instrument.

    Returns
    -------
    dict
        Names, sizes, times and bands.
    """
    sensor, timing = instrument.sensor, instrument.timing
    return {
        "instrument": instrument.name,
        "description": instrument.description,
        "rows": sensor.rows,
        "cols": sensor.cols,
        "codes": sensor.codes,
        "bin_width_ns": sensor.bin_width_ns,
        "period_ns": timing.period_ns,
        "bands": [f"{band.name} {band.wavelength_nm:g} nm" for band in instrument.bands],
        "fingerprint": instrument.fingerprint(),
    }


def _describe_toml(path: Path, check: bool) -> FileDescription:
    del check  # reading the description is reading everything
    facts = instrument_facts(Instrument.load(path))
    return FileDescription(
        kind="instrument description",
        facts=facts,
        whole=True,
        evidence="every entry was read and is consistent with the others",
    )


def _describe_npz(path: Path, check: bool) -> FileDescription:
    def read() -> str:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
        if damaged is not None:
            raise FileFormatError(f"{damaged} does not agree with its checksum")
        return CHECKED

    arrays: dict[str, str] = {}
    described = None
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            name = member.removesuffix(".npy")
            with archive.open(member) as entry:
                if name in DESCRIPTIONS:
                    described = str(np.lib.format.read_array(entry, allow_pickle=False))
                    continue
                version = np.lib.format.read_magic(entry)
                header = (
                    np.lib.format.read_array_header_1_0
                    if version == (1, 0)
                    else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = header(entry)
                arrays[name] = array_text(shape, dtype)
    return checked("counts in NumPy arrays", _counts_facts(arrays, described, path), check, read)


def _describe_npy(path: Path, check: bool) -> FileDescription:
    # mapping fails if the file is shorter than its header says
    array = np.load(path, mmap_mode="r", allow_pickle=False)

    def read() -> str:
        np.load(path, allow_pickle=False)
        return READ

    facts = {"arrays": {"(only one)": array_text(array.shape, array.dtype)}}
    return checked("counts in a NumPy array", facts, check, read)


def _describe_zarr(path: Path, check: bool) -> FileDescription:
    node = zarr.open(path, mode="r")
    attributes = dict(node.attrs)
    if attributes.get("format") == CALIBRATION_FORMAT:
        return _describe_calibration(path, attributes, check)
    if isinstance(node, zarr.Group) and {"depth", "wavelength"} <= set(node.array_keys()):
        return _describe_image(path, check)
    arrays = [("(only one)", node)] if isinstance(node, zarr.Array) else _members(node)

    def read() -> str:
        sealed = verify_checksums(path)
        for _, array in arrays:
            _read_in_pieces(array)
        return CHECKED if sealed else READ.replace("files of this kind have", "the store has")

    shown = {name: array_text(array.shape, array.dtype) for name, array in arrays}
    facts = _counts_facts(shown, description_in(attributes), path)
    return checked("counts in a Zarr store", facts, check, read)


def _members(group: zarr.Group) -> list[tuple[str, zarr.Array]]:
    members = group.members(max_depth=None)
    return [(name, member) for name, member in members if isinstance(member, zarr.Array)]


def _describe_hdf5(path: Path, check: bool) -> FileDescription:
    h5py = import_optional("h5py", extra="import")
    arrays: dict[str, str] = {}
    with h5py.File(path, "r") as file:
        file.visititems(
            lambda name, node: (
                arrays.update({name: array_text(node.shape, node.dtype)})
                if isinstance(node, h5py.Dataset)
                else None
            )
        )
        described = description_in(dict(file.attrs))

    def read() -> str:
        with h5py.File(path, "r") as file:
            for name in arrays:
                _read_in_pieces(file[name])
        return READ

    return checked("arrays in HDF5", _counts_facts(arrays, described, path), check, read)


def _read_in_pieces(array: Any) -> None:
    """Read an array some rows at a time, so that it need not fit into memory."""
    if not array.shape or not array.size:
        array[()]
        return
    row = max(1, array.dtype.itemsize * array.size // array.shape[0])
    step = max(1, PIECE_BYTES // row)
    for start in range(0, array.shape[0], step):
        array[start : start + step]


def _counts_facts(arrays: dict[str, str], described: str | None, path: Path) -> dict[str, Any]:
    facts: dict[str, Any] = {"arrays": arrays}
    if described is None:
        return facts | {"instrument": None}
    return facts | instrument_facts(Instrument.from_json(described, where=f"instrument in {path}"))


def _describe_calibration(path: Path, attributes: dict[str, Any], check: bool) -> FileDescription:
    instrument = Instrument.from_json(attributes["instrument"], where=f"instrument in {path}")
    facts = {
        "distance_m": attributes["distance_m"],
        "saved": attributes["saved"],
        "age": age(attributes["provenance"].get("created", attributes["saved"])),
        "saved_by": attributes["saved_by"],
        **instrument_facts(instrument),
    }

    def read() -> str:
        Calibration.load(path)
        return CHECKED

    return checked("calibration", facts, check, read)


def _describe_image(path: Path, check: bool) -> FileDescription:
    store = path.suffix.lower() == ".zarr"
    if not store:
        import_optional("h5netcdf", extra="import")
    opened = xr.open_zarr(path, chunks=None) if store else xr.open_dataset(path, engine="h5netcdf")
    with opened as image:
        series = SERIES_DIM in image.sizes
        attributes = {
            name: value
            for name, value in image.attrs.items()
            # long texts for programs, of which the others are the summary
            if name not in ("instrument_description", "calibration", "Conventions", "title")
        }
        facts = {
            **{str(dim): size for dim, size in image.sizes.items()},
            "variables": [str(name) for name in image.data_vars],
            **attributes,
        }
        if "wavelength" in image.coords:
            facts["wavelengths_nm"] = image["wavelength"].values.tolist()
        if "band_name" in image.coords:
            facts["bands"] = [str(name) for name in image["band_name"].values]

    def read() -> str:
        sealed = store and verify_checksums(path)
        read_image(path)
        return CHECKED if sealed else READ.replace("files of this kind have", "the file has")

    return checked("series of images" if series else "image", facts, check, read)


_DESCRIBERS: dict[str, Callable[[Path, bool], FileDescription]] = {
    ".npz": _describe_npz,
    ".npy": _describe_npy,
    ".zarr": _describe_zarr,
    ".nc": _describe_image,
    ".nc4": _describe_image,
    ".h5": _describe_hdf5,
    ".hdf5": _describe_hdf5,
    ".hdf": _describe_hdf5,
    ".ptu": describe_ptu,
    ".sdt": describe_sdt,
    ".mat": describe_mat,
    ".csv": describe_csv,
    ".json": describe_json,
    ".jsonl": describe_json,
    ".toml": _describe_toml,
}
