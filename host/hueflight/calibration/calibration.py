"""What one instrument, in front of a known target, has shown of itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration.delays import centroid_half_width_bins
from hueflight.calibration.pulse_windows import PulseWindow
from hueflight.errors import CalibrationError
from hueflight.model.emission import Emission
from hueflight.model.instrument import Instrument
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates


@dataclass(frozen=True, eq=False)
class Calibration:
    """All that reconstruction knows of an instrument. Made by `calibrate`, kept by `save`.

    Attributes
    ----------
    instrument : the description it belongs to.
    distance : of the reference target from the camera along the optical axis, m.
    bins : codes in time order, with measured widths where a flat capture was given.
    reference : (row, col, bin) counts of the reference in time order.
    frames : (row, col) exposures behind it, or None where they can't be known.
    windows : which bins belong to which pulse, for a pixel without delay of its own.
    pixel_delay_ns : (row, col) each pixel's delay against the pooled reference.
    pixel_delay_std_ns : (row, col) how well that is known.
    gain : (band,) α of eq. 3: reflectance per count and frame of an average pixel. Here and
        below counts are of photons that arrived, those that an exposure lost included.
    templates : waveform of each band, pooled over pixels.
    brightness : (band,) photons per frame from a white target at the reference's distance in
        an average pixel (per capture where frames can't be known).
    flat_field : (row, col) each pixel's brightness relative to the average pixel.
    dead, hot : (row, col) pixels that never, or always, fire.
    emission : measured spectra of the LEDs, or None for those that the instrument states.
    provenance : where it came from, for people and files.
    """

    instrument: Instrument
    distance: float
    bins: TimeBins
    reference: NDArray[np.float32]
    frames: NDArray[np.float64] | None
    windows: tuple[PulseWindow, ...]
    pixel_delay_ns: NDArray[np.float64]
    pixel_delay_std_ns: NDArray[np.float64]
    gain: NDArray[np.float64]
    templates: Templates
    brightness: NDArray[np.float64]
    flat_field: NDArray[np.float64]
    dead: NDArray[np.bool_]
    hot: NDArray[np.bool_]
    emission: Emission | None = None
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(row, col) pixels that are neither dead nor hot."""
        return ~(self.dead | self.hot)

    @property
    def bin_width_ns(self) -> float:
        """Mean width of a full bin."""
        return self.instrument.sensor.bin_width_ns

    @property
    def pixel_delay(self) -> NDArray[np.float64]:
        """(row, col) `pixel_delay_ns` in mean bins, for methods that count bins."""
        return self.pixel_delay_ns / (self.bins.span_ns / self.bins.count)

    @property
    def half_width_bins(self) -> float:
        """Half the window of the correlation's centroid."""
        return centroid_half_width_bins(self.instrument)

    def require(self, instrument: Instrument) -> None:
        """Refuse to be used with another instrument, saying what differs.

        Raises
        ------
        CalibrationError
            If anything that counts depend on is not the same.
        """
        if differences := self.instrument.differences(instrument):
            raise CalibrationError(
                f"this calibration was made with another instrument ({self.instrument.name!r}, "
                f"not {instrument.name!r}): {'; '.join(differences[:5])}"
                + (f"; and {len(differences) - 5} more" if len(differences) > 5 else "")
                + ". Calibrate again with this instrument"
            )

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write to a Zarr directory store; it appears under its name only when whole.

        Raises
        ------
        CalibrationError
            If the name is taken and `overwrite` is not set, or the disk refuses.
        """
        from hueflight.calibration.store import save  # it needs this class

        save(self, Path(path), overwrite=overwrite)

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Read what `save` wrote.

        Raises
        ------
        CalibrationError
            If there is nothing, it is no calibration, of another format, or damaged.
        """
        from hueflight.calibration.store import load  # it needs this class

        return load(Path(path))
