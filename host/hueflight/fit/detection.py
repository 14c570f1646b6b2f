# SPDX-License-Identifier: Apache-2.0
"""Whether a pixel shows a surface at all: likelihood ratio of pulses against background alone.

Twice the log-likelihood ratio at the fit's own parameters is compared with one threshold for any
number of photons. Under background alone the fit has searched all delays and set every band's
amplitude to what suits it best; the ratio's distribution then hardly depends on the number of
photons from ten to a hundred thousand, and its upper tail falls by a factor e with each two units.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.tables import ModelTables, by_phase

BACKGROUND_SHARE = 0.02  #: share of all counts that background has at least
CERTAIN_PHOTONS = 100.0  #: a delay that is known as well as by so many photons of a white target
#: without background can't come from background alone, and is not tested


def log_likelihood_ratio(
    counts: NDArray[np.float64],
    delays_ns: NDArray[np.float64],
    amplitudes: NDArray[np.float64],
    background: NDArray[np.float64],
    tables: ModelTables,
) -> NDArray[np.float64]:
    """Twice the log-likelihood ratio of each pixel's fit against background alone.

    Parameters
    ----------
    counts : ndarray, shape (pixel, bin)
        Counts at the bins of the search: a few to a pulse, which loses next to nothing.
    delays_ns : ndarray, shape (pixel,)
        Arrival in the pixel, its own delay included, ns.
    amplitudes : ndarray, shape (pixel, band)
        Photons of each band; negative ones count as none.
    background : ndarray, shape (pixel,)
        Photons of background over all bins.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray, shape (pixel,)
        The ratio; NaN for a pixel without a photon.
    """
    level = tables.wide
    total = counts.sum(axis=-1)
    amplitudes = np.maximum(amplitudes, 0.0)
    flat = np.maximum(background, BACKGROUND_SHARE * total)
    ratio = np.full(len(counts), np.nan)
    for phase, chosen in by_phase(level.phase_of(delays_ns)):
        h, n = counts[chosen], total[chosen, None]
        mean = amplitudes[chosen] @ level.shares[phase] + flat[chosen, None] * level.widths
        with np.errstate(divide="ignore", invalid="ignore"):
            mean *= n / mean.sum(axis=-1, keepdims=True)
            gain = np.where(h > 0, h * np.log(mean / (n * level.widths)), 0.0)
        ratio[chosen] = 2 * gain.sum(axis=-1)
    return np.where(total > 0, ratio, np.nan)
