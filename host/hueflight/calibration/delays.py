# SPDX-License-Identifier: Apache-2.0
"""Delay of each pixel relative to all others, from a capture of a flat target."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration.defects import find_hot
from hueflight.calibration.empirical_bayes import shrink_to_line_means
from hueflight.fit.correlation import correlate, peak_centroid
from hueflight.fit.reference import FitOptions
from hueflight.fit.solver import fit_pixels
from hueflight.fit.tables import ScheduleView, make_tables
from hueflight.model.instrument import Instrument
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates

CENTROID_HALF_WIDTH = 0.9  #: half the centroid's window per FWHM of the pulses; measured best


def centroid_half_width_bins(instrument: Instrument) -> float:
    """Choose half the width of the window in which a correlation peak's centroid is computed.

    The window is about as wide as the base of a pulse, but does not reach beyond the middle between
    two pulses: 10 ns to either side for the paper's. Wider windows include background and the tails
    of the neighbours, narrower ones leave light out.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose pulses are correlated.

    Returns
    -------
    float
        Half the width, in bins.
    """
    fwhm_ns = float(np.median([band.pulse_fwhm_ns for band in instrument.bands]))
    widest_ns = min(CENTROID_HALF_WIDTH * fwhm_ns, instrument.half_spacing_ns())
    return widest_ns / instrument.sensor.bin_width_ns


def align(
    light: NDArray[np.float32], instrument: Instrument, bins: TimeBins, dead: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Pool the light of all pixels, with the delay of each pixel undone.

    Everything is computed twice, because the first pool is blurred by the pixels' delays and holds
    the light of hot pixels.

    Parameters
    ----------
    light : ndarray of float32, shape (row, col, bin)
        Counts of the reference in time order.
    instrument : Instrument
        Instrument that made them.
    bins : TimeBins
        Bins of the counts.
    dead : ndarray of bool, shape (row, col)
        Dead pixels, which are left out.

    Returns
    -------
    pooled : ndarray of float, shape (bin,)
        Counts of all good pixels together.
    delay : ndarray of float, shape (row, col)
        Delay of each pixel relative to the pool, in bins; 0 for dead and hot pixels.
    hot : ndarray of bool, shape (row, col)
        Pixels that do not follow the pulse train.
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
            lags = correlate(light[row], pooled, search + ceil(half_width))
            delay[row] = peak_centroid(lags, search=search, half_width=half_width)
        delay -= np.median(delay[~(dead | hot)]) if (~(dead | hot)).any() else 0.0
        del aligned  # or there were three captures in memory
        aligned = _shift_bins(light, -np.rint(delay).astype(np.intp))
        hot = find_hot(aligned, pooled, dead)
        weight = (~(dead | hot)).astype(np.float64)
    delay[dead | hot] = 0.0
    pooled = np.einsum("rc,rcb->b", weight, aligned, dtype=np.float64)
    return pooled, delay, hot


def refined_delays(
    light: NDArray[np.float32],
    delay_ns: NDArray[np.float64],
    usable: NDArray[np.bool_],
    templates: Templates,
    instrument: Instrument,
    bins: TimeBins,
    *,
    noise: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimate each pixel's delay by maximum likelihood, then shrink the estimates to reduce noise.

    The noise of the reference would otherwise be part of every depth that is measured against it.

    Parameters
    ----------
    light : ndarray of float32, shape (row, col, bin)
        Counts of the reference in time order.
    delay_ns : ndarray of float, shape (row, col)
        First estimate of the delays, ns.
    usable : ndarray of bool, shape (row, col)
        Pixels that are neither dead nor hot.
    templates : Templates
        Waveforms of all bands.
    instrument : Instrument
        Instrument that made the counts.
    bins : TimeBins
        Bins of the counts.
    noise : ndarray of float, shape (row, col)
        Variance of the counts, corrected for lost photons, over that of Poisson counts.

    Returns
    -------
    delay_ns : ndarray of float, shape (row, col)
        Delays with median 0, ns; 0 for pixels that are not usable.
    delay_std_ns : ndarray of float, shape (row, col)
        Their standard deviation, ns.
    """
    shortest_ns = min(band.pulse_fwhm_ns for band in instrument.bands)
    plan = make_tables(
        [ScheduleView(bins, templates)],
        shortest_fwhm_ns=shortest_ns,
        brightness=instrument.band_brightness(),
        search_ns=(-shortest_ns, shortest_ns),
        offsets_ns=(float(delay_ns[usable].min()), float(delay_ns[usable].max())),
    )
    found = fit_pixels(
        light.reshape(-1, light.shape[-1]),
        delay_ns[usable],
        plan,
        FitOptions(assessment=False),
        pixels=np.flatnonzero(usable),
    )
    delays, variance = np.zeros_like(delay_ns), np.ones_like(delay_ns)
    delays[usable] = delay_ns[usable] + found.delay_ns
    variance[usable] = found.delay_std_ns**2 * noise[usable]
    best, left = shrink_to_line_means(delays, variance, usable)
    best -= np.median(best[usable])
    return np.where(usable, best, 0.0), np.sqrt(np.where(usable, left, 0.0))


def _shift_bins(light: NDArray[np.float32], shift: NDArray[np.intp]) -> NDArray[np.float32]:
    """Each pixel's bins moved later by its own whole number, around the circle."""
    shifted = np.empty_like(light)
    for row, amounts in enumerate(shift):  # at once, three more captures would be in memory
        for amount in np.unique(amounts):
            chosen = amounts == amount
            shifted[row, chosen] = np.roll(light[row, chosen], int(amount), axis=-1)
    return shifted
