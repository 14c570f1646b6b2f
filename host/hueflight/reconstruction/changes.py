"""Which pixels of a new histogram say no more than the last one that was fitted.

Contrasts between the two histograms, each in units of its own standard deviation: all counts, the
counts where each band's pulse lies, and the counts weighed as a small change of delay would change
them. Where none stands out, depth and reflectance have not changed as far as photons can tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.reconstruction.fit import FLOOR_PHOTONS, FLOOR_SHARE, Fit, by_phase
from hueflight.reconstruction.plan import Plan


def wide_sums(light: NDArray[Any], plan: Plan) -> NDArray[np.float64]:
    """Counts (pixel, bin) in the wide bins of the search: what is compared, and kept for it."""
    return plan.coarse.summed(plan.fine.summed(np.asarray(light, np.float64)))


def contrasts(
    now: NDArray[Any],
    then: NDArray[Any],
    scales: NDArray[np.float64],
    found: Fit,
    offsets_ns: NDArray[np.float64],
    plan: Plan,
) -> NDArray[np.float64]:
    """Greatest contrast (pixel,) in standard deviations.

    Parameters
    ----------
    now : (pixel, bin) counts.
    then : (pixel, wide bin) those behind `found`, as `wide_sums` gives.
    scales : (pixel,) exposures now per exposure then.
    found : fit of the pixels as they were.
    offsets_ns : (pixel,) delay that belongs to the pixel.
    """
    level, coarse = plan.rough, plan.coarse
    a = wide_sums(now, plan)
    b = np.asarray(then, np.float64)
    gap = a - scales[:, None] * b
    size = a + scales[:, None] ** 2 * b  # variance of a gap
    most = _ratio(gap.sum(axis=-1), size.sum(axis=-1))
    delay = found.delay_ns + offsets_ns
    amplitudes = np.maximum(found.amplitudes, 0)
    background = np.maximum(found.background, FLOOR_PHOTONS + FLOOR_SHARE * b.sum(axis=-1))
    for phase, chosen in by_phase(level.phase_of(delay)):
        mean = amplitudes[chosen] @ level.shares[phase] + background[chosen, None] * level.widths
        steep = (amplitudes[chosen] @ level.slopes[phase]) / mean
        along, across = (steep * gap[chosen]).sum(-1), (steep**2 * size[chosen]).sum(-1)
        most[chosen] = np.maximum(most[chosen], _ratio(along, across))
    nearest = np.abs(coarse.lags_ns - delay[:, None]).argmin(axis=-1)
    for lag, chosen in by_phase(nearest):
        zones = coarse.zones[:, :, lag].T
        ratio = _ratio(gap[chosen] @ zones, size[chosen] @ zones)
        most[chosen] = np.maximum(most[chosen], ratio.max(axis=-1))
    return np.sqrt(most)


def _ratio(gap: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.divide(gap**2, size, out=np.zeros_like(gap), where=size > 0)
