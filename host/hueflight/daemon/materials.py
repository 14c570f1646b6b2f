# SPDX-License-Identifier: Apache-2.0
"""Materials and spectral indices of a picture, as the configuration wants them."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from hueflight.analysis import SpectralLibrary, add_materials
from hueflight.daemon.config import MaterialsConfig
from hueflight.daemon.config_section import ConfigError
from hueflight.daemon.picture import Picture
from hueflight.errors import HueflightError
from hueflight.live.image import message_of_image
from hueflight.model.instrument import Instrument


class MaterialError(HueflightError):
    """There is no such material or index, or no calibrated picture yet."""


class PictureMaterials:
    """Computes abundances and indices of pixels, or of whole pictures.

    Parameters
    ----------
    config : MaterialsConfig
        Which materials and indices.
    instrument : Instrument
        Instrument of the pictures.

    Attributes
    ----------
    names : dict of str to str
        What is computed, such as ``"abundance of red"``, by name of its plane, ``"abundance_red"``.

    Raises
    ------
    ConfigError
        If the library can't be read, or the bands do not support what is wanted.
    """

    def __init__(self, config: MaterialsConfig, instrument: Instrument, /) -> None:
        self._instrument, self._indices = instrument, config.indices
        self._library: SpectralLibrary | None = None
        try:
            if config.library:
                whole = SpectralLibrary.named(config.library)
                self._library = whole.select(config.names) if config.names else whole
            unknown = np.full((1, 1, len(instrument.bands)), np.nan)
            cube = ("row", "col", "band")
            names = [band.name for band in instrument.bands]
            coords = {
                "wavelength": ("band", instrument.wavelengths_nm),
                "band_name": ("band", names),
            }
            planes = {"reflectance": (cube, unknown), "reflectance_std": (cube, unknown)}
            nothing = self._computed(xr.Dataset(planes, coords))
            self.names = {name: _text(value) for name, (value, _) in nothing.items()}
        except HueflightError as error:
            raise ConfigError(f"materials: {error}") from None

    def of(self, pixel: xr.Dataset, /) -> list[dict[str, Any]]:
        """Return what is computed of a pixel.

        Parameters
        ----------
        pixel : xarray.Dataset
            Image of one row and one column.

        Returns
        -------
        list of dict
            `name`, `value` and `std` of each abundance and index; None where unknown.
        """
        return [
            {"name": _text(value), "value": _number(value), "std": _number(std)}
            for value, std in self._computed(pixel).values()
        ]

    def message(self, picture: Picture | None, name: str, /) -> bytes:
        """Return the map of an abundance or index, as a message of the coding ``"exact"``.

        Parameters
        ----------
        picture : Picture or None
            The picture.
        name : str
            Name of its plane, one of `names`.

        Returns
        -------
        bytes
            Message with the planes ``value`` and ``std``, float32, NaN where unknown.

        Raises
        ------
        MaterialError
            If nothing of this name is configured, or the picture is not calibrated.
        """
        if name not in self.names:
            known = ", ".join(map(repr, self.names)) or "nothing"
            raise MaterialError(f"{name!r} is not configured in the table [materials]: {known} is")
        if picture is None or picture.image is None:
            raise MaterialError("there is no calibrated picture yet: calibrate, or wait for one")
        value, std = self._computed(picture.image)[name]
        planes = {"value": value, "std": std}
        maps = xr.Dataset(
            {plane: (("row", "col"), found.values) for plane, found in planes.items()}
        )
        rows, cols = picture.photons.shape
        text = self.names[name]
        header = {"number": picture.number, "name": text, "rows": rows, "cols": cols}
        return message_of_image(maps, header)

    def _computed(self, image: xr.Dataset) -> dict[str, tuple[xr.DataArray, xr.DataArray]]:
        """Value and standard deviation of each abundance and index, by name of the plane."""
        if self._library is None and not self._indices:
            return {}
        wanted = image[["reflectance", "reflectance_std"]]
        found = add_materials(
            wanted, library=self._library, indices=self._indices, instrument=self._instrument
        )
        return {
            str(name): (plane, found[f"{name}_std"])
            for name, plane in found.data_vars.items()
            if f"{name}_std" in found and name not in wanted
        }


def _text(plane: xr.DataArray) -> str:
    return str(plane.attrs["long_name"])


def _number(value: xr.DataArray) -> float | None:
    number = float(value.item())
    return number if np.isfinite(number) else None
