# SPDX-License-Identifier: Apache-2.0
"""Does a description fit the camera? Pulses of a reference beside those that it says are due.

Positions are compared after the whole train was moved to where it fits best, because the latency of
electronics and cables is rarely known. Widths are measured in the same way in the capture and in
the described pulses, so that the width of the bins affects both alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration.defects import find_dead
from hueflight.calibration.delays import align
from hueflight.calibration.pulse_windows import expected_train, find_windows
from hueflight.calibration.windows import PulseWindow
from hueflight.errors import CalibrationError, HistogramError
from hueflight.model.histograms import check_histogram
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.time_bins import TimeBins

HOT = 10.0  #: pixels with so many times the median of the photons are left out
TELLING = 1.05  #: a direction fits better if its correlation is so many times the other's
WIDTH_RATIO = 1.4  #: a width that differs by more than this factor does not fit
SHIFT_SHARE = 0.25  #: of a pulse's width, by which its position may differ, or of a bin's


@dataclass(frozen=True)
class PulseCheck:
    """One pulse in the description and in the capture.

    Attributes
    ----------
    band : str
        Name of the band.
    due_ns : float
        Mean time of the described pulse within the period, with the latency that was found, ns.
    found_ns : float
        Mean time of the pulse in the capture, ns.
    due_fwhm_ns, found_fwhm_ns : float
        Full widths at half maximum of both, as the bins show them, ns.
    share : float
        Share of the capture's light in the pulse.
    """

    band: str
    due_ns: float
    found_ns: float
    due_fwhm_ns: float
    found_fwhm_ns: float
    share: float


@dataclass(frozen=True)
class DescriptionCheck:
    """What a capture of a flat target says about the description of its instrument.

    Attributes
    ----------
    pulses : tuple of PulseCheck
        Every pulse; empty if the pulse train was not found.
    problems : tuple of str
        What does not fit, as sentences; empty if everything does.
    direction : {"as described", "not as described", "not told by this capture"}
        Whether codes count in the described direction. A single symmetric pulse does not tell.
    latency_ns : float
        Latency with which the pulses stand where they are due; NaN if they were not found.
    time_ns : ndarray of float, shape (bin,)
        Middles of the bins.
    counts : ndarray of float, shape (bin,)
        Counts of all good pixels.
    expected : ndarray of float, shape (band, bin)
        Counts that the description gives, with the background and the brightness of each band that
        were found.
    """

    pulses: tuple[PulseCheck, ...]
    problems: tuple[str, ...]
    direction: str
    latency_ns: float
    time_ns: NDArray[np.float64]
    counts: NDArray[np.float64]
    expected: NDArray[np.float64]


def check_description(
    reference: ArrayLike, instrument: Instrument, /, *, distance: float
) -> DescriptionCheck:
    """Compare a description with a capture of a flat target.

    Parameters
    ----------
    reference : array_like, shape (row, col, code)
        Counts of the target with all LEDs on.
    instrument : Instrument
        The description.
    distance : float
        Distance of the target, m.

    Returns
    -------
    DescriptionCheck
        Pulses and problems.

    Raises
    ------
    HistogramError
        If the counts do not have the described shape, or there is no light in them.
    """
    counts = check_histogram(reference, instrument, name="reference")
    bins = instrument.time_bins()
    light = bins.in_time_order(counts)
    pooled = _pooled(light)
    outside = float(counts.sum(dtype=np.float64) - light.sum(dtype=np.float64))
    if instrument.sensor.reports_empty:
        outside -= float(counts[..., 0].sum(dtype=np.float64))
    problems = []
    if outside > 0.01 * pooled.sum():
        problems.append(
            f"{outside / (outside + pooled.sum()):.0%} of the photons have codes beyond the period "
            f"of {instrument.timing.period_ns:g} ns: check timing.period_ns and "
            "sensor.bin_width_ns"
        )
    direction = _direction(counts, pooled, instrument, bins, distance)
    other = "reverse" if instrument.sensor.direction == "forward" else "forward"
    if direction == "not as described":
        problems.append(
            f'the pulses fit better if codes count in {other}: check sensor.direction = "{other}"'
        )
    # pixels differ in delay, which would widen the sum of their pulses
    aligned, _, _ = align(
        light.astype(np.float32), instrument, bins, find_dead(light.sum(axis=-1, dtype=np.float64))
    )
    pooled = np.asarray(aligned, np.float64)
    time_ns = (bins.edges_ns[:-1] + bins.edges_ns[1:]) / 2
    try:
        windows = find_windows(pooled, instrument, bins, distance=distance)
    except CalibrationError as error:
        nothing = np.zeros((len(instrument.bands), bins.count))
        return DescriptionCheck(
            (), (*problems, str(error)), direction, np.nan, time_ns, pooled, nothing
        )
    late_ns = _lateness_ns(pooled, windows, instrument, bins, distance)
    expected = _moved_train(instrument, bins, distance, late_ns)
    pulses = tuple(
        _pulse(pooled, expected[window.band], window, instrument, bins, distance, late_ns)
        for window in windows
    )
    problems += [problem for pulse in pulses for problem in _problems(pulse, instrument)]
    floor = float(np.quantile(pooled / bins.widths_ns, 0.05)) * bins.widths_ns
    above = np.maximum(pooled - floor, 0)
    solved = np.linalg.lstsq(expected.T, above, rcond=None)[0]
    latency_ns = instrument.timing.latency_ns + late_ns
    if bins.period_ns is not None:  # from -half a bin on, so that 0 is not found as a whole period
        half_ns = bins.span_ns / bins.count / 2
        latency_ns = (latency_ns + half_ns) % bins.period_ns - half_ns
    return DescriptionCheck(
        pulses, tuple(problems), direction, latency_ns, time_ns, pooled,
        expected * np.maximum(solved, 0)[:, None] + floor / len(expected),
    )  # fmt: skip


def _pooled(light: NDArray[Any]) -> NDArray[np.float64]:
    """Counts (bin,) of the pixels that are neither dead nor hot."""
    photons = light.sum(axis=-1, dtype=np.float64)
    if not photons.any():
        raise HistogramError("the reference has no light: check that the LEDs were on")
    median = float(np.median(photons[photons > 0]))
    good = ~find_dead(photons) & (photons <= HOT * median)
    return light[good].sum(axis=0, dtype=np.float64)


def _direction(
    counts: NDArray[Any],
    pooled: NDArray[np.float64],
    instrument: Instrument,
    bins: TimeBins,
    distance: float,
) -> str:
    turned = "reverse" if instrument.sensor.direction == "forward" else "forward"
    other = instrument.replace(sensor=msgspec.structs.replace(instrument.sensor, direction=turned))
    mirrored = other.time_bins()
    here = _likeness(pooled, instrument, bins, distance)
    there = _likeness(_pooled(mirrored.in_time_order(counts)), other, mirrored, distance)
    if there > TELLING * here:
        return "not as described"
    return "as described" if here > TELLING * there else "not told by this capture"


def _likeness(
    pooled: NDArray[np.float64], instrument: Instrument, bins: TimeBins, distance: float
) -> float:
    """Best correlation coefficient of the described train with the capture, at any shift."""
    size = bins.count if bins.period_ns is not None else 2 * bins.count
    brightness = instrument.band_brightness()
    train = brightness @ expected_train(instrument, bins, distance=distance)
    spectra = [np.fft.rfft(np.sqrt(part - part.min()), size) for part in (pooled, train)]
    for spectrum in spectra:
        spectrum[0] = 0
    norm = [np.linalg.norm(np.fft.irfft(spectrum, size)) for spectrum in spectra]
    if not all(norm):
        return 0.0
    return float(np.fft.irfft(spectra[0] * spectra[1].conj(), size).max() / (norm[0] * norm[1]))


def _moved_train(
    instrument: Instrument, bins: TimeBins, distance: float, late_ns: float
) -> NDArray[np.float64]:
    """Described shares (band, bin), so much later; the times may lie before the period's start."""
    latency_ns = instrument.timing.latency_ns + late_ns
    if bins.period_ns is not None:
        latency_ns %= bins.period_ns
    elif latency_ns < 0:
        distance, latency_ns = distance + latency_ns * SPEED_OF_LIGHT_M_PER_NS / 2, 0.0
    timing = msgspec.structs.replace(instrument.timing, latency_ns=latency_ns)
    return expected_train(instrument.replace(timing=timing), bins, distance=distance)


def _lateness_ns(
    pooled: NDArray[np.float64],
    windows: tuple[PulseWindow, ...],
    instrument: Instrument,
    bins: TimeBins,
    distance: float,
) -> float:
    """Time by which the pulses stand later than described: the median over all pulses."""
    step_ns = bins.span_ns / bins.count
    late = []
    for window in windows:
        found = _mean(pooled, window.start, window.stop, bins)
        # of several pulses of a band, the described one that is nearest
        due = _nearest_mean(found, instrument, window.band, bins, distance)
        late.append((found - due) * step_ns)
    if bins.period_ns is None:
        return float(np.median(late))
    # on the circle: about the direction of their sum
    angles = np.exp(2j * np.pi * np.array(late) / bins.period_ns)
    middle_ns = float(np.angle(angles.sum()) / (2 * np.pi) * bins.period_ns)
    apart = (np.array(late) - middle_ns + bins.period_ns / 2) % bins.period_ns
    return middle_ns + float(np.median(apart)) - bins.period_ns / 2


def _nearest_mean(
    middle: float,
    instrument: Instrument,
    band: int,
    bins: TimeBins,
    distance: float,
) -> float:
    """Mean bin of the described pulse of a band whose mean is nearest to a bin."""
    step_ns = bins.span_ns / bins.count
    means = []
    for pulse in instrument.pulses(band):
        at_ns = pulse.center_ns + pulse.tail_ns + 2 * distance / SPEED_OF_LIGHT_M_PER_NS
        means.append((at_ns - bins.edges_ns[0]) / step_ns - 0.5)
    places = np.array(means)
    if bins.period_ns is not None:
        places += np.round((middle - places) / bins.count) * bins.count
    return float(places[np.argmin(np.abs(places - middle))])


def _mean(curve: NDArray[np.float64], start: int, stop: int, bins: TimeBins) -> float:
    """Mean bin of the light of a pulse above the lowest bins beside it."""
    here = np.arange(start, stop)
    values = curve[here % bins.count]
    above = np.maximum(values - min(values[0], values[-1]), 0)
    return float((here * above).sum() / above.sum()) if above.any() else float(here.mean())


def _fwhm(curve: NDArray[np.float64], start: int, stop: int, bins: TimeBins) -> float:
    """Full width at half maximum of a pulse, in bins, between interpolated crossings."""
    here = np.arange(start - 1, stop + 1)
    if bins.period_ns is None:
        here = here[(here >= 0) & (here < bins.count)]
    values = curve[here % bins.count].astype(np.float64)
    values = values - min(values[0], values[-1])
    top = int(values.argmax())
    half = values[top] / 2
    if half <= 0:
        return np.nan
    left = next((i for i in range(top, -1, -1) if values[i] < half), None)
    right = next((i for i in range(top, values.size) if values[i] < half), None)
    if left is None or right is None:
        return np.nan
    rise = left + (half - values[left]) / (values[left + 1] - values[left])
    fall = right - (half - values[right]) / (values[right - 1] - values[right])
    return fall - rise


def _pulse(
    pooled: NDArray[np.float64],
    expected: NDArray[np.float64],
    window: PulseWindow,
    instrument: Instrument,
    bins: TimeBins,
    distance: float,
    late_ns: float,
) -> PulseCheck:
    step_ns = bins.span_ns / bins.count
    limits = (window.start, window.stop)
    found = _mean(pooled, *limits, bins)
    due = _nearest_mean(found - late_ns / step_ns, instrument, window.band, bins, distance)
    due += late_ns / step_ns
    moved = round(due - found)
    here = np.arange(*limits) % bins.count

    def time_ns(bin_number: float) -> float:
        at_ns = float(bins.edges_ns[0]) + (bin_number + 0.5) * step_ns
        return at_ns if bins.period_ns is None else at_ns % bins.period_ns

    return PulseCheck(
        band=instrument.bands[window.band].name,
        due_ns=time_ns(due),
        found_ns=time_ns(found),
        due_fwhm_ns=_fwhm(expected, window.start + moved, window.stop + moved, bins) * step_ns,
        found_fwhm_ns=_fwhm(pooled, *limits, bins) * step_ns,
        share=float(pooled[here].sum() / pooled.sum()),
    )


def _problems(pulse: PulseCheck, instrument: Instrument) -> list[str]:
    found = []
    bin_ns = instrument.sensor.bin_width_ns
    allowed_ns = max(SHIFT_SHARE * pulse.due_fwhm_ns, bin_ns)
    apart_ns = pulse.found_ns - pulse.due_ns
    period_ns = instrument.timing.period_ns
    if period_ns is not None:
        apart_ns = (apart_ns + period_ns / 2) % period_ns - period_ns / 2
    if not abs(apart_ns) <= allowed_ns:
        found.append(
            f"band {pulse.band!r} stands {apart_ns:+.2f} ns from where the others put it: check "
            "its delay_ns"
        )
    # the jitter of a sensor is rarely described and often about a bin
    least_ns, most_ns = pulse.due_fwhm_ns / WIDTH_RATIO, np.hypot(pulse.due_fwhm_ns, 2 * bin_ns)
    wide = max(pulse.found_fwhm_ns, pulse.due_fwhm_ns) > 2 * bin_ns
    if wide and not least_ns <= pulse.found_fwhm_ns <= WIDTH_RATIO * most_ns:
        found.append(
            f"band {pulse.band!r} is {pulse.found_fwhm_ns:.2f} ns wide, described are "
            f"{pulse.due_fwhm_ns:.2f} ns: check its pulse_fwhm_ns"
        )
    return found
