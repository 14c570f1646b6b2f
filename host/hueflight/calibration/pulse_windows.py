# SPDX-License-Identifier: Apache-2.0
"""Which bins belong to which pulse, found from a reference (paper, section 2 and Fig. 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from hueflight.errors import CalibrationError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.time_bins import TimeBins

WINDOW_FLOOR = 0.02  #: a window ends where the pulse has fallen to this share of its peak
SMOOTHING_BINS = 1.5  #: σ of the smoothing before peaks are looked for
NOISE_MARGIN = 5.0  #: a pulse stands this many standard deviations above nothing
FAR_M = 5.0  #: distance from which other units than meters are thought of
REFLECTION_MARGIN = 8.0  #: standard deviations by which light of a weak reflection stands out,
REFLECTION_PEAK = 3.0  #: times the light beside it,
LEAST_REFLECTION = 0.01  #: and share of the pulse, below which it is harmless
REMEDY = (
    "Block it, or capture the same without a target and subtract those counts from reference and "
    "scene"
)
LEAST_MODULATION = 0.2  #: share of the reference's light that must stand above its floor


@dataclass(frozen=True)
class PulseWindow:
    """Bins [start, stop) that hold one pulse of a band, in time order.

    Attributes
    ----------
    band : int
        Index of the band.
    start : int
        First bin; negative where the window wraps around the start of the period.
    stop : int
        Bin after the last one; beyond the number of bins where the window wraps around the end.
    """

    band: int
    start: int
    stop: int


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
    _require_no_reflection(visible, instrument, bins, distance, shift)
    peaks = _pulse_peaks(visible, instrument, bins, distance=distance, shift=shift)
    windows = _separated(
        [PulseWindow(band, *_grow(smooth, peak, bins)) for band, peak in peaks], bins
    )
    if distance > 0:
        counts = np.asarray(pooled, np.float64)
        _require_no_weak_reflection(counts, windows, instrument, bins, shift)
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


def _require_no_reflection(
    visible: NDArray[np.float64],
    instrument: Instrument,
    bins: TimeBins,
    distance: float,
    shift: int,
) -> None:
    """Refuse a reference with stronger light elsewhere than where its pulses are due and seen."""
    near = _tolerance_bins(instrument, bins)
    if abs(shift) <= near:
        return
    due = _due_bins(instrument, bins, distance)
    found = np.array([middle + shift for _, _, middle in due])
    alone = False
    for _, _, middle in due:
        around = np.arange(middle - near - 1, middle + near + 2)
        if bins.period_ns is None and not (around[0] >= 0 and around[-1] < bins.count):
            return
        seen = visible[around % bins.count]
        if seen.max() <= 2 * max(seen[0], seen[-1]):
            return  # no pulse there: the latency differs from the description
        off = found - middle
        if bins.period_ns is not None:
            off = (off + bins.count // 2) % bins.count - bins.count // 2
        alone |= bool(np.abs(off).min() > near)
    if not alone:
        return  # equally spaced pulses: those of other bands stand there
    strongest = bins.centers_ns[found[0] % bins.count]
    raise CalibrationError(
        f"the reference shows pulses where they are due, the first at {due[0][1]:.1f} ns, and "
        f"stronger light at {strongest:.1f} ns: a fixed reflection, as of a cover glass. It would "
        f"be taken for the target. {REMEDY}"
    )


def _require_no_weak_reflection(
    counts: NDArray[np.float64],
    windows: tuple[PulseWindow, ...],
    instrument: Instrument,
    bins: TimeBins,
    shift: int,
) -> None:
    """Refuse a reference with pulses from the camera itself that are weaker than the target's.

    They stand where the light of a target at distance 0 would. Where the target's own pulses reach
    that far, nothing is concluded.
    """
    near = _tolerance_bins(instrument, bins)
    inside = np.zeros(bins.count, bool)
    pulses = np.zeros(len(instrument.bands))
    for window in windows:
        here = np.arange(window.start, window.stop) % bins.count
        inside[here] = True
        pulses[window.band] += counts[here].sum()
    if inside.all():
        return
    level = float(np.median((counts / bins.widths_ns)[~inside]))
    shares = []
    for band, _, middle in _due_bins(instrument, bins, 0.0):
        around = np.arange(middle - 2 * near, middle + 2 * near + 1) + shift
        is_core = np.abs(around - middle - shift) <= near
        if bins.period_ns is None:
            there = (around >= 0) & (around < bins.count)
            if not there[is_core].all():
                continue
            around, is_core = around[there], is_core[there]
        around %= bins.count
        if inside[around].any():
            continue
        above = counts[around] - level * bins.widths_ns[around]
        core, sides = above[is_core], above[~is_core]
        excess = float(core.sum())
        noise = np.sqrt(counts[around].sum())
        if (
            excess <= REFLECTION_MARGIN * noise
            or core.mean() <= REFLECTION_PEAK * max(sides.mean(), 0.0)
            or excess <= LEAST_REFLECTION * pulses[band]
        ):
            return
        shares.append(excess / pulses[band])
    if shares:
        raise CalibrationError(
            f"the reference shows light from the camera itself, {np.mean(shares):.1%} as strong as "
            "the target's, where pulses from a distance of 0 are due: a fixed reflection, as of a "
            f"cover glass. It stays in place while the target moves. {REMEDY}"
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


def _grow(light: NDArray[np.float64], peak: int, bins: TimeBins) -> tuple[int, int]:
    """First and one past the last bin of the pulse whose highest bin is `peak`."""
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


def window_sums(
    counts: NDArray[np.floating],
    windows: tuple[PulseWindow, ...],
    shift: NDArray[np.integer],
    *,
    bands: int,
    circular: bool,
) -> NDArray[np.float64]:
    """Sum the counts in each band's windows, moved by each pixel's own shift (paper, eq. 2).

    Parameters
    ----------
    counts : ndarray, shape (pixel, bin)
        Counts in time order.
    windows : tuple of PulseWindow
        Windows of all pulses.
    shift : ndarray of int, shape (pixel,)
        Whole bins by which the windows move; positive when the light arrives later.
    bands : int
        Number of bands.
    circular : bool
        True where windows wrap around the period; False to cut them off at the first and last bin.

    Returns
    -------
    ndarray of float, shape (band, pixel)
        Counts in the windows of each band.
    """
    pixels, count = counts.shape
    running = np.concatenate(
        [np.zeros((pixels, 1)), np.cumsum(counts, axis=-1, dtype=np.float64)], axis=-1
    )
    rows = np.arange(pixels)

    def up_to(bin_index: NDArray[np.integer]) -> NDArray[np.float64]:
        if not circular:
            return running[rows, np.clip(bin_index, 0, count)]
        turns, rest = np.divmod(bin_index, count)
        return running[rows, rest] + turns * running[:, -1]

    sums = np.zeros((bands, pixels))
    for window in windows:
        sums[window.band] += up_to(window.stop + shift) - up_to(window.start + shift)
    return sums
