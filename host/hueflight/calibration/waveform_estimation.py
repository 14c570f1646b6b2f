# SPDX-License-Identifier: Apache-2.0
"""Waveforms from captures: pooled over pixels, of one LED at a time or of all LEDs together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hueflight.calibration.pulse_train_fit import fit_pulse_train
from hueflight.calibration.windows import PulseWindow
from hueflight.errors import CalibrationError
from hueflight.model.instrument import Instrument
from hueflight.model.pulses import Pulse
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates, circle_of, fit_waveform

KNOTS_PER_FWHM = 12  #: of the shortest pulse; finer knots only fit noise
DELAY_STEPS_PER_BIN = 8  #: pixels whose delays round to the same step are pooled
MOST_GROUPS = 64  #: with more pools than that, steps are doubled, but
COARSEST_STEP = 0.5  #: not beyond this part of the waveforms' knots
POOLED_BYTES = 1 << 24  #: of counts that are added up together
TrainModel = tuple[list[tuple[int, Pulse]], float]  #: (band, pulse) of each, background per ns

NOISE_MARGIN = 4.0  #: a waveform ends where it is this many standard deviations above 0


@dataclass(frozen=True)
class PooledCounts:
    """Counts of many pixels, summed over pixels of equal delay.

    Attributes
    ----------
    counts : ndarray of float, shape (group, bin)
        Counts in time order.
    offsets_ns : ndarray of float, shape (group,)
        Delay of each group, ns.
    """

    counts: NDArray[np.float64]
    offsets_ns: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        light: NDArray[np.floating],
        delay_ns: NDArray[np.floating],
        usable: NDArray[np.bool_],
        bins: TimeBins,
        *,
        knot_ns: float,
    ) -> PooledCounts:
        """Pool the usable pixels of a capture.

        Parameters
        ----------
        light : ndarray of float, shape (row, col, bin)
            Counts in time order.
        delay_ns : ndarray of float, shape (row, col)
            Delay of each pixel, ns; rounded to an eighth of a bin, or more where that makes many
            groups.
        usable : ndarray of bool, shape (row, col)
            Pixels to pool.
        bins : TimeBins
            Bins of the counts.
        knot_ns : float
            Spacing of the knots of the waveforms, ns.

        Returns
        -------
        PooledCounts
            One group for each delay that occurs.
        """
        step_ns = bins.span_ns / bins.count / DELAY_STEPS_PER_BIN
        delays_ns = delay_ns[usable]
        steps, group = np.unique(np.rint(delays_ns / step_ns), return_inverse=True)
        while steps.size > MOST_GROUPS and 2 * step_ns <= COARSEST_STEP * knot_ns:
            step_ns *= 2
            steps, group = np.unique(np.rint(delays_ns / step_ns), return_inverse=True)
        counts = np.zeros((steps.size, light.shape[-1]))
        flat, pixels = light.reshape(-1, light.shape[-1]), np.flatnonzero(usable)
        at_once = max(1, POOLED_BYTES // flat[:1].nbytes)
        for index in range(steps.size):
            members = pixels[group == index]
            for start in range(0, members.size, at_once):
                some = flat[members[start : start + at_once]]  # copied, so not all of a capture
                counts[index] += some.sum(axis=0, dtype=np.float64)
        return cls(counts, steps * step_ns)

    def aligned(self, values: NDArray[np.float64], bins: TimeBins) -> NDArray[np.float64]:
        """Add values of all groups, with their delays undone to whole bins.

        Parameters
        ----------
        values : ndarray of float, shape (group, bin)
            Values such as `counts`.
        bins : TimeBins
            Bins of the values.

        Returns
        -------
        ndarray of float, shape (bin,)
            The sum.
        """
        whole = np.rint(self.offsets_ns / (bins.span_ns / bins.count)).astype(int)
        return np.sum([np.roll(v, -s) for v, s in zip(values, whole, strict=True)], axis=0)


def knots_for(instrument: Instrument, bins: TimeBins) -> int:
    """Choose the number of knots of the waveforms' splines.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose shortest pulse must be resolved.
    bins : TimeBins
        Bins of its counts.

    Returns
    -------
    int
        Knots on the circle: about one per bin, or fewer where bins are finer than pulses need.
    """
    shortest_ns = min(band.pulse_fwhm_ns for band in instrument.bands)
    knot_ns = max(bins.span_ns / bins.count, shortest_ns / KNOTS_PER_FWHM)
    return max(8, round(circle_of(bins) / knot_ns))


def templates_from_bands(
    captures: NDArray[np.floating],
    delay_ns: NDArray[np.floating],
    usable: NDArray[np.bool_],
    windows: tuple[PulseWindow, ...],
    instrument: Instrument,
    bins: TimeBins,
) -> Templates:
    """Estimate waveforms from captures of one LED at a time.

    Parameters
    ----------
    captures : ndarray of float, shape (band, row, col, bin)
        Counts in time order.
    delay_ns : ndarray of float, shape (row, col)
        Delay of each pixel, ns.
    usable : ndarray of bool, shape (row, col)
        Pixels to use.
    windows : tuple of PulseWindow
        Windows of all pulses in the reference.
    instrument : Instrument
        Instrument that made the captures.
    bins : TimeBins
        Bins of the counts.

    Returns
    -------
    Templates
        One waveform for each band.

    Raises
    ------
    CalibrationError
        If a capture shows no light, or light outside the windows of its band.
    """
    knots = knots_for(instrument, bins)
    coefficients = []
    for band, light in enumerate(captures):
        pool = PooledCounts.of(light, delay_ns, usable, bins, knot_ns=circle_of(bins) / knots)
        name = instrument.bands[band].name
        mine = [window for window in windows if window.band == band]
        _require_own_light(pool, mine, bins, name)
        background = _before_pulses(pool, mine, bins)
        coefficients.append(_fit(pool, background, mine, bins, knots, name))
    return Templates.normalized(np.array(coefficients), circle_of(bins))


def fit_overlapping_pulses(
    light: NDArray[np.floating],
    delay_ns: NDArray[np.floating],
    usable: NDArray[np.bool_],
    windows: tuple[PulseWindow, ...],
    instrument: Instrument,
    bins: TimeBins,
) -> TrainModel:
    """Fit the model by which the light of all LEDs together is divided among the bands.

    Parameters
    ----------
    light : ndarray of float, shape (row, col, bin)
        Counts of the reference in time order, all LEDs on.
    delay_ns : ndarray of float, shape (row, col)
        Delay of each pixel, ns.
    usable : ndarray of bool, shape (row, col)
        Pixels to use.
    windows : tuple of PulseWindow
        Windows of all pulses.
    instrument : Instrument
        Instrument that made the counts.
    bins : TimeBins
        Bins of the counts.

    Returns
    -------
    TrainModel
        Fitted pulses with their bands, and the background per ns. It has no pulses where there is a
        single band, to which all light belongs.

    Raises
    ------
    CalibrationError
        If counts are unknown, because pixels recorded a photon in each of their exposures.
    """
    if len(instrument.bands) == 1:
        return [], 0.0  # all light is the one band's
    knot_ns = circle_of(bins) / knots_for(instrument, bins)
    pool = PooledCounts.of(light, delay_ns, usable, bins, knot_ns=knot_ns)
    return fit_pulse_train(pool.aligned(pool.counts, bins), windows, instrument, bins)


def templates_from_train(
    light: NDArray[np.floating],
    delay_ns: NDArray[np.floating],
    usable: NDArray[np.bool_],
    windows: tuple[PulseWindow, ...],
    model: TrainModel,
    instrument: Instrument,
    bins: TimeBins,
) -> Templates:
    """Estimate waveforms from one capture with all LEDs on.

    Where pulses overlap, each bin's counts are divided in the proportions of exponentially modified
    Gaussians fitted to the whole train; elsewhere a band keeps what was measured.

    Parameters
    ----------
    light : ndarray of float, shape (row, col, bin)
        Counts in time order.
    delay_ns : ndarray of float, shape (row, col)
        Delay of each pixel, ns.
    usable : ndarray of bool, shape (row, col)
        Pixels to use.
    windows : tuple of PulseWindow
        Windows of all pulses.
    model : TrainModel
        What `fit_overlapping_pulses` gave.
    instrument : Instrument
        Instrument that made the counts.
    bins : TimeBins
        Bins of the counts.

    Returns
    -------
    Templates
        One waveform for each band.

    Raises
    ------
    CalibrationError
        If a band shows no light above its background.
    """
    knots = knots_for(instrument, bins)
    pool = PooledCounts.of(light, delay_ns, usable, bins, knot_ns=circle_of(bins) / knots)
    if len(instrument.bands) == 1:
        background = _before_pulses(pool, list(windows), bins)
        name = instrument.bands[0].name
        fitted = _fit(pool, background, list(windows), bins, knots, name)
        return Templates.normalized(fitted, circle_of(bins))
    pulses, level = model
    coefficients = []
    for band in range(len(instrument.bands)):
        mine = [window for window in windows if window.band == band]
        share = _proportion(pulses, level, band, pool, bins)
        part = PooledCounts(pool.counts * share, pool.offsets_ns)
        nothing = np.zeros_like(part.counts)
        name = instrument.bands[band].name
        coefficients.append(_fit(part, nothing, mine, bins, knots, name))
    return Templates.normalized(np.array(coefficients), circle_of(bins))


def brightness_of(
    light: NDArray[np.floating],
    delay_ns: NDArray[np.floating],
    usable: NDArray[np.bool_],
    templates: Templates,
    bins: TimeBins,
) -> tuple[NDArray[np.float64], float]:
    """Fit the photons of each band in an average usable pixel, and those of the background.

    Parameters
    ----------
    light : ndarray of float, shape (row, col, bin)
        Counts in time order.
    delay_ns : ndarray of float, shape (row, col)
        Delay of each pixel, ns.
    usable : ndarray of bool, shape (row, col)
        Pixels to use.
    templates : Templates
        Waveforms of the bands whose LEDs were on.
    bins : TimeBins
        Bins of the counts.

    Returns
    -------
    photons : ndarray of float, shape (band,)
        Photons per capture.
    background : float
        Photons of the background per capture.
    """
    pool = PooledCounts.of(light, delay_ns, usable, bins, knot_ns=templates.knot_ns)
    flat = bins.widths_ns / bins.span_ns
    share = pool.counts.sum(axis=-1) / pool.counts.sum()
    model = np.concatenate(
        [
            share[group] * np.vstack([templates.shares(bins.edges_ns, offset), flat])
            for group, offset in enumerate(pool.offsets_ns)
        ],
        axis=-1,
    ).T
    counts = pool.counts.ravel()
    variance = np.full(counts.size, counts.mean())
    solution = np.zeros(model.shape[1])
    for _ in range(4):  # variances of the model, not of the counts: these would bias dim bands
        weight = 1 / np.sqrt(variance)
        solution, _ = nnls(model * weight[:, None], counts * weight)
        expected = model @ solution
        variance = np.maximum(expected, 1e-6 * expected.max())
    return solution[:-1] / usable.sum(), float(solution[-1] / usable.sum())


def _require_own_light(
    pool: PooledCounts, windows: list[PulseWindow], bins: TimeBins, name: str
) -> None:
    """Refuse a capture whose light is elsewhere than that band's in the reference."""
    counts = pool.aligned(pool.counts, bins)
    excess = counts - np.quantile(counts / bins.widths_ns, 0.25) * bins.widths_ns
    inside = sum(
        float(excess[np.arange(window.start, window.stop) % bins.count].sum()) for window in windows
    )
    if inside < 0.5 * np.abs(excess).sum():
        raise CalibrationError(
            f"the capture of band {name!r} alone has its light elsewhere than that band's pulse "
            "in the reference: give one capture per band, in the instrument's order, with "
            "only that LED on"
        )


def _before_pulses(
    pool: PooledCounts, windows: list[PulseWindow], bins: TimeBins
) -> NDArray[np.float64]:
    """Flat background (group, bin), from the second half of the dark stretch before a pulse.

    A pulse's tail fades for long after it; before its rise is where the circle is darkest.
    """
    dark = np.zeros(bins.count, dtype=bool)
    starts = sorted(window.start for window in windows)
    for index, start in enumerate(starts):
        length = max(window.stop - window.start for window in windows)
        if bins.period_ns is None:
            previous = starts[index - 1] if index else 0
        else:
            previous = starts[index - 1] - (0 if index else bins.count)
        guard = length // 2
        stretch = np.arange((previous + start) // 2, start - guard)
        if stretch.size == 0:  # no room: the last bins before the rise
            stretch = np.arange(max(start - guard, 0), start)
        dark[stretch % bins.count] = True
    if not dark.any():
        return np.zeros_like(pool.counts)
    rate = pool.counts[:, dark].sum(axis=-1) / bins.widths_ns[dark].sum()
    return rate[:, None] * bins.widths_ns


def _fit(
    pool: PooledCounts,
    background: NDArray[np.float64],
    windows: list[PulseWindow],
    bins: TimeBins,
    knots: int,
    name: str,
) -> NDArray[np.float64]:
    """Spline coefficients of one band, each pulse confined to where it can be told from noise."""
    if pool.counts.sum() <= background.sum():
        raise CalibrationError(f"band {name!r} shows no light above its background: check that LED")
    support = _support(pool, background, windows, bins, knots)
    return fit_waveform(
        pool.counts,
        pool.offsets_ns,
        bins,
        knots=knots,
        background=background,
        support=support,
    )


def _support(
    pool: PooledCounts,
    background: NDArray[np.float64],
    windows: list[PulseWindow],
    bins: TimeBins,
    knots: int,
) -> NDArray[np.bool_]:
    """Knots (knot,) of a waveform: around each window, as far as light is above the noise."""
    counts, level = pool.aligned(pool.counts, bins), pool.aligned(background, bins)
    wide = max(3, max(window.stop - window.start for window in windows) // 4)
    box = np.ones(wide)

    def boxed(values: NDArray[np.float64]) -> NDArray[np.float64]:
        wrapped = np.concatenate([values[-wide:], values, values[:wide]])
        return np.convolve(wrapped, box, mode="same")[wide:-wide]

    noise = np.sqrt(np.maximum(boxed(counts), 1.0))
    lit = boxed(counts - level) > NOISE_MARGIN * noise
    inside = np.zeros(bins.count, dtype=bool)
    for window in windows:
        first, last = window.start, window.stop - 1
        while window.stop - first < bins.count and lit[(first - 1) % bins.count]:
            first -= 1
        while last - window.start < bins.count - 1 and lit[(last + 1) % bins.count]:
            last += 1
        inside[np.arange(first - wide, last + wide + 1) % bins.count] = True
    time_ns = np.arange(knots) * (circle_of(bins) / knots)
    nearest = np.clip(np.searchsorted(bins.edges_ns, time_ns, side="right") - 1, 0, bins.count - 1)
    return inside[nearest] & (time_ns <= bins.edges_ns[-1])


def _proportion(
    pulses: list[tuple[int, Pulse]], level: float, band: int, pool: PooledCounts, bins: TimeBins
) -> NDArray[np.float64]:
    """Share (group, bin) of the light that is the band's."""
    share = np.empty_like(pool.counts)
    for group, offset_ns in enumerate(pool.offsets_ns):
        edges_ns = bins.edges_ns - offset_ns
        parts = [(owner, p.share(edges_ns, bins.period_ns)) for owner, p in pulses]
        mine = np.sum([part for owner, part in parts if owner == band], axis=0)
        whole = np.sum([part for _, part in parts], axis=0) + level * bins.widths_ns
        share[group] = mine / np.maximum(whole, 1e-300)
    return share
