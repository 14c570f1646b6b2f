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
        Rising wavelengths, nm.
    power : ndarray of float, shape (band, wavelength)
        Emitted power in the order of the instrument's bands.
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
        """From the peak and width that the instrument states for each band."""
        return cls(WAVELENGTH_NM, np.array([emission(band) for band in instrument.bands]))

    @classmethod
    def load(cls, path: str | Path, instrument: Instrument, /) -> Emission:
        """From CSV: a heading, then wavelength in nm and one column for each band, in their order.

        Raises
        ------
        CalibrationError
            If it can't be read, or its peaks are not those of the instrument's bands.
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
        """Refuse spectra that are not those of an instrument's bands.

        Raises
        ------
        CalibrationError
            Saying which band does not fit.
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
        """Share of each band's detected photons at evenly spaced wavelengths, (band, node).

        Emitted photons (power × wavelength) × the detector's and lens's probability; light
        beyond the ends goes to them.
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
            blind = instrument.bands[int(np.argmin(totals))].name
            raise CalibrationError(f"band {blind!r}: the detector is blind at its wavelengths")
        return gathered / totals

    def overlap(self, instrument: Instrument, /) -> NDArray[np.float64]:
        """How alike what two bands see is, (band, band): 1 the same light, 0 none in common.

        The cosine between their detected spectra.
        """
        seen = self.shares(instrument)
        length = np.sqrt((seen**2).sum(axis=1))
        return seen @ seen.T / np.outer(length, length)
