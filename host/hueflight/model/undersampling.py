# SPDX-License-Identifier: Apache-2.0
"""Pulses that are too short for a sensor's bins to resolve, and the smoothing that they need."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import Instrument
from hueflight.model.time_bins import TimeBins

RESOLVED_BINS_PER_FWHM = 4.0  #: with fewer, waveforms between bins are not known well enough


def is_resolved(shortest_fwhm_ns: float, bins: TimeBins) -> bool:
    """Return whether the shortest pulse is wide enough for the bins.

    Parameters
    ----------
    shortest_fwhm_ns : float
        Full width at half maximum of the shortest pulse, ns.
    bins : TimeBins
        Time bins of the sensor.

    Returns
    -------
    bool
        True from four bins in the full width on.
    """
    return shortest_fwhm_ns >= RESOLVED_BINS_PER_FWHM * bins.span_ns / bins.count


def smooth_undersampled(
    light: NDArray[Any], instrument: Instrument, bins: TimeBins
) -> NDArray[Any]:
    """Average counts 1 : 2 : 1 over neighbouring bins where pulses are too short for the bins.

    The course of a flank that falls between two bins can only be guessed, and a delay would depend
    on that guess. The average is the same for reference and scene, so it cancels. It costs a little
    of the information in the photons and makes the result independent of where a pulse lies on the
    grid of bins.

    Parameters
    ----------
    light : ndarray, shape (..., bin)
        Counts in time order.
    instrument : Instrument
        Instrument whose pulses the counts hold.
    bins : TimeBins
        Bins of the counts.

    Returns
    -------
    ndarray, shape (..., bin)
        The counts unchanged where the pulses are resolved, else averaged, as float32.
    """
    if is_resolved(min(band.pulse_fwhm_ns for band in instrument.bands), bins):
        return light
    if light.ndim > 2:  # part by part: the intermediate results take three times the memory
        smooth = np.empty(light.shape, np.float32)
        for index, part in enumerate(light):
            smooth[index] = smooth_undersampled(part, instrument, bins)
        return smooth
    wide = np.asarray(light, np.float32)
    before, after = np.roll(wide, 1, axis=-1), np.roll(wide, -1, axis=-1)
    if bins.period_ns is None:
        before[..., 0], after[..., -1] = wide[..., 0], wide[..., -1]
    return (before + 2 * wide + after) / 4
