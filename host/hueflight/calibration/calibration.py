# SPDX-License-Identifier: Apache-2.0
"""The result of calibrating one instrument in front of a known target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.arguments import PATH, SWITCH, takes
from hueflight.calibration.delays import centroid_half_width_bins
from hueflight.calibration.store import (
    REFERENCE,
    DeferredReference,
    StoredCalibration,
    describe,
    read_store,
    write_store,
)
from hueflight.calibration.windows import PulseWindow
from hueflight.errors import CalibrationError, InstrumentError
from hueflight.files.ages import age
from hueflight.model.emission import Emission
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.instrument_text import facts_html
from hueflight.model.pileup import lost_photons_factor
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates

PIXEL_PLANES = ("pixel_delay_ns", "pixel_delay_std_ns", "flat_field", "dead", "hot")
BAND_VECTORS = ("gain", "brightness")
#: not in calibrations of versions that did not state them
NOISE_PLANES = ("flat_field_std",)
NOISE_VECTORS = ("brightness_std", "waveform_delay_std_ns")
FEWEST_EXPOSURES = 1e-30  #: fewer are none


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """What reconstruction needs to know about an instrument.

    Made by `calibrate`, written by `save`. Counts mean photons that arrived, including those
    that were lost because an exposure records only one.

    Attributes
    ----------
    instrument : Instrument
        The instrument that was calibrated.
    distance : float
        Distance of the reference target from the camera along the optical axis, m.
    bins : TimeBins
        Codes in time order, with measured widths where a flat capture was given.
    reference : ndarray of float32, shape (row, col, bin)
        Counts of the reference in time order. Large ones of a loaded calibration are read from disk
        when they are first used; the joint fit uses their sums at most.
    frames : ndarray of float, shape (row, col), or None
        Exposures behind the reference, None where their number can't be known.
    windows : tuple of PulseWindow
        Which bins belong to which pulse, for a pixel without a delay of its own.
    pixel_delay_ns : ndarray of float, shape (row, col)
        Delay of each pixel relative to the pooled reference, ns.
    pixel_delay_std_ns : ndarray of float, shape (row, col)
        Standard deviation of that delay, ns.
    gain : ndarray of float, shape (band,)
        Coefficient α of the paper's eq. 3: reflectance per count and frame of an average pixel.
    templates : Templates
        Waveform of each band, pooled over pixels.
    brightness : ndarray of float, shape (band,)
        Photons per frame from a white target at the reference's distance in an average pixel
        (photons per capture where frames can't be known).
    flat_field : ndarray of float, shape (row, col)
        Brightness of each pixel relative to the average pixel.
    dead, hot : ndarray of bool, shape (row, col)
        Pixels that never fire, and pixels that fire whatever the light.
    flat_field_std : ndarray of float, shape (row, col), or None
        Standard deviation of `flat_field`; None where an earlier version calibrated.
    brightness_std : ndarray of float, shape (band,), or None
        Standard deviation of `brightness`; None likewise.
    waveform_delay_std_ns : ndarray of float, shape (band,), or None
        Standard deviation of the place of each waveform in time; None likewise.
    emission : Emission or None
        Measured spectra of the LEDs; None where those of the instrument apply.
    provenance : dict
        When, from what and with which software the calibration was made.
    """

    instrument: Instrument
    distance: float
    bins: TimeBins
    # one object for all calibrations, as of every descriptor: it keeps the counts in each of them
    reference: DeferredReference = DeferredReference()  # noqa: RUF009
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
    flat_field_std: NDArray[np.float64] | None = None
    brightness_std: NDArray[np.float64] | None = None
    waveform_delay_std_ns: NDArray[np.float64] | None = None
    emission: Emission | None = None
    provenance: dict[str, Any] = field(default_factory=dict)

    def facts(self) -> dict[str, Any]:
        """List what matters of the calibration, for a screen.

        Returns
        -------
        dict
            Instrument, distance, light and defects, as plain values.
        """
        delays_ns, known = self.pixel_delay_ns[self.usable], self.pixel_delay_std_ns[self.usable]
        light = ", ".join(
            f"{band.name} {value:.3g}"
            for band, value in zip(self.instrument.bands, self.brightness, strict=True)
        )
        made = {
            key: self.provenance[key] for key in ("created", "software") if key in self.provenance
        }
        if "created" in made:
            made["created"] = f"{made['created']} ({age(made['created'])})"
        return {
            "instrument": f"{self.instrument.name} ({self.instrument.fingerprint()})",
            "pixels": f"{self.usable.shape[0]} rows, {self.usable.shape[1]} columns; "
            f"{int(self.dead.sum())} dead, {int(self.hot.sum())} hot",
            "distance_m": self.distance or "not known",
            "bins": f"{self.bins.count} of {self.bin_width_ns:g} ns",
            "pixel_delays_ns": f"over {np.ptp(delays_ns):.3g}, ± {np.median(known):.2g}",
            f"photons_per_{'capture' if self.frames is None else 'frame'}": light,
            **made,
        }

    def __repr__(self) -> str:
        lines = [f"  {key}: {value}" for key, value in self.facts().items()]
        return "\n".join([f"<Calibration of {self.instrument.name!r}>", *lines])

    def _repr_html_(self) -> str:
        return facts_html(f"Calibration of {self.instrument.name}", self.facts())

    def reference_blocks(self) -> Iterator[NDArray[np.float32]]:
        """Give the counts of the reference in runs of rows, from disk if they are still there.

        Yields
        ------
        ndarray of float32, shape (row, col, bin)
            The next rows; all of them together are `reference`.
        """
        yield from DeferredReference.blocks(self)

    @cached_property
    def reference_photons(self) -> NDArray[np.float64]:
        """Photons of each pixel of the reference, shape (row, col)."""
        rows = [block.sum(axis=-1, dtype=np.float64) for block in self.reference_blocks()]
        return np.concatenate(rows)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Pixels that are neither dead nor hot, shape (row, col)."""
        return ~(self.dead | self.hot)

    @cached_property
    def meters_per_ns(self) -> NDArray[np.float64]:
        """Depth along the optical axis per time of flight, m/ns, shape (row, col)."""
        return SPEED_OF_LIGHT_M_PER_NS / 2 * self.instrument.ray_cosine()

    @cached_property
    def instrument_fingerprint(self) -> str:
        """Digest of the instrument; see `Instrument.fingerprint`."""
        return self.instrument.fingerprint()

    @property
    def bin_width_ns(self) -> float:
        """Nominal width of a bin, ns."""
        return self.instrument.sensor.bin_width_ns

    @property
    def pixel_delay(self) -> NDArray[np.float64]:
        """Delay of each pixel in bins of mean width, shape (row, col)."""
        return self.pixel_delay_ns / (self.bins.span_ns / self.bins.count)

    @property
    def half_width_bins(self) -> float:
        """Half the width of the window of the correlation's centroid, bins."""
        return centroid_half_width_bins(self.instrument)

    def photon_scale(
        self,
        photons: NDArray[np.float64],
        exposures: NDArray[np.float64] | None,
        *,
        pileup_correction: bool,
    ) -> NDArray[np.float64]:
        """Return the factor from a pixel's photons to photons per exposure of an average pixel.

        Times the gain of a band it makes reflectance.

        Parameters
        ----------
        photons : ndarray of float, shape (row, col)
            Counts of each pixel.
        exposures : ndarray of float, shape (row, col), or None
            Exposures behind them; None to assume as many as the reference had.
        pileup_correction : bool
            Undo the loss of photons after the first one of an exposure.

        Returns
        -------
        ndarray of float, shape (row, col)
            The factor; NaN without exposures.
        """
        if self.frames is None:
            return 1 / self.flat_field
        if exposures is None:
            exposures = self.frames
        # weighted counts may come near 0, where the factor is not known
        known = np.where(exposures > FEWEST_EXPOSURES, exposures, np.nan)
        scale = 1 / (self.flat_field * known)
        if pileup_correction:
            return scale * lost_photons_factor(photons, exposures)
        # the calibration is in photons that arrived: take the loss back
        return scale * lost_photons_factor(self.reference_photons, self.frames)

    def require(self, instrument: Instrument) -> None:
        """Check that counts of an instrument can be reconstructed with this calibration.

        Parameters
        ----------
        instrument : Instrument
            The instrument that made the counts.

        Raises
        ------
        CalibrationError
            If anything that counts depend on differs from the calibrated instrument.
        """
        if differences := self.instrument.differences(instrument):
            raise CalibrationError(
                f"this calibration was made with another instrument ({self.instrument.name!r}, "
                f"not {instrument.name!r}): {'; '.join(differences[:5])}"
                + (f"; and {len(differences) - 5} more" if len(differences) > 5 else "")
                + ". Calibrate again with this instrument"
            )

    @takes(path=PATH, overwrite=SWITCH)
    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a Zarr directory, which appears under its name only when it is complete.

        Parameters
        ----------
        path : str or Path
            Name of the directory; folders above it are made as needed.
        overwrite : bool
            Replace what exists under that name.

        Raises
        ------
        OutputExistsError
            If the name is taken and `overwrite` is not set.
        OutputError
            If the disk refuses.
        """
        write_store(Path(path), _to_stored(self), overwrite=overwrite)

    @classmethod
    @takes(path=PATH)
    def load(cls, path: str | Path) -> Calibration:
        """Read what `save` wrote.

        Parameters
        ----------
        path : str or Path
            Name of the directory.

        Returns
        -------
        Calibration
            The calibration, whose checksums were verified.

        Raises
        ------
        CalibrationNotFoundError
            If there is no such directory.
        CalibrationError
            If it is not a calibration, has a newer format, or is damaged.
        """
        stored = read_store(Path(path))
        try:
            return _from_stored(stored)
        except (CalibrationError, InstrumentError) as error:
            raise CalibrationError(f"calibration {path} can't be used: {error}") from None
        except Exception as error:  # missing arrays, ill-typed attributes
            raise CalibrationError(
                f"calibration {path} is damaged: {describe(error)}. Restore it or calibrate again"
            ) from None


def _to_stored(calibration: Calibration) -> StoredCalibration:
    arrays: dict[str, NDArray[Any]] = {
        name: getattr(calibration, name) for name in PIXEL_PLANES + BAND_VECTORS
    }
    for name in NOISE_PLANES + NOISE_VECTORS:
        if getattr(calibration, name) is not None:
            arrays[name] = getattr(calibration, name)
    arrays["reference"] = calibration.reference
    arrays["bin_edges_ns"] = calibration.bins.edges_ns
    arrays["bin_codes"] = calibration.bins.codes.astype(np.int64)
    arrays["templates"] = calibration.templates.coefficients
    arrays["windows"] = np.array(
        [(window.band, window.start, window.stop) for window in calibration.windows], np.int64
    )
    if calibration.frames is not None:
        arrays["frames"] = np.asarray(calibration.frames)
    if calibration.emission is not None:
        arrays["emission_nm"] = calibration.emission.wavelengths_nm
        arrays["emission_power"] = calibration.emission.power
    instrument = calibration.instrument
    return StoredCalibration(
        arrays,
        {
            "saved": datetime.now(UTC).isoformat(timespec="seconds"),
            "saved_by": f"hueflight {version('hueflight')}",
            "instrument": instrument.to_json(),
            "instrument_name": instrument.name,
            "instrument_fingerprint": instrument.fingerprint(),
            "distance_m": calibration.distance,
            "circle_ns": calibration.templates.circle_ns,
            "provenance": calibration.provenance,
        },
    )


def _from_stored(stored: StoredCalibration) -> Calibration:
    attributes: Mapping[str, Any] = stored.attributes
    arrays: Mapping[str, Any] = stored.arrays
    instrument = Instrument.from_json(attributes["instrument"], where="its instrument")
    if instrument.fingerprint() != attributes["instrument_fingerprint"]:
        raise CalibrationError(
            "its instrument does not match its fingerprint: the file was edited, or written by "
            "software that describes instruments otherwise"
        )
    bins = TimeBins(
        arrays["bin_codes"].astype(np.intp), arrays["bin_edges_ns"], instrument.timing.period_ns
    )
    rows, cols, _ = instrument.histogram_shape
    expected = {
        REFERENCE: (rows, cols, bins.count),
        "bin_edges_ns": (bins.count + 1,),
        **dict.fromkeys(BAND_VECTORS, (len(instrument.bands),)),
        **dict.fromkeys(PIXEL_PLANES, (rows, cols)),
    }
    noise = dict.fromkeys(NOISE_PLANES, (rows, cols))
    noise |= dict.fromkeys(NOISE_VECTORS, (len(instrument.bands),))
    expected |= {name: shape for name, shape in noise.items() if name in arrays}
    values = {name: arrays[name] for name in expected}
    for name, shape in expected.items():
        if values[name].shape != shape:
            raise CalibrationError(f"{name} has shape {values[name].shape}, expected {shape}")
    del values["bin_edges_ns"]
    emission = None
    if "emission_nm" in arrays:
        emission = Emission(arrays["emission_nm"], arrays["emission_power"])
        emission.require(instrument)
    return Calibration(
        instrument=instrument,
        distance=float(attributes["distance_m"]),
        bins=bins,
        frames=arrays.get("frames"),
        windows=tuple(PulseWindow(*map(int, window)) for window in arrays["windows"]),
        templates=Templates(arrays["templates"], float(attributes["circle_ns"])),
        emission=emission,
        provenance=dict(attributes["provenance"]),
        **values,
    )
