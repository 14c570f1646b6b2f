# SPDX-License-Identifier: Apache-2.0
"""Comparison of measured spectra with a library of reference spectra."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.analysis.comparison import spectral_angle
from hueflight.color import SpectralModel, tristimulus
from hueflight.color.color_chart import PATCHES, patch_reflectances
from hueflight.color.color_difference import delta_e_2000, lab
from hueflight.color.recovery import NODES_NM
from hueflight.errors import FileFormatError, HueflightError
from hueflight.model.instrument import Instrument
from hueflight.model.spectra import WAVELENGTH_NM, band_weights

NOISE = 0.01  #: deviation of band values for which the colour estimate is balanced


@dataclass(frozen=True)
class SpectralLibrary:
    """Reference reflectance spectra.

    Attributes
    ----------
    names : tuple of str
        Names of the entries.
    wavelengths_nm : ndarray of float, shape (wavelength,)
        Wavelengths in ascending order, nm.
    reflectance : ndarray of float, shape (entry, wavelength)
        Reflectances, 0 to 1; fluorescent surfaces may exceed 1.
    """

    names: tuple[str, ...]
    wavelengths_nm: NDArray[np.float64]
    reflectance: NDArray[np.float64]

    def __post_init__(self) -> None:
        shape = (len(self.names), self.wavelengths_nm.size)
        if self.reflectance.shape != shape or 0 in shape:
            raise HueflightError(
                f"a library of {shape[0]} names and {shape[1]} wavelengths needs reflectances of "
                f"shape {shape}; they have {self.reflectance.shape}"
            )
        if not (np.diff(self.wavelengths_nm) > 0).all():
            raise HueflightError("the library's wavelengths must rise from line to line")
        if not np.isfinite(self.reflectance).all():
            raise HueflightError("the library's reflectances must all be numbers")

    @classmethod
    def load(cls, path: str | Path, /) -> SpectralLibrary:
        """Read a library from a CSV file.

        The first line holds a heading for the wavelengths and the names of the entries; each
        further line a wavelength in nm and the reflectance of every entry. Lines that start with #
        are comments.

        Parameters
        ----------
        path : str or Path
            Name of the file.

        Returns
        -------
        SpectralLibrary
            The library.

        Raises
        ------
        FileFormatError
            If the file can't be read, or a line does not hold the right numbers; the message says
            which.
        """
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise FileFormatError(f"can't read library {str(path)!r}: {error}") from None
        lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
        head, *rows = list(csv.reader(lines)) or [[]]
        if len(head) < 2 or not rows:
            raise FileFormatError(
                f"library {str(path)!r}: give a heading with names, then lines of a wavelength in "
                "nm and one reflectance for each name"
            )
        values = []
        for number, row in enumerate(rows, start=2):
            try:
                values.append([float(entry) for entry in row])
            except ValueError:
                raise FileFormatError(f"library {str(path)!r}, line {number}: {row}") from None
            if len(row) != len(head):
                raise FileFormatError(
                    f"library {str(path)!r}, line {number} has {len(row)} entries, the heading "
                    f"{len(head)}"
                )
        table = np.array(values)
        try:
            return cls(tuple(name.strip() for name in head[1:]), table[:, 0], table[:, 1:].T.copy())
        except HueflightError as error:
            raise FileFormatError(f"library {str(path)!r}: {error}") from None

    @classmethod
    def colorchecker(cls) -> SpectralLibrary:
        """Make a library of the 24 patches of a ColorChecker, with the spectra of the simulator.

        Returns
        -------
        SpectralLibrary
            One entry for each patch; see `hueflight.color.color_chart.patch_reflectances`.
        """
        return cls(tuple(PATCHES), WAVELENGTH_NM, patch_reflectances())

    def select(self, names: Sequence[str], /) -> SpectralLibrary:
        """Return a library of some of the entries.

        Parameters
        ----------
        names : sequence of str
            Names of the entries, in the order wanted.

        Returns
        -------
        SpectralLibrary
            The smaller library.

        Raises
        ------
        HueflightError
            If there is no such entry.
        """
        unknown = [name for name in names if name not in self.names]
        if unknown or not names:
            raise HueflightError(
                f"material {(unknown or [''])[0]!r}: the library has {', '.join(self.names)}"
            )
        rows = [self.names.index(name) for name in names]
        return SpectralLibrary(tuple(names), self.wavelengths_nm, self.reflectance[rows])

    @classmethod
    def named(cls, source: str | Path, /) -> SpectralLibrary:
        """Return the built-in library ``colorchecker``, or the one in a CSV file.

        Parameters
        ----------
        source : str or Path
            ``"colorchecker"`` or the name of a file, as for `load`.

        Returns
        -------
        SpectralLibrary
            The library.

        Raises
        ------
        FileFormatError
            If the file can't be read.
        """
        return cls.colorchecker() if str(source) == "colorchecker" else cls.load(source)

    def at(self, wavelengths_nm: NDArray[np.floating]) -> NDArray[np.float64]:
        """Interpolate the spectra linearly at other wavelengths.

        Parameters
        ----------
        wavelengths_nm : ndarray of float, shape (wavelength,)
            Wavelengths, nm.

        Returns
        -------
        ndarray of float, shape (entry, wavelength)
            Reflectances; beyond the ends of the library those at the ends.
        """
        return np.array(
            [np.interp(wavelengths_nm, self.wavelengths_nm, entry) for entry in self.reflectance]
        )

    def in_bands(self, instrument: Instrument) -> xr.DataArray:
        """Compute what an instrument would measure of each entry.

        Parameters
        ----------
        instrument : Instrument
            Instrument whose bands are used.

        Returns
        -------
        DataArray, dims (entry, band)
            Reflectances.

        Raises
        ------
        HueflightError
            If a band lies outside the library's wavelengths.
        """
        low, high = self.wavelengths_nm[0], self.wavelengths_nm[-1]
        for band in instrument.bands:
            if not low <= band.wavelength_nm <= high:
                raise HueflightError(
                    f"band {band.name!r} at {band.wavelength_nm:g} nm lies outside the library, "
                    f"which reaches from {low:g} to {high:g} nm"
                )
        values = self.at(WAVELENGTH_NM) @ band_weights(instrument).T
        return xr.DataArray(values, dims=("entry", "band"), coords={"entry": list(self.names)})


def match(spectra: xr.DataArray, library: SpectralLibrary, instrument: Instrument, /) -> xr.Dataset:
    """Compare measured spectra with every entry of a library.

    Parameters
    ----------
    spectra : DataArray, dims (..., band)
        Reflectances, such as ``image["reflectance"]`` or those of regions.
    library : SpectralLibrary
        Reference spectra.
    instrument : Instrument
        Instrument that measured the spectra.

    Returns
    -------
    Dataset
        `angle` (..., entry): spectral angle in radians, which does not depend on brightness;
        `delta_e` (..., entry): CIEDE2000 difference under CIE illuminant C of the colours that
        measured and library bands give through the same map, NaN without a band between 400 and
        700 nm; `best` (...): name of the entry of the smallest angle, empty where no band is known.

    Raises
    ------
    HueflightError
        If the number of bands differs, or a band lies outside the library's wavelengths.

    Notes
    -----
    Colours come from a Wiener estimate of the smooth spectrum behind the bands (Pratt and
    Mancill, Appl. Opt. 15, 73, 1976), with negative reflectances taken as 0.
    """
    if spectra.sizes.get("band") != len(instrument.bands):
        raise HueflightError(
            f"the spectra have {dict(spectra.sizes)}, instrument {instrument.name!r} has "
            f"{len(instrument.bands)} bands"
        )
    entries = library.in_bands(instrument)
    angle = spectral_angle(spectra, entries)
    visible = any(400 <= band.wavelength_nm <= 700 for band in instrument.bands)
    to_xyz = bands_to_xyz(instrument) if visible else np.full((3, len(instrument.bands)), np.nan)
    white = tristimulus(NODES_NM, illuminant="C").sum(axis=1)

    def colour(values: xr.DataArray) -> NDArray[np.float64]:
        ordered = values.transpose(..., "band").values
        return lab(np.maximum(ordered, 0) @ to_xyz.T, white=white)

    outer = [dim for dim in spectra.dims if dim != "band"]
    difference = delta_e_2000(colour(spectra)[..., None, :], colour(entries))
    names = np.array(library.names)
    known = angle.notnull().all("entry")
    nearest = angle.fillna(np.inf).argmin("entry")
    found = {
        "angle": angle.transpose(*outer, "entry").assign_attrs(units="rad"),
        "delta_e": ((*outer, "entry"), difference, {"units": "1", "long_name": "CIEDE2000"}),
        "best": (outer, np.where(known, names[nearest.values], "")),
    }
    return xr.Dataset(found)


def bands_to_xyz(instrument: Instrument, *, noise: float = NOISE) -> NDArray[np.float64]:
    """Compute the map from band reflectances to XYZ under CIE illuminant C.

    The spectrum is assumed to be smooth, of unknown level.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose bands are mapped.
    noise : float
        Standard deviation of a band's reflectance. The larger it is, the more the map relies on the
        smoothness.

    Returns
    -------
    ndarray of float, shape (3, band)
        Weights for X, Y and Z; white has Y = 1.
    """
    model = SpectralModel.of(instrument)
    return model.linear(model.to_xyz(illuminant="C"), noise=noise)
