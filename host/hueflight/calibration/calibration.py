"""From captures of a known flat target to everything that reconstruction needs to know."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration.defects import find_dead, find_hot, find_hot_in_dark
from hueflight.calibration.windows import PulseWindow, find_windows, window_sums
from hueflight.errors import CalibrationError
from hueflight.histograms import check_histogram, frames_per_pixel
from hueflight.instrument import Instrument
from hueflight.reconstruction.correlation import correlate, peak_centroid
from hueflight.timebins import TimeBins

CENTROID_HALF_WIDTH = 0.9  #: half the centroid's window per FWHM of the pulses; measured best


@dataclass(frozen=True)
class Calibration:
    """What one instrument, in front of a known target, has shown of itself.

    Attributes
    ----------
    instrument : the description it belongs to.
    distance : of the reference target from the camera along the optical axis, m.
    bins : codes in time order, with measured widths where a flat capture was given.
    reference : (row, col, bin) counts of the reference in time order.
    frames : (row, col) exposures behind it, or None where they can't be known.
    windows : which bins belong to which pulse, for a pixel without delay of its own.
    pixel_delay : (row, col) each pixel's delay against the pooled reference, bins.
    gain : (band,) α of eq. 3: reflectance per count and frame of an average pixel.
    flat_field : (row, col) each pixel's brightness relative to the average pixel.
    dead, hot : (row, col) pixels that never, or always, fire.
    provenance : where it came from, for people and files.
    """

    instrument: Instrument
    distance: float
    bins: TimeBins
    reference: NDArray[np.float32]
    frames: NDArray[np.float64] | None
    windows: tuple[PulseWindow, ...]
    pixel_delay: NDArray[np.float64]
    gain: NDArray[np.float64]
    flat_field: NDArray[np.float64]
    dead: NDArray[np.bool_]
    hot: NDArray[np.bool_]
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
    def half_width_bins(self) -> float:
        """Half the window of the correlation's centroid."""
        return centroid_half_width_bins(self.instrument)

    def require(self, instrument: Instrument) -> None:
        """Refuse to be used with another instrument, saying what differs."""
        if differences := self.instrument.differences(instrument):
            raise CalibrationError(
                f"this calibration was made with another instrument ({self.instrument.name!r}, "
                f"not {instrument.name!r}): {'; '.join(differences[:5])}"
                + (f"; and {len(differences) - 5} more" if len(differences) > 5 else "")
                + ". Calibrate again with this instrument"
            )


def calibrate(
    reference: ArrayLike,
    instrument: Instrument,
    /,
    *,
    distance: float,
    reflectance: ArrayLike | None = None,
    dark: ArrayLike | None = None,
    flat: ArrayLike | None = None,
    frames: ArrayLike | None = None,
) -> Calibration:
    """Calibration from a capture of a flat target of known distance and reflectance.

    Parameters
    ----------
    reference : (row, col, code) counts of the target.
    instrument : what made them.
    distance : of the target from the camera, m.
    reflectance : (band,) known reflectance of the target (R_ref of eq. 3), default 1.
    dark : (row, col, code) counts with the LEDs off, to find hot pixels.
    flat : (row, col, code) counts under steady light, to measure the widths of the bins
        (code density).
    frames : exposures behind the reference; by default the sum over codes where the sensor
        reports its empty exposures.

    Raises
    ------
    HistogramError
        If a capture does not fit the instrument or is empty.
    CalibrationError
        If the reference shows no pulses, or distance or reflectance make no sense.
    """
    if not (np.isfinite(distance) and distance >= 0):
        raise CalibrationError(
            f"distance = {distance!r}: must be the target's distance in metres, 0 or more"
        )
    known = _known_reflectance(reflectance, instrument)
    counts = check_histogram(reference, instrument, name="reference")
    exposures = frames_per_pixel(counts, instrument, frames)
    bins = instrument.time_bins()
    if flat is not None:
        flat_counts = check_histogram(flat, instrument, name="flat")
        bins = bins.with_widths(measured_widths(bins.in_time_order(flat_counts), bins))
    light = bins.in_time_order(counts).astype(np.float32)
    photons = light.sum(axis=-1, dtype=np.float64)
    if not photons.any():
        raise CalibrationError(
            "the reference has no light: every frame was empty. Check that the LEDs were armed "
            "and the lens cap is off"
        )
    dead = find_dead(photons)
    pooled, delay, hot = _align(light, instrument, bins, dead)
    if dark is not None:
        dark_counts = check_histogram(dark, instrument, name="dark")
        dark_frames = frames_per_pixel(dark_counts, instrument, None)
        dark_photons = bins.in_time_order(dark_counts).sum(axis=-1, dtype=np.float64)
        if dark_frames is None:
            dark_frames = np.ones_like(dark_photons)
        hot |= find_hot_in_dark(dark_photons, dark_frames) & ~dead
    if (dead | hot).all():
        raise CalibrationError("every pixel of the reference is dead or hot: nothing to calibrate")

    windows = find_windows(pooled, instrument, bins, distance=distance)
    gain, flat_field = _gains(
        light, windows, delay, ~(dead | hot), exposures, known, circular=bins.period_ns is not None
    )
    return Calibration(
        instrument=instrument,
        distance=float(distance),
        bins=bins,
        reference=light,
        frames=exposures,
        windows=windows,
        pixel_delay=delay,
        gain=gain,
        flat_field=flat_field,
        dead=dead,
        hot=hot,
        provenance={
            "reference_photons": int(photons.sum()),
            "reference_frames": None if exposures is None else int(np.median(exposures)),
            "dark": dark is not None,
            "flat": flat is not None,
            "reflectance": known.tolist(),
        },
    )


def centroid_half_width_bins(instrument: Instrument) -> float:
    """Half the window of a correlation peak's centroid: as wide as pulses, within the train.

    10 ns for the paper's pulses. Wider windows take in background and the neighbours' feet,
    narrower ones leave light out.
    """
    fwhm_ns = float(np.median([band.pulse_fwhm_ns for band in instrument.bands]))
    widest_ns = min(CENTROID_HALF_WIDTH * fwhm_ns, instrument.half_spacing_ns())
    return widest_ns / instrument.sensor.bin_width_ns


def measured_widths(flat: NDArray[Any], bins: TimeBins) -> NDArray[np.float64]:
    """Widths (bin,) in ns from counts (…, bin) under steady light: the code-density test.

    Under light that is flat in time a bin's share of the counts is its share of the period
    (IEEE Std 1241, histogram test).
    """
    density = flat.reshape(-1, flat.shape[-1]).sum(axis=0, dtype=np.float64)
    if density.sum() < 100 * density.size:
        raise CalibrationError(
            f"the flat capture holds {density.sum():.0f} photons; at least "
            f"{100 * density.size} are needed to measure {density.size} bins: capture longer"
        )
    return density / density.sum() * bins.span_ns


def _known_reflectance(
    reflectance: ArrayLike | None, instrument: Instrument
) -> NDArray[np.float64]:
    bands = len(instrument.bands)
    known = np.broadcast_to(np.asarray(1.0 if reflectance is None else reflectance, float), bands)
    if not (np.isfinite(known).all() and (known > 0).all()):
        raise CalibrationError(
            f"reflectance = {known.tolist()}: must be above 0 in each of the {bands} bands"
        )
    return known


def _align(
    light: NDArray[np.float32], instrument: Instrument, bins: TimeBins, dead: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Pooled train (bin,), each pixel's delay against it in bins (row, col), and hot pixels.

    Twice: the first pool is blurred by the pixels' delays and holds the hot pixels' light.
    """
    half_spacing = min(instrument.half_spacing_ns(), bins.span_ns / 4)
    search = max(1, int(half_spacing / instrument.sensor.bin_width_ns))
    half_width = min(centroid_half_width_bins(instrument), float(search))
    weight = (~dead).astype(np.float64)
    aligned = light
    delay = np.zeros(dead.shape)
    hot = np.zeros_like(dead)
    for _ in range(2):
        # every pixel weighs alike, so that a hot one can't take the pool over
        share = weight / np.maximum(aligned.sum(axis=-1, dtype=np.float64), 1)
        pooled = np.einsum("rc,rcb->b", share, aligned)
        for row in range(light.shape[0]):
            lags = correlate(light[row], pooled, search + int(np.ceil(half_width)))
            delay[row] = peak_centroid(lags, search=search, half_width=half_width)
        delay -= np.median(delay[~(dead | hot)]) if (~(dead | hot)).any() else 0.0
        aligned = _shift_bins(light, -np.rint(delay).astype(np.intp))
        hot = find_hot(aligned, pooled, dead)
        weight = (~(dead | hot)).astype(np.float64)
    delay[dead | hot] = 0.0
    pooled = np.einsum("rc,rcb->b", weight, aligned, dtype=np.float64)
    return pooled, delay, hot


def _shift_bins(light: NDArray[np.float32], shift: NDArray[np.intp]) -> NDArray[np.float32]:
    """Each pixel's bins moved later by its own whole number, around the circle."""
    shifted = np.empty_like(light)
    for amount in np.unique(shift):
        chosen = shift == amount
        shifted[chosen] = np.roll(light[chosen], int(amount), axis=-1)
    return shifted


def _gains(
    light: NDArray[np.float32],
    windows: tuple[PulseWindow, ...],
    delay: NDArray[np.float64],
    usable: NDArray[np.bool_],
    frames: NDArray[np.float64] | None,
    reflectance: NDArray[np.float64],
    *,
    circular: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """α per band (eq. 3) and the flat field (row, col), mean 1 over usable pixels.

    α uses the mean over all pixels, the flat field the sum over all bands: either is measured
    with far more photons than one pixel has in one band.
    """
    sums = np.empty((reflectance.size, *delay.shape))
    for row in range(light.shape[0]):
        shift = np.rint(delay[row]).astype(np.intp)
        sums[:, row] = window_sums(
            light[row], windows, shift, bands=reflectance.size, circular=circular
        )
    per_frame: NDArray[np.float64] = sums if frames is None else sums / frames
    total = np.asarray(per_frame.sum(axis=0))
    flat_field = np.where(usable, total / total[usable].mean(), np.nan)
    mean = np.array([(band[usable] / flat_field[usable]).mean() for band in per_frame])
    if (mean <= 0).any():
        dark_bands = np.flatnonzero(mean <= 0).tolist()
        raise CalibrationError(
            f"the reference shows no light in band(s) {dark_bands}: check those LEDs"
        )
    return reflectance / mean, flat_field
