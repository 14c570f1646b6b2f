# SPDX-License-Identifier: Apache-2.0
"""Emission spectra of the LEDs, measured or nominal, and how far they overlap."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import CalibrationError
from hueflight.model.instrument import Instrument
from hueflight.model.spectra import WAVELENGTH_NM, detection, emission

FARTHEST_PEAK_NM = 30.0  #: a measured peak that is farther off belongs to another LED


@dataclass(frozen=True, eq=False)
class Emission:
    """Emitted power of each LED over wavelength, in any unit.

    Attributes
    ----------
    wavelengths_nm : ndarray of float, shape (wavelength,)
        Wavelengths in ascending order, nm.
    power : ndarray of float, shape (band, wavelength)
        Emitted power, in the order of the instrument's bands. Only its shape over wavelength
        matters, so each row may have a scale of its own.
    """

    wavelengths_nm: NDArray[np.float64]
    power: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.power.ndim != 2 or self.power.shape[1:] != self.wavelengths_nm.shape:
            raise CalibrationError(
                f"emission: power has shape {self.power.shape}; it must be (band, wavelength) "
                f"with {self.wavelengths_nm.size} wavelengths"
            )
        if self.wavelengths_nm.size < 2 or not (np.diff(self.wavelengths_nm) > 0).all():
            raise CalibrationError("emission: wavelengths must rise from line to line")
        if not np.isfinite(self.power).all() or (self.power < 0).any():
            raise CalibrationError("emission: every power must be a number, 0 or more")
        if not self.power.any(axis=1).all():
            dark = np.flatnonzero(~self.power.any(axis=1)).tolist()
            raise CalibrationError(f"emission: band(s) {dark} emit nothing")

    @classmethod
    def nominal(cls, instrument: Instrument, /) -> Emission:
        """Compute spectra from the peak and width that the instrument states for each band.

        Parameters
        ----------
        instrument : Instrument
            Instrument whose `Band.wavelength_nm` and `Band.spectral_fwhm_nm` are used.

        Returns
        -------
        Emission
            One spectrum for each band, in the shape that `hueflight.model.spectra.emission` gives.
        """
        return cls(WAVELENGTH_NM, np.array([emission(band) for band in instrument.bands]))

    @classmethod
    def load(cls, path: str | Path, instrument: Instrument, /) -> Emission:
        """Read measured spectra from a CSV file.

        The first line is a heading. Each further line holds a wavelength in nm and the power of
        every LED at that wavelength, one column for each band in the order of the instrument.

        Parameters
        ----------
        path : str or Path
            Name of the file.
        instrument : Instrument
            Instrument whose LEDs were measured.

        Returns
        -------
        Emission
            The spectra.

        Raises
        ------
        CalibrationError
            If the file can't be read, or its peaks are not those of the instrument's bands.
        """
        path = Path(path)
        try:
            rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
        except (OSError, UnicodeDecodeError) as error:
            raise CalibrationError(f"can't read emission spectra {str(path)!r}: {error}") from None
        width = len(instrument.bands) + 1
        table = np.empty((max(len(rows) - 1, 0), width))
        for number, row in enumerate(rows[1:]):
            try:
                table[number] = [float(entry) for entry in row]
            except ValueError:
                raise CalibrationError(
                    f"emission spectra {str(path)!r}, line {number + 2}: needs {width} numbers, a "
                    f"wavelength and one for each band; it holds {row}"
                ) from None
        found = cls(table[:, 0], table[:, 1:].T.copy())
        found.require(instrument)
        return found

    def require(self, instrument: Instrument) -> None:
        """Check that the spectra belong to the bands of an instrument.

        Parameters
        ----------
        instrument : Instrument
            Instrument that the spectra are to be used with.

        Raises
        ------
        CalibrationError
            If the number of bands differs, or a spectrum peaks more than 30 nm from its band's
            wavelength; the message names that band.
        """
        if len(self.power) != len(instrument.bands):
            raise CalibrationError(
                f"emission spectra of {len(self.power)} LEDs; instrument {instrument.name!r} has "
                f"{len(instrument.bands)} bands"
            )
        peaks_nm = self.wavelengths_nm[self.power.argmax(axis=1)]
        for band, peak_nm in zip(instrument.bands, peaks_nm, strict=True):
            if abs(peak_nm - band.wavelength_nm) > FARTHEST_PEAK_NM:
                raise CalibrationError(
                    f"band {band.name!r} is at {band.wavelength_nm:g} nm, its emission spectrum "
                    f"peaks at {peak_nm:g} nm: columns must stand in the instrument's order"
                )

    def shares(
        self, instrument: Instrument, nodes_nm: NDArray[np.floating] = WAVELENGTH_NM
    ) -> NDArray[np.float64]:
        """Compute the share of each band's detected photons at evenly spaced wavelengths.

        The detected spectrum is the number of emitted photons (power times wavelength) times the
        probability that lens and detector register them. Light beyond the first or last node is
        counted there.

        Parameters
        ----------
        instrument : Instrument
            Instrument that detects the light.
        nodes_nm : ndarray of float, shape (node,)
            Evenly spaced wavelengths, nm.

        Returns
        -------
        ndarray of float, shape (band, node)
            Shares; each row sums to 1.

        Raises
        ------
        CalibrationError
            If the spectra are not those of the instrument, or it detects nothing of a band.
        """
        self.require(instrument)
        sensed = self.power * self.wavelengths_nm * detection(instrument, self.wavelengths_nm)
        sensed = sensed * np.gradient(self.wavelengths_nm)
        step_nm = nodes_nm[1] - nodes_nm[0]
        place = np.clip((self.wavelengths_nm - nodes_nm[0]) / step_nm, 0, len(nodes_nm) - 1)
        lower = np.minimum(place.astype(np.intp), len(nodes_nm) - 2)
        upper_share = place - lower
        gathered = np.zeros((len(sensed), len(nodes_nm)))
        for band, light in enumerate(sensed):
            np.add.at(gathered[band], lower, light * (1 - upper_share))
            np.add.at(gathered[band], lower + 1, light * upper_share)
        totals = gathered.sum(axis=1, keepdims=True)
        if not (totals > 0).all():
            unseen = instrument.bands[int(np.argmin(totals))].name
            raise CalibrationError(f"band {unseen!r}: the detector registers no light there")
        return gathered / totals

    def overlap(self, instrument: Instrument, /) -> NDArray[np.float64]:
        """Compute how similar the detected spectra of every two bands are.

        Parameters
        ----------
        instrument : Instrument
            Instrument that detects the light.

        Returns
        -------
        ndarray of float, shape (band, band)
            Cosine between the detected spectra: 1 for the same spectrum, 0 for two without a common
            wavelength.
        """
        seen = self.shares(instrument)
        length = np.sqrt((seen**2).sum(axis=1))
        return seen @ seen.T / np.outer(length, length)
