# SPDX-License-Identifier: Apache-2.0
"""Arrays that a live picture offers to programs which show one array at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color.live_color import LiveColor
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument


@dataclass(frozen=True)
class PictureArray:
    """One array of a picture.

    Attributes
    ----------
    shape : tuple of int
        Rows, columns, and if there are several, components.
    dtype : numpy.dtype
        Type of its values.
    unit : str
        Unit of its values.
    read : callable
        Returns the array of a picture.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    unit: str
    read: Callable[[xr.Dataset], NDArray]

    def of(self, picture: xr.Dataset, /) -> NDArray:
        """Return the array of a picture.

        Parameters
        ----------
        picture : xarray.Dataset
            Picture of a client.

        Returns
        -------
        ndarray
            The array; unknown values are NaN.

        Raises
        ------
        HueflightError
            If the picture does not have it, as before a calibration.
        """
        try:
            return np.asarray(self.read(picture), self.dtype)
        except KeyError as error:
            there = ", ".join(map(str, picture.data_vars))
            raise HueflightError(
                f"the picture has no {error.args[0]}, only {there}: calibrate the camera first"
            ) from None


def picture_arrays(instrument: Instrument, /) -> Mapping[str, PictureArray]:
    """Return the arrays of an instrument's pictures by name.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the pictures.

    Returns
    -------
    mapping of PictureArray
        ``photons``, ``depth``, ``depth_std``, ``quality``, ``color`` (sRGB), ``reflectance`` and
        ``reflectance_std`` with all bands as components, and each band alone, such as
        ``reflectance 659 nm``.
    """
    shape, color = instrument.image_shape, LiveColor(instrument)
    names = _band_names(instrument)

    def plane(name: str, dtype: str, unit: str) -> PictureArray:
        def read(picture: xr.Dataset) -> NDArray:
            return picture[name].transpose("row", "col").values

        return PictureArray(shape, np.dtype(dtype), unit, read)

    def cube(name: str) -> PictureArray:
        def read(picture: xr.Dataset) -> NDArray:
            return picture[name].transpose("row", "col", "band").values

        return PictureArray((*shape, len(names)), np.dtype("f4"), "1", read)

    def band(name: str, number: int) -> PictureArray:
        def read(picture: xr.Dataset) -> NDArray:
            return picture[name].transpose("row", "col", "band").values[..., number]

        return PictureArray(shape, np.dtype("f4"), "1", read)

    found = {
        "photons": plane("photons", "u4", "count"),
        "depth": plane("depth", "f4", "m"),
        "depth_std": plane("depth_std", "f4", "m"),
        "quality": plane("quality", "u2", "1"),
        "color": PictureArray((*shape, 3), np.dtype("u1"), "1", color.shown),
    }
    for name in ("reflectance", "reflectance_std"):
        found[name] = cube(name)
        found |= {f"{name} {label}": band(name, number) for number, label in enumerate(names)}
    return found


def _band_names(instrument: Instrument) -> tuple[str, ...]:
    """Wavelengths, and beyond those that occur twice the names of the bands."""
    wavelengths = [f"{band.wavelength_nm:g} nm" for band in instrument.bands]
    return tuple(
        text if wavelengths.count(text) == 1 else f"{text} ({band.name})"
        for text, band in zip(wavelengths, instrument.bands, strict=True)
    )
