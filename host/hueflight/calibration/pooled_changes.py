# SPDX-License-Identifier: Apache-2.0
"""How the pulses of all bands have changed, from the counts of all pixels together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration.calibration import Calibration
from hueflight.calibration.waveform_estimation import PooledCounts
from hueflight.model.waveform_changes import changed
from hueflight.model.waveforms import Templates

ROUNDS = 6  #: linear steps of the fit of all pixels together
WAVEFORM_FLOOR = 0.02  #: of its peak, below which a waveform does not count for its width
LARGEST_STEP_NS = 1.0  #: of a delay in one step
LARGEST_WIDENING = (-0.3, 0.5)  #: relative change of a waveform's variance in one step
LEAST_EXPECTED = 0.02  #: counts of a bin, of the mean, below which its variance is not taken
CURVE_STEP_NS = 0.05  #: to either side, for the second derivative

_Floats = NDArray[np.float64]


def pooled_changes(
    light: NDArray[np.float32],
    usable: NDArray[np.bool_],
    calibration: Calibration,
    start_ns: float,
) -> list[tuple[_Floats, _Floats]]:
    """Fit delay, photons and width of each band to the counts of all pixels together.

    Parameters
    ----------
    light : ndarray of float32, shape (row, col, bin)
        Counts in time order.
    usable : ndarray of bool, shape (row, col)
        Pixels to use.
    calibration : Calibration
        Calibration with the waveforms.
    start_ns : float
        Delay against the calibration, near that of all bands, ns.

    Returns
    -------
    list of tuple of ndarray, shape (band,)
        Values and standard deviations of the delay beside the start, ns; of the photons; and of
        the width relative to the calibration.
    """
    bins, templates = calibration.bins, calibration.templates
    pool = PooledCounts.of(
        light, calibration.pixel_delay_ns, usable, bins, knot_ns=templates.knot_ns
    )
    share = pool.counts.sum(axis=-1) / pool.counts.sum()
    flat = bins.widths_ns / bins.span_ns
    size = templates.bands
    counts = pool.counts.ravel()
    delay, photons, width = np.zeros(size), np.maximum(calibration.brightness, 0), np.ones(size)
    variance = np.full(counts.size, max(counts.mean(), 1e-300))
    inverse, now = np.eye(3 * size + 1), templates
    for _ in range(ROUNDS):
        rows = []
        for group, offset_ns in enumerate(pool.offsets_ns):
            place_ns = offset_ns + start_ns
            ahead, behind = place_ns - CURVE_STEP_NS, place_ns + CURVE_STEP_NS
            rise = now.slopes(bins.edges_ns, behind) - now.slopes(bins.edges_ns, ahead)
            parts = [
                now.shares(bins.edges_ns, place_ns),
                now.slopes(bins.edges_ns, place_ns),
                rise / (2 * CURVE_STEP_NS),
                flat[None],
            ]
            rows.append(share[group] * np.concatenate(parts))
        model = np.concatenate(rows, axis=-1)
        normal = (model / variance) @ model.T
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse = np.linalg.pinv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
        solution = inverse @ ((model / variance) @ counts)
        photons = np.maximum(solution[:size], 1e-300)
        delay = delay + np.clip(
            solution[size : 2 * size] / photons, -LARGEST_STEP_NS, LARGEST_STEP_NS
        )
        own = _variances(now)
        wider = np.clip(2 * solution[2 * size : 3 * size] / photons / own, *LARGEST_WIDENING)
        width = width * np.sqrt(1 + wider)
        now = changed(templates, delay_ns=delay, width_factor=width)
        expected = solution @ model
        variance = np.maximum(expected, LEAST_EXPECTED * expected.mean())
    std = np.sqrt(np.diag(inverse))
    width_std = std[2 * size : 3 * size] / photons / _variances(now) * width
    return [(delay, std[size : 2 * size] / photons), (photons, std[:size]), (width, width_std)]


def _variances(templates: Templates) -> _Floats:
    """Variance of each waveform over time, ns²."""
    time_ns = np.arange(0.0, templates.circle_ns, templates.knot_ns / 4)
    variances = np.empty(templates.bands)
    for band, density in enumerate(templates.density(time_ns)):
        weight = np.where(density > WAVEFORM_FLOOR * density.max(), density, 0.0)
        around = time_ns - time_ns[np.argmax(density)]
        around -= templates.circle_ns * np.rint(around / templates.circle_ns)
        mean = weight @ around / weight.sum()
        variances[band] = weight @ (around - mean) ** 2 / weight.sum()
    return variances
