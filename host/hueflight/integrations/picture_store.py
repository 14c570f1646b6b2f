# SPDX-License-Identifier: Apache-2.0
"""A Zarr store to which pictures are appended one by one, readable at any time with xarray."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
import zarr

from hueflight.errors import OutputError
from hueflight.integrations.planes import PictureArray, picture_arrays
from hueflight.model.instrument import Instrument

POINT = "point"  #: dimension along which pictures are appended


class PictureStore:
    """Arrays of pictures along the dimension ``point``, in one Zarr group.

    Parameters
    ----------
    path : pathlib.Path
        Folder of the store, which must not exist yet.
    instrument : Instrument
        Instrument of the pictures.
    names : sequence of str
        Arrays to keep, of `hueflight.integrations.planes.picture_arrays`.

    Attributes
    ----------
    path : pathlib.Path
        Folder of the store.
    arrays : dict of PictureArray
        Arrays that are kept, by name.
    count : int
        Pictures in the store.

    Raises
    ------
    OutputError
        If the store exists already or can't be written, or an array is unknown.
    """

    def __init__(self, path: Path, instrument: Instrument, names: Sequence[str], /) -> None:
        known = picture_arrays(instrument)
        unknown = [name for name in names if name not in known]
        if unknown:
            raise OutputError(f"there is no array {unknown[0]!r}: choose of {', '.join(known)}")
        self.path, self.count = path, 0
        self.arrays = {name: known[name] for name in names}
        try:
            described = {"instrument_description": instrument.to_json()}
            self._group = zarr.create_group(store=path, attributes=described)
            self._members = {name: self._make(name, kept) for name, kept in self.arrays.items()}
            self._frames = self._number("frames", "u4")
            self._received = self._number("received_unix_s", "f8")
            wavelengths = instrument.wavelengths_nm
            member = self._group.create_array(
                "wavelength", data=wavelengths, dimension_names=("band",)
            )
            member.attrs["units"] = "nm"
        except (OSError, ValueError) as error:
            raise OutputError(f"can't write {path}: {error}") from None

    def append(self, picture: xr.Dataset, /) -> None:
        """Append a picture.

        Parameters
        ----------
        picture : xarray.Dataset
            Picture of a client.

        Raises
        ------
        HueflightError
            If the picture lacks an array, as before a calibration.
        """
        values = {name: kept.of(picture) for name, kept in self.arrays.items()}
        for name, member in self._members.items():
            member.append(values[name][np.newaxis])
        self._frames.append(np.array([picture.attrs["frames"]], "u4"))
        self._received.append(np.array([picture.attrs["received_unix_s"]]))
        self.count += 1

    def _make(self, name: str, kept: PictureArray) -> zarr.Array:
        dims = ("row", "col", "rgb" if name == "color" else "band")
        member = self._group.create_array(
            name,
            shape=(0, *kept.shape),
            chunks=(1, *kept.shape),
            dtype=kept.dtype,
            dimension_names=(POINT, *dims[: len(kept.shape)]),
        )
        member.attrs["units"] = kept.unit
        return member

    def _number(self, name: str, dtype: str) -> zarr.Array:
        return self._group.create_array(
            name, shape=(0,), chunks=(1024,), dtype=dtype, dimension_names=(POINT,)
        )
