# SPDX-License-Identifier: Apache-2.0
"""Named arrays and attributes of a calibration in one Zarr directory, written whole.

The format number rises whenever an older reader would be misled.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import google_crc32c
import numpy as np
import zarr
from numpy.typing import NDArray

from hueflight.errors import CalibrationError, CalibrationNotFoundError, FileFormatError
from hueflight.files import ZARR_FORMAT, make_parent, require_checksums, staged, write_checksums
from hueflight.files.checksums import CHECKSUM_LIST
from hueflight.recognition import CALIBRATION, CALIBRATION_FORMAT, what_is

FORMAT = CALIBRATION_FORMAT
FORMAT_NUMBER = 2
#: format 1 kept its checksums, of the arrays' values, in the attribute `crc32c`
READABLE_FORMATS = (1, 2)
CHUNK_BYTES = 4e6
REFERENCE = "reference"
DEFERRED_BYTES = 2.5e8  #: larger references stay on disk until they are used


@dataclass(frozen=True)
class StoredReference:
    """Counts of a reference that are on disk.

    Attributes
    ----------
    path : Path
        The store.
    shape : tuple of int
        Rows, columns and bins.
    checksums : bytes
        List of the store's checksums when it was opened, which were verified then.
    """

    path: Path
    shape: tuple[int, ...]
    checksums: bytes

    def blocks(self) -> Iterator[NDArray[np.float32]]:
        """Read the counts in runs of some rows.

        Yields
        ------
        ndarray of float32, shape (row, col, bin)
            The next rows.

        Raises
        ------
        CalibrationError
            If the store was replaced or removed since it was opened.
        """
        if _list_of(self.path) != self.checksums:
            raise CalibrationError(
                f"calibration {str(self.path)!r} was replaced or removed since it was loaded: load "
                "it again"
            )
        array = cast("zarr.Array", zarr.open_group(self.path, mode="r")[REFERENCE])
        rows = array.chunks[0]
        for start in range(0, self.shape[0], rows):
            yield np.asarray(array[start : start + rows])

    def read(self) -> NDArray[np.float32]:
        """Read all counts.

        Returns
        -------
        ndarray of float32, shape (row, col, bin)
            The counts.

        Raises
        ------
        CalibrationError
            If the store was replaced or removed since it was opened.
        """
        counts = np.empty(self.shape, np.float32)
        start = 0
        for block in self.blocks():
            counts[start : start + len(block)] = block
            start += len(block)
        return counts

    def __reduce__(self) -> tuple[object, ...]:
        """Send the counts themselves to other processes, which may not see this disk."""
        return np.asarray, (self.read(),)


class DeferredReference:
    """Field of a frozen dataclass whose counts may stay on disk until they are first used."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = f"_{name}"

    def __get__(self, instance: object | None, owner: type) -> NDArray[np.float32]:
        if instance is None:  # `dataclass` asks for a default, and there is none
            raise AttributeError(self._name)
        value = vars(instance)[self._name]
        if isinstance(value, StoredReference):
            value = vars(instance)[self._name] = value.read()
        return value

    def __set__(self, instance: object, value: NDArray[np.float32] | StoredReference) -> None:
        vars(instance)[self._name] = value

    @staticmethod
    def blocks(calibration: object) -> Iterator[NDArray[np.float32]]:
        """Give the counts in runs of rows, without keeping those that are read.

        Parameters
        ----------
        calibration : object
            What has a field ``reference`` of this kind.

        Yields
        ------
        ndarray of float32, shape (row, col, bin)
            The next rows.
        """
        value = vars(calibration)[f"_{REFERENCE}"]
        if isinstance(value, StoredReference):
            yield from value.blocks()
        else:
            yield value


@dataclass(frozen=True)
class StoredCalibration:
    """Content of a calibration store.

    Attributes
    ----------
    arrays : Mapping of str to ndarray
        The arrays by name; a large reference of a store that was read is a `StoredReference`.
    attributes : Mapping of str to Any
        Everything that is not an array.
    """

    arrays: Mapping[str, Any]
    attributes: Mapping[str, Any]


def write_store(path: Path, content: StoredCalibration, *, overwrite: bool = False) -> None:
    """Write a store, which appears under its name only when it is complete.

    Parameters
    ----------
    path : Path
        Name of the store; folders above it are made as needed.
    content : StoredCalibration
        What to write.
    overwrite : bool
        Replace what exists under that name.

    Raises
    ------
    OutputExistsError
        If the name is taken and `overwrite` is not set.
    OutputError
        If the disk refuses.
    """
    make_parent(path)
    with staged(path, overwrite=overwrite) as partial:
        group = zarr.create_group(partial, zarr_format=ZARR_FORMAT)
        for name, values in content.arrays.items():
            # the reference in chunks of some rows, anything smaller in one
            share = CHUNK_BYTES / max(values.nbytes, 1)
            rows = max(1, min(values.shape[0], int(values.shape[0] * share)))
            group.create_array(
                name, data=np.ascontiguousarray(values), chunks=(rows, *values.shape[1:])
            )
        group.attrs.update({"format": FORMAT, "format_number": FORMAT_NUMBER, **content.attributes})
        write_checksums(partial)


def read_store(path: Path) -> StoredCalibration:
    """Read a store of any format number so far.

    Parameters
    ----------
    path : Path
        Name of the store.

    Returns
    -------
    StoredCalibration
        Its content, whose checksums were verified.

    Raises
    ------
    CalibrationNotFoundError
        If there is no such store.
    CalibrationError
        If it is not a calibration, has a newer format, or is damaged.
    """
    if not path.exists():
        raise CalibrationNotFoundError(f"no calibration {path}: there is no such folder")
    try:
        group = zarr.open_group(path, mode="r")
        attributes = dict(group.attrs)
    except Exception:  # zarr raises many kinds for what is not a store
        raise _no_calibration(path) from None
    if attributes.get("format") != FORMAT:
        raise _no_calibration(path)
    number = attributes.get("format_number")
    if number not in READABLE_FORMATS:
        raise CalibrationError(
            f"{path} has calibration format {number!r}, this software reads "
            f"{' and '.join(map(str, READABLE_FORMATS))}: update the software or calibrate again"
        )
    try:
        if number > 1:
            require_checksums(path)
        # not group.members(), which warns of the list of checksums
        names = sorted(member.name for member in path.iterdir() if member.is_dir())
        members = {name: cast("zarr.Array", group[name]) for name in names}
        # format 1 has checksums of values, for which they have to be read
        large = REFERENCE in members and members[REFERENCE].nbytes > DEFERRED_BYTES
        deferred = number > 1 and large
        arrays: dict[str, Any] = {
            name: np.asarray(array[...])
            for name, array in members.items()
            if not (deferred and name == REFERENCE)
        }
        if deferred:
            shape = members[REFERENCE].shape
            arrays[REFERENCE] = StoredReference(path.absolute(), shape, _list_of(path))
        if number == 1:
            _verify_values(arrays, cast("dict[str, int]", attributes["crc32c"]))
    except FileFormatError as error:
        raise CalibrationError(f"calibration is damaged: {error}") from None
    except Exception as error:  # missing arrays, broken chunks, ill-typed attributes
        raise CalibrationError(
            f"calibration {path} is damaged: {describe(error)}. Restore it or calibrate again"
        ) from None
    return StoredCalibration(arrays, attributes)


def _list_of(path: Path) -> bytes:
    try:
        return (path / CHECKSUM_LIST).read_bytes()
    except OSError:
        return b""


def _no_calibration(path: Path) -> CalibrationError:
    seems = what_is(path)
    if seems == CALIBRATION:  # its attributes are there, but Zarr can't open it
        return CalibrationError(
            f"calibration {str(path)!r} is damaged: restore it or calibrate again"
        )
    return CalibrationError(
        f"{str(path)!r} is {seems}, not a calibration: give the folder NAME.zarr that hueflight "
        "calibrate or Calibration.save wrote"
    )


def describe(error: Exception) -> str:
    """Give the type and the first line of an error of another library."""
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}: {text[0]}" if text else type(error).__name__


def _verify_values(arrays: Mapping[str, NDArray[Any]], checksums: Mapping[str, int]) -> None:
    """Compare arrays with checksums of their values: Zarr reads a missing chunk as zeros."""
    for name, checksum in checksums.items():
        if google_crc32c.value(np.ascontiguousarray(arrays[name]).tobytes()) != checksum:
            raise ValueError(f"{name} does not match its checksum")
