# SPDX-License-Identifier: Apache-2.0
"""Which bins belong to which pulse, found from a reference (paper, section 2 and Fig. 3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from hueflight.calibration.fixed_reflections import (
    require_no_earlier_pulses,
    require_pulses_where_due,
)
from hueflight.calibration.windows import PulseWindow
from hueflight.errors import CalibrationError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.time_bins import TimeBins

WINDOW_FLOOR = 0.02  #: a window ends where the pulse has fallen to this share of its peak
SMOOTHING_BINS = 1.5  #: σ of the smoothing before peaks are looked for
NOISE_MARGIN = 5.0  #: a pulse stands this many standard deviations above nothing
FAR_M = 5.0  #: distance from which other units than meters are thought of
LEAST_MODULATION = 0.2  #: share of the reference's light that must stand above its floor


def expected_train(
    instrument: Instrument, bins: TimeBins, *, distance: float
) -> NDArray[np.float64]:
    """Compute the share of each band's light per bin that a flat target would return.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose nominal pulses are used.
    bins : TimeBins
        Bins of its counts.
    distance : float
        Distance of the target, m.

    Returns
    -------
    ndarray of float, shape (band, bin)
        Shares; over a whole period they sum to 1.
    """
    delay_ns = 2 * distance / SPEED_OF_LIGHT_M_PER_NS
    edges_ns = bins.edges_ns - delay_ns
    return np.array(
        [
            np.sum(
                [pulse.share(edges_ns, bins.period_ns) for pulse in instrument.pulses(k)], axis=0
            )
            for k in range(len(instrument.bands))
        ]
    )


def find_windows(
    pooled: NDArray[np.floating], instrument: Instrument, bins: TimeBins, *, distance: float
) -> tuple[PulseWindow, ...]:
    """Find the windows of all pulses in a reference histogram.

    The instrument's nominal pulse train is compared with the reference at every shift (the latency
    in an instrument file need not be exact). From each pulse's peak a window grows until the light
    has fallen to 2 % of the peak or rises again towards a neighbour.

    Parameters
    ----------
    pooled : ndarray of float, shape (bin,)
        Counts of all good pixels together, in time order.
    instrument : Instrument
        Instrument that made them.
    bins : TimeBins
        Bins of the counts.
    distance : float
        Distance of the reference target, m.

    Returns
    -------
    tuple of PulseWindow
        One window for each pulse, in the order of bands and delays. No two overlap.

    Raises
    ------
    CalibrationError
        If the reference holds no pulse train, or no light of one of the bands.
    """
    floor = float(np.quantile(pooled / bins.widths_ns, 0.05))
    light = np.maximum(pooled - floor * bins.widths_ns, 0)
    if light.sum() <= LEAST_MODULATION * pooled.sum():
        raise CalibrationError(
            f"the reference has no pulses in it: only {light.sum() / max(pooled.sum(), 1):.0%} of "
            "its light stands above the flat background. Check that the LEDs were on, that the "
            "camera's trigger reaches them, and that ambient light is low"
        )
    ends = "nearest" if bins.period_ns is None else "wrap"
    smooth = gaussian_filter1d(light, SMOOTHING_BINS, mode=ends)
    # of the smoothed counts: a Gaussian averages over 2 √π σ bins
    noise = np.sqrt(
        gaussian_filter1d(np.asarray(pooled, np.float64), SMOOTHING_BINS, mode=ends)
        / (2 * np.sqrt(np.pi) * SMOOTHING_BINS)
    )
    shift = _train_shift(smooth, instrument, bins, distance=distance)
    visible = np.where(smooth > NOISE_MARGIN * noise, smooth, 0.0)
    _require_meters(smooth, instrument, bins, distance, shift)
    due, near = _due_bins(instrument, bins, distance), _tolerance_bins(instrument, bins)
    shifted = np.array([middle + shift for _, _, middle in due])
    require_pulses_where_due(visible, shifted, due, near, bins)
    peaks = _pulse_peaks(visible, instrument, bins, distance=distance, shift=shift)
    found = np.array([peak for _, peak in peaks])
    require_pulses_where_due(visible, found, due, near, bins)
    tops = frozenset(peak % bins.count for _, peak in peaks)
    windows = _separated(
        [PulseWindow(band, *_grow(smooth, peak, bins, tops)) for band, peak in peaks], bins
    )
    if distance > 0:
        counts = np.asarray(pooled, np.float64)
        require_no_earlier_pulses(counts, windows, bins, distance)
    return windows


def _due_bins(
    instrument: Instrument, bins: TimeBins, distance: float
) -> list[tuple[int, float, int]]:
    """Band, time (ns) and bin of every pulse as the description has it, from a distance."""
    places = []
    for band in range(len(instrument.bands)):
        for pulse in instrument.pulses(band):
            time_ns = pulse.center_ns + pulse.tail_ns / 2 + 2 * distance / SPEED_OF_LIGHT_M_PER_NS
            if bins.period_ns is not None:
                time_ns %= bins.period_ns
            places.append((band, time_ns, int(np.searchsorted(bins.edges_ns, time_ns) - 1)))
    return places


def _tolerance_bins(instrument: Instrument, bins: TimeBins) -> int:
    """Bins by which a pulse may miss its place and still be where the description expects it."""
    shortest_ns = min(band.pulse_fwhm_ns for band in instrument.bands)
    return max(2, round(shortest_ns / 2 / (bins.span_ns / bins.count)))


def _require_meters(
    light: NDArray[np.float64],
    instrument: Instrument,
    bins: TimeBins,
    distance: float,
    shift: int,
) -> None:
    """Refuse a distance whose hundredth or thousandth explains when the pulses arrive."""
    near = _tolerance_bins(instrument, bins)
    if distance < FAR_M or abs(shift) <= near:
        return
    for unit, factor in (("centimeters", 100), ("millimeters", 1000)):
        guess = distance / factor
        if abs(_train_shift(light, instrument, bins, distance=guess)) <= near:
            raise CalibrationError(
                f"distance = {distance!r}: the pulses arrive when a target at {guess:g} m would "
                f"return them. Distances are in meters: if these are {unit}, give {guess:g}"
            )


def _train_shift(
    light: NDArray[np.float64], instrument: Instrument, bins: TimeBins, *, distance: float
) -> int:
    """Bins by which the reference lies later than the instrument's own timing says."""
    train = np.sqrt(instrument.band_brightness()) @ expected_train(
        instrument, bins, distance=distance
    )
    # square roots, so that one bright band does not outvote the pattern of all
    shifts = np.arange(-(bins.count // 2), bins.count - bins.count // 2)
    amplitude = np.sqrt(light)
    length = bins.count
    if bins.period_ns is None:  # nothing comes around
        length = fft.next_fast_len(2 * bins.count, real=True)
    spectrum = fft.rfft(amplitude, length) * np.conj(fft.rfft(train, length))
    scores = fft.irfft(spectrum, length)[shifts % length]
    return int(shifts[np.argmax(scores)])


def _pulse_peaks(
    light: NDArray[np.float64],
    instrument: Instrument,
    bins: TimeBins,
    *,
    distance: float,
    shift: int,
) -> list[tuple[int, int]]:
    """(band, bin of the highest light) of every pulse."""
    bin_width_ns = bins.span_ns / bins.count
    reach = int(min(instrument.half_spacing_ns(), bins.span_ns / 4) / bin_width_ns)
    peaks = []
    for band, time_ns, due in _due_bins(instrument, bins, distance):
        middle = due + shift
        near = np.arange(middle - reach, middle + reach + 1)
        if bins.period_ns is None:
            near = near[(near >= 0) & (near < bins.count)]
        found = near[np.argmax(light[near % bins.count])] if near.size else middle
        # highest where the search ends, it is only a neighbour's tail
        is_tail = reach > 0 and near.size > 2 and found in (near[0], near[-1])
        if not near.size or light[found % bins.count] <= 0 or is_tail:
            raise CalibrationError(
                f"the reference shows no light of band {instrument.bands[band].name!r} near "
                f"{time_ns:.0f} ns: check that LED and its delay in the instrument"
            )
        peaks.append((band, int(found)))
    return peaks


def _grow(
    light: NDArray[np.float64], peak: int, bins: TimeBins, tops: frozenset[int]
) -> tuple[int, int]:
    """First and one past the last bin of the pulse whose highest bin is `peak`, one of `tops`."""
    circular = bins.period_ns is not None
    floor = WINDOW_FLOOR * light[peak % bins.count]

    def walk(step: int) -> int:
        here = peak
        while True:
            beyond = here + step
            if not circular and not 0 <= beyond < bins.count:
                return here
            value = light[beyond % bins.count]
            if value < floor or abs(beyond - peak) >= bins.count // 2:
                return here
            if beyond % bins.count in tops:  # a neighbour's peak, after a valley too narrow to see
                return here
            # a valley: light rises again and stays risen, so a neighbour begins
            further = light[(beyond + 2 * step) % bins.count]
            if (
                value > light[here % bins.count]
                and further > value
                and value < light[peak % bins.count] / 2
            ):
                return here
            here = beyond

    return walk(-1), walk(+1) + 1


def _separated(windows: list[PulseWindow], bins: TimeBins) -> tuple[PulseWindow, ...]:
    """The windows, where two overlap cut in the middle of what both claim."""
    order = sorted(range(len(windows)), key=lambda i: windows[i].start)
    separated = list(windows)
    circular = bins.period_ns is not None
    for place, index in enumerate(order):
        last = place == len(order) - 1
        following = order[0] if last else order[place + 1]
        if following == index or (last and not circular):
            continue
        turn = bins.count if last else 0
        mine, its = separated[index], separated[following]
        if (overlap := mine.stop - (its.start + turn)) > 0:
            cut = mine.stop - overlap // 2
            separated[index] = replace(mine, stop=cut)
            separated[following] = replace(its, start=cut - turn)
    return tuple(separated)
