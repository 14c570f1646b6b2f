# SPDX-License-Identifier: Apache-2.0
"""The calibration procedure: from captures of a known flat target to a `Calibration`."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.arguments import COUNTS, NUMBER, NUMBERS, takes
from hueflight.calibration.calibration import Calibration
from hueflight.calibration.defects import find_dead, find_hot_in_dark
from hueflight.calibration.delays import align, refined_delays
from hueflight.calibration.empirical_bayes import shrink_to_line_means
from hueflight.calibration.noise import correction_noise, waveform_noise
from hueflight.calibration.pulse_train_fit import OVERLAPPING_SHARE, overlap_widely
from hueflight.calibration.pulse_windows import find_windows
from hueflight.calibration.waveform_estimation import (
    TrainModel,
    brightness_of,
    fit_overlapping_pulses,
    templates_from_bands,
    templates_from_train,
)
from hueflight.calibration.windows import PulseWindow, window_sums
from hueflight.errors import CalibrationError, OverlappingBandsError
from hueflight.memory import require_memory, within_memory
from hueflight.model.emission import Emission
from hueflight.model.histograms import check_histogram, frames_per_pixel
from hueflight.model.instrument import Instrument
from hueflight.model.pileup import coates_correction, lost_photons_factor, photons_per_period
from hueflight.model.time_bins import TimeBins
from hueflight.model.undersampling import smooth_undersampled
from hueflight.model.waveforms import Templates

LEAST_LIGHT = 3.0  #: standard deviations by which the light of a band must be above 0
HOT_IN_FLAT = 2.0  #: times the median count under steady light that only a hot pixel reaches

CAPTURES_AT_ONCE = 2.5  #: copies of the reference as float32 in memory, measured
FEWER_COUNTS = "Describe and calibrate a part of the sensor, or sum neighboring codes to wider bins"


@within_memory("the calibration", advice=FEWER_COUNTS)
@takes(
    reference=COUNTS,
    instrument=Instrument,
    distance=NUMBER,
    bands=COUNTS,
    reflectance=NUMBERS,
    dark=COUNTS,
    flat=COUNTS,
    frames=NUMBERS,
    emission=Emission,
)
def calibrate(
    reference: ArrayLike,
    instrument: Instrument,
    /,
    *,
    distance: float,
    bands: ArrayLike | None = None,
    reflectance: ArrayLike | None = None,
    dark: ArrayLike | None = None,
    flat: ArrayLike | None = None,
    frames: ArrayLike | None = None,
    emission: Emission | None = None,
) -> Calibration:
    """Calibrate an instrument from captures of a flat target of known distance and reflectance.

    Put a flat, matt target in front of the camera, perpendicular to the optical axis, let it fill
    the image, measure its distance with a tape measure, and record it with all LEDs on: this is
    `reference`, all that is required. Everything else improves the result: one capture per LED is
    the best addition where pulses overlap; a capture in the dark finds more hot pixels; a capture
    under steady light measures the widths of the bins; measured emission spectra make colours more
    accurate.

    Parameters
    ----------
    reference : array_like, shape (row, col, code)
        Counts of the target with all LEDs on.
    instrument : Instrument
        The instrument that made all captures.
    distance : float
        Distance of the target from the camera along the optical axis, m.
    bands : array_like or None, shape (band, row, col, code)
        Counts of the same target with one LED on at a time, in the order of the instrument's bands;
        each capture may have any length. Without it the waveforms are separated from `reference`,
        with more uncertainty where pulses overlap.
    reflectance : array_like or None
        Known reflectance of the target (R_ref of the paper's eq. 3), one number or one for each
        band; None for 1. All reflectances that are reconstructed later scale with it.
    dark : array_like or None, shape (row, col, code)
        Counts with the LEDs off, to find hot pixels.
    flat : array_like or None, shape (row, col, code)
        Counts under light that is steady in time, to measure the widths of the bins (code-density
        test); at least 100 photons per bin over all pixels.
    frames : array_like or None
        Exposures behind `reference`, one number or an array (row, col); None to take the sum over
        codes, where the sensor reports its empty exposures. Without this number photons that were
        lost to pile-up can't be corrected.
    emission : Emission or None
        Measured spectra of the LEDs (`Emission.load`), for colours and spectra; None for those that
        the instrument states.

    Returns
    -------
    Calibration
        What `hueflight.reconstruct` needs besides the counts. Keep it with `Calibration.save`: it
        holds for every capture until the instrument or its settings change.

    Raises
    ------
    HistogramError
        If a capture does not fit the instrument, or is empty.
    CalibrationError
        If a capture does not show the pulses that it should, if every pixel is dead, hot or
        saturated, or if a number makes no sense; the message says what to check.
    OverlappingBandsError
        If pulses overlap widely and a band shows no light of its own, or its brightness is not
        known to 20 %.
    MemoryLimitError
        If the work would take more memory than `hueflight.memory.limit_bytes`.

    See Also
    --------
    Calibration : The result, field by field.
    measured_widths : The code-density test.

    Notes
    -----
    Dead and hot pixels are found first. A correlation with the pooled pulse train then gives each
    pixel's delay, which a maximum-likelihood fit refines and empirical Bayes frees from noise.
    Windows grow from each pulse's peak (paper, section 2), and the sums in them give the gains α of
    the paper's eq. 3 and the flat field. Waveforms are periodic splines fitted to all pixels
    together. Losses to pile-up are corrected throughout (Coates, J. Phys. E 1, 878, 1968).

    Examples
    --------
    >>> import hueflight as hf
    >>> from hueflight.simulator import simulate_capture
    >>> paper = hf.Instrument.load("paper")
    >>> target = simulate_capture("reference", paper, frames=20_000, seed=1)
    >>> calibration = hf.calibrate(target, paper, distance=0.40)
    >>> calibration.gain.shape == (len(paper.bands),)
    True
    """
    if not (np.isfinite(distance) and distance >= 0):
        raise CalibrationError(
            f"distance = {distance!r}: must be the target's distance in metres, 0 or more"
        )
    if emission is not None:
        emission.require(instrument)
    known = _known_reflectance(reflectance, instrument)
    counts = check_histogram(reference, instrument, name="reference")
    exposures = frames_per_pixel(counts, instrument, frames)
    bins = instrument.time_bins()
    if flat is not None:
        bins = bins.with_widths(measured_widths(_steady_light(flat, instrument, bins), bins))
    _require_memory(instrument, bins, separate=bands is not None)
    light = bins.in_time_order(counts).astype(np.float32)
    photons = light.sum(axis=-1, dtype=np.float64)
    if not photons.any():
        raise CalibrationError(
            "the reference has no light: every frame was empty. Check that the LEDs were armed "
            "and the lens cap is off"
        )
    dead = find_dead(photons)
    pooled, delay, hot = align(light, instrument, bins, dead)
    if dark is not None:
        hot |= _hot_in_dark(dark, instrument, bins) & ~dead
    usable = ~(dead | hot)
    if not usable.any():
        raise CalibrationError("every pixel of the reference is dead or hot: nothing to calibrate")

    windows = find_windows(pooled, instrument, bins, distance=distance)
    arrived = _arrived(light, exposures, instrument)
    circular = bins.period_ns is not None
    shape_noise, total_noise = correction_noise(photons, exposures, instrument)
    gain, flat_field, flat_field_std = _gains(
        arrived,
        windows,
        delay,
        usable,
        exposures,
        known,
        total_noise,
        instrument,
        circular=circular,
    )
    arrived = smooth_undersampled(arrived, instrument, bins)
    captures = None
    if bands is not None:
        captures = smooth_undersampled(_band_captures(bands, instrument, bins), instrument, bins)

    delay_ns = np.where(usable, delay, 0.0) * (bins.span_ns / bins.count)
    model: TrainModel = ([], 0.0)
    if captures is None:
        model = fit_overlapping_pulses(arrived, delay_ns, usable, windows, instrument, bins)

    def waveforms(delay_ns: NDArray[np.float64]) -> Templates:
        if captures is not None:
            return templates_from_bands(captures, delay_ns, usable, windows, instrument, bins)
        return templates_from_train(arrived, delay_ns, usable, windows, model, instrument, bins)

    delay_ns, delay_std_ns = refined_delays(
        arrived, delay_ns, usable, waveforms(delay_ns), instrument, bins, noise=shape_noise
    )
    templates = waveforms(delay_ns)
    brightness, background = brightness_of(arrived, delay_ns, usable, templates, bins)
    pixels = np.count_nonzero(usable)
    waveform_std_ns, brightness_std = waveform_noise(
        brightness * pixels,
        np.full(known.size, background * pixels),
        templates,
        bins,
        together=True,
    )
    brightness_std *= np.sqrt(total_noise[usable].mean()) / pixels
    waveform_std_ns *= np.sqrt(shape_noise[usable].mean())
    _require_light(brightness, brightness_std, instrument)
    if captures is not None:
        waveform_std_ns = _noise_of_captures(captures, delay_ns, usable, templates, bins)
    if exposures is not None:
        brightness = brightness / exposures[usable].mean()
        brightness_std = brightness_std / exposures[usable].mean()
    return Calibration(
        instrument=instrument,
        distance=float(distance),
        bins=bins,
        reference=light,
        frames=exposures,
        windows=windows,
        pixel_delay_ns=delay_ns,
        pixel_delay_std_ns=delay_std_ns,
        gain=gain,
        templates=templates,
        brightness=brightness / known,
        flat_field=flat_field,
        dead=dead,
        hot=hot,
        flat_field_std=flat_field_std,
        brightness_std=brightness_std / known,
        waveform_delay_std_ns=waveform_std_ns,
        emission=emission,
        provenance={
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "software": f"hueflight {version('hueflight')}",
            "reference_photons": int(photons.sum()),
            "reference_frames": None if exposures is None else int(np.median(exposures)),
            "reflectance": known.tolist(),
            "bands": bands is not None,
            "dark": dark is not None,
            "flat": flat is not None,
            "emission": emission is not None,
        },
    )


def _require_light(
    brightness: NDArray[np.float64], deviation: NDArray[np.float64], instrument: Instrument
) -> None:
    """Refuse bands whose light does not stand out of what the others and the background leave."""
    for band, photons, noise in zip(instrument.bands, brightness, deviation, strict=True):
        if not photons > LEAST_LIGHT * noise:
            raise CalibrationError(
                f"the reference shows no light of band {band.name!r}: {photons:.3g} ± {noise:.2g} "
                "photons per pixel are left for it. Check that LED, or capture more frames"
            )


def _require_memory(instrument: Instrument, bins: TimeBins, *, separate: bool) -> None:
    rows, cols, _ = instrument.histogram_shape
    captures = CAPTURES_AT_ONCE + (2 * len(instrument.bands) if separate else 0)
    require_memory(
        4 * rows * cols * bins.count * captures,
        f"the calibration of {rows} × {cols} pixels with {bins.count} bins",
        advice=FEWER_COUNTS,
    )


def measured_widths(flat: NDArray[Any], bins: TimeBins) -> NDArray[np.float64]:
    """Measure the widths of the bins from counts under steady light (code-density test).

    Under light that is constant in time, a bin's share of the counts is its share of the period
    (IEEE Std 1241, histogram test).

    Parameters
    ----------
    flat : ndarray, shape (..., bin)
        Counts in time order; all pixels are added.
    bins : TimeBins
        Bins of the counts.

    Returns
    -------
    ndarray of float, shape (bin,)
        Widths, whose sum is the span of the bins, ns.

    Raises
    ------
    CalibrationError
        If there are fewer than 100 photons per bin.
    """
    density = flat.reshape(-1, flat.shape[-1]).sum(axis=0, dtype=np.float64)
    if density.sum() < 100 * density.size:
        raise CalibrationError(
            f"the flat capture holds {density.sum():.0f} photons; at least "
            f"{100 * density.size} are needed to measure {density.size} bins: capture longer"
        )
    return density / density.sum() * bins.span_ns


def _steady_light(flat: ArrayLike, instrument: Instrument, bins: TimeBins) -> NDArray[np.float32]:
    """Counts (pixel, bin) under steady light of the pixels that follow it.

    Hot pixels don't: they fire soon after the exposure opens, whatever the light. They have far
    more counts than others, or one in every exposure.
    """
    counts = check_histogram(flat, instrument, name="flat")
    light = bins.in_time_order(counts).astype(np.float32)
    photons = light.sum(axis=-1, dtype=np.float64)
    if not photons.any():
        return light.reshape(-1, bins.count)
    frames = frames_per_pixel(counts, instrument, None)
    steady = photons <= HOT_IN_FLAT * np.median(photons[photons > 0])
    if frames is not None:
        steady &= photons < frames
        light = coates_correction(light, photons_per_period(photons, frames, instrument))
    return light[steady] if steady.any() else light.reshape(-1, bins.count)


def _arrived(
    light: NDArray[np.float32], frames: NDArray[np.float64] | None, instrument: Instrument
) -> NDArray[np.float32]:
    """Counts (row, col, bin) of the photons that arrived, those lost in an exposure included."""
    if frames is None:
        return light
    hits = light.sum(axis=-1, dtype=np.float64)
    arrived = coates_correction(light, photons_per_period(hits, frames, instrument))
    if arrived is light:
        arrived = light.copy()
    for row, factor in enumerate(lost_photons_factor(hits, frames)):
        arrived[row] *= factor[:, None]
    return arrived


def _band_captures(bands: ArrayLike, instrument: Instrument, bins: TimeBins) -> NDArray[np.float32]:
    """The one-LED captures, checked, (band, row, col, bin) in time order."""
    captures = np.asarray(bands)
    expected = (len(instrument.bands), *instrument.histogram_shape)
    if captures.ndim != 4 or captures.shape[0] != expected[0]:
        raise CalibrationError(
            f"bands has shape {captures.shape}; instrument {instrument.name!r} needs "
            f"(band, row, col, code) = {expected}: one capture for each LED, in its order"
        )
    lights = np.empty((*captures.shape[:-1], bins.count), np.float32)
    for band, capture in enumerate(captures):
        counts = check_histogram(capture, instrument, name=f"bands[{band}]")
        light = bins.in_time_order(counts).astype(np.float32)
        lights[band] = _arrived(light, frames_per_pixel(counts, instrument, None), instrument)
    return lights


def _noise_of_captures(
    captures: NDArray[np.float32],
    delay_ns: NDArray[np.float64],
    usable: NDArray[np.bool_],
    templates: Templates,
    bins: TimeBins,
) -> NDArray[np.float64]:
    """Standard deviation (band,) of the place of waveforms from captures of one LED at a time."""
    photons, background = np.empty((2, len(captures)))
    for band, light in enumerate(captures):
        alone = Templates(templates.coefficients[[band]], templates.circle_ns)
        found, background[band] = brightness_of(light, delay_ns, usable, alone, bins)
        photons[band] = found[0]
    pixels = np.count_nonzero(usable)
    return waveform_noise(photons * pixels, background * pixels, templates, bins, together=False)[0]


def _hot_in_dark(dark: ArrayLike, instrument: Instrument, bins: TimeBins) -> NDArray[np.bool_]:
    counts = check_histogram(dark, instrument, name="dark")
    frames = frames_per_pixel(counts, instrument, None)
    photons = bins.in_time_order(counts).sum(axis=-1, dtype=np.float64)
    return find_hot_in_dark(photons, np.ones_like(photons) if frames is None else frames)


def _known_reflectance(
    reflectance: ArrayLike | None, instrument: Instrument
) -> NDArray[np.float64]:
    bands = len(instrument.bands)
    given = np.asarray(1.0 if reflectance is None else reflectance, float)
    if given.shape not in ((), (bands,)):
        raise CalibrationError(
            f"reflectance has shape {given.shape}: give one number, or one for each of the "
            f"{bands} bands"
        )
    known = np.broadcast_to(given, bands)
    if not (np.isfinite(known).all() and (known > 0).all()):
        raise CalibrationError(
            f"reflectance = {known.tolist()}: must be above 0 in each of the {bands} bands"
        )
    return known


def _gains(
    light: NDArray[np.float32],
    windows: tuple[PulseWindow, ...],
    delay: NDArray[np.float64],
    usable: NDArray[np.bool_],
    frames: NDArray[np.float64] | None,
    reflectance: NDArray[np.float64],
    noise: NDArray[np.float64],
    instrument: Instrument,
    *,
    circular: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """α per band (eq. 3), the flat field (row, col), mean 1 over usable pixels, and its deviation.

    α uses the mean over all pixels, the flat field the sum over all bands, freed from its noise:
    either is known far better than one pixel's photons in one band would tell.
    """
    sums = np.empty((reflectance.size, *delay.shape))
    for row in range(light.shape[0]):
        shift = np.rint(delay[row]).astype(np.intp)
        sums[:, row] = window_sums(
            light[row], windows, shift, bands=reflectance.size, circular=circular
        )
    per_frame = sums
    if frames is not None:  # a pixel without frames, such as a masked one, is not known
        per_frame = np.divide(sums, frames, out=np.full_like(sums, np.nan), where=frames > 0)
    photons = np.asarray(sums.sum(axis=0))
    total = np.asarray(per_frame.sum(axis=0))
    known = usable & np.isfinite(total) & (total > 0)
    if not known.any():
        raise CalibrationError(
            "every exposure of the reference holds a photon: how many were lost can't be known. "
            "Dim the LEDs or shorten the exposure"
        )
    relative = total / total[known].mean()
    variance = relative**2 / np.maximum(photons, 1) * noise
    flat_field, left = shrink_to_line_means(relative, variance, known)
    flat_field = np.where(known, flat_field, np.nan)
    flat_field_std = np.where(known, np.sqrt(left), np.nan)
    mean = (per_frame[:, known] / flat_field[known]).mean(axis=-1)
    if (mean <= 0).any():
        dark_bands = np.flatnonzero(mean <= 0).tolist()
        if overlap_widely(instrument):
            raise OverlappingBandsError(
                f"the reference shows no light of its own in band(s) {dark_bands}: the pulses of "
                f"{len(instrument.bands)} bands fill more than {OVERLAPPING_SHARE:.0%} of the "
                "recorded time, so that bands may not be told apart. Shorten the pulses, lengthen "
                "the period, or check those LEDs"
            )
        raise CalibrationError(
            f"the reference shows no light in band(s) {dark_bands}: check those LEDs"
        )
    return reflectance / mean, flat_field, flat_field_std
