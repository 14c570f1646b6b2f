# SPDX-License-Identifier: Apache-2.0
"""Two published algorithms for few photons, written from their papers.

Both censor photons that look like background and then smooth depth by total variation. Their papers
choose the strength of smoothing by hand; here it is an argument, of which the scoreboard takes the
value that does best.
"""

from __future__ import annotations

import numpy as np
from data_sets import Half
from numpy.typing import NDArray
from scipy.ndimage import convolve, uniform_filter
from scipy.stats import binom

from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS

Floats = NDArray[np.float64]
METERS_PER_NS = SPEED_OF_LIGHT_M_PER_NS / 2
ITERATIONS = 300  #: of the primal-dual algorithm
SUPERPIXELS = (1, 3, 5, 7, 9, 13)  #: sizes of windows that are tried, pixels
FALSE_ALARMS = 0.05  #: with which background makes a cluster, as in Rapp and Goyal's examples


def shin_2015(half: Half, *, smoothing: float) -> Floats:
    """Depth by Shin, Kirmani, Goyal and Shapiro, IEEE Trans. Comput. Imaging 1, 112 (2015).

    A photon is kept if it arrives near the median of its eight neighbors' photons, the nearer the
    less background there is; depth is the total-variation estimate of those kept.
    """
    counts = half.counts[..., half.calibration.bins.codes].astype(np.float64)
    around = np.ones((3, 3, 1))
    around[1, 1] = 0
    passed = np.cumsum(convolve(counts, around, mode="nearest"), axis=-1)
    median = (passed >= 0.5 * passed[..., -1:]).argmax(axis=-1)
    times_ns = half.times_ns
    _, width_ns = half.pulse_width_ns
    photons = counts.sum(axis=-1)
    noise = _background_per_pixel(counts)
    share = noise / np.maximum(uniform_filter(photons, 3), noise)
    near = np.abs(times_ns - times_ns[median][..., None]) < 2 * width_ns * (1 + share)[..., None]
    return _smoothed(half, counts * near, smoothing)


def rapp_goyal_2017(half: Half, *, smoothing: float) -> Floats:
    """Depth by Rapp and Goyal, IEEE Trans. Comput. Imaging 3, 445 (2017), unmixing of background.

    A pixel borrows photons from windows of growing size until so many fall into one pulse width
    that background rarely does that; its own photons there are kept, and depth is the
    total-variation estimate of those.
    """
    counts = half.counts[..., half.calibration.bins.codes].astype(np.float64)
    times_ns = half.times_ns
    _, width_ns = half.pulse_width_ns
    code_ns = times_ns[1] - times_ns[0]
    window = max(1, round(4 * width_ns / code_ns))
    center = np.zeros(counts.shape[:2], int)
    found = np.zeros(counts.shape[:2], bool)
    for size in SUPERPIXELS:
        shared = uniform_filter(counts, (size, size, 1), mode="constant") * size**2
        inside = uniform_filter(shared, (1, 1, window), mode="wrap") * window
        most, total = inside.max(axis=-1).round(), shared.sum(axis=-1).round()
        # of all windows that could hold so many, of which about codes / window are independent
        chance = binom.sf(most - 1, total, window / times_ns.size) * times_ns.size / window
        new = ~found & (most > 1) & (chance < FALSE_ALARMS)
        center[new] = inside.argmax(axis=-1)[new]
        found |= new
    near = np.abs(np.arange(times_ns.size) - center[..., None]) <= window / 2
    return _smoothed(half, counts * (near & found[..., None]), smoothing)


def _background_per_pixel(counts: Floats) -> float:
    """Mean photons of background per pixel: what the emptier half of the codes holds, doubled."""
    per_code = np.sort(counts.mean(axis=(0, 1)))
    return float(2 * per_code[: per_code.size // 2].sum())


def _smoothed(half: Half, kept: Floats, smoothing: float) -> Floats:
    """Minimize the squared distances of the photons kept, in pulse widths, + total variation."""
    mean_ns, width_ns = half.pulse_width_ns
    number = kept.sum(axis=-1)
    times_ns = half.times_ns
    with np.errstate(invalid="ignore", divide="ignore"):
        measured = kept @ times_ns / number
    start = np.nanmedian(measured)
    measured = np.where(number > 0, measured, start)
    delay_ns = total_variation(measured / width_ns, number, smoothing) * width_ns
    return (delay_ns - mean_ns) * METERS_PER_NS


def total_variation(values: Floats, weights: Floats, smoothing: float) -> Floats:
    """Minimize Σ weights·(x − values)²/2 + smoothing·TV(x): Chambolle and Pock (2011), alg. 1."""
    step = 1 / np.sqrt(8)
    x = leading = values.copy()
    down, right = np.zeros_like(values), np.zeros_like(values)
    for _ in range(ITERATIONS):
        down[:-1] += step * np.diff(leading, axis=0)
        right[:, :-1] += step * np.diff(leading, axis=1)
        length = np.maximum(1, np.hypot(down, right) / smoothing)
        down, right = down / length, right / length
        gradient = -down - right
        gradient[1:] += down[:-1]
        gradient[:, 1:] += right[:, :-1]
        new = (x - step * gradient + step * weights * values) / (1 + step * weights)
        leading, x = 2 * new - x, new
    return x
