# SPDX-License-Identifier: Apache-2.0
"""Tell which pixels of a new histogram differ from the last one that was fitted.

Counts of the two histograms are compared in units of the standard deviation of their difference:
all counts, the counts where each band's pulse lies, and the counts weighted as a small change of
delay would change them. Where none stands out, depth and reflectance have not changed as far as
photons can tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit import REFERENCE_MULTIPLE
from hueflight.fit.reference import FLOOR_PHOTONS, FLOOR_SHARE, Fit
from hueflight.fit.tables import ModelTables, by_phase


def change_reference(
    light: NDArray[Any], found: Fit, offsets_ns: NDArray[np.float64], tables: ModelTables
) -> NDArray[np.float32]:
    """Return what later counts are compared with.

    Of each pixel this is its counts in the wide bins of the search, and the derivative of the fit's
    expected counts there by the delay, relative to themselves, per ns. Bins that make up a whole
    multiple hold 0.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts behind `found`.
    found : Fit
        Fit of the pixels.
    offsets_ns : ndarray of float, shape (pixel,)
        Delay that belongs to the pixel itself.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray of float32, shape (pixel, 2, room)
        Counts and derivatives.
    """
    level = tables.wide
    counts = _wide_sums(light, tables)
    bins = counts.shape[1]
    memory = np.zeros(
        (len(counts), 2, -(-bins // REFERENCE_MULTIPLE) * REFERENCE_MULTIPLE), np.float32
    )
    memory[:, 0, :bins] = counts
    amplitudes = np.maximum(found.amplitudes, 0)
    background = np.maximum(found.background, FLOOR_PHOTONS + FLOOR_SHARE * counts.sum(axis=-1))
    for phase, chosen in by_phase(level.phase_of(found.delay_ns + offsets_ns)):
        mean = amplitudes[chosen] @ level.shares[phase] + background[chosen, None] * level.widths
        memory[chosen, 1, :bins] = (amplitudes[chosen] @ level.slopes[phase]) / mean
    return memory


def change_significance(
    now: NDArray[Any],
    memory: NDArray[np.float32],
    scales: NDArray[np.float64],
    delays_ns: NDArray[np.float64],
    tables: ModelTables,
) -> NDArray[np.float64]:
    """Return the greatest difference of each pixel in standard deviations.

    Parameters
    ----------
    now : ndarray, shape (pixel, bin)
        New counts.
    memory : ndarray of float32, shape (pixel, 2, room)
        The same pixels at their last fit; see `change_reference`.
    scales : ndarray of float, shape (pixel,)
        Exposures now per exposure then.
    delays_ns : ndarray of float, shape (pixel,)
        Delays that were found, including those of the pixels themselves.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Significance of the change.
    """
    search = tables.search
    a = _wide_sums(now, tables)
    b, steep = np.asarray(memory[:, :, : a.shape[1]], np.float64).swapaxes(0, 1)
    gap = a - scales[:, None] * b
    size = a + scales[:, None] ** 2 * b  # variance of a gap
    most = _ratio(gap.sum(axis=-1), size.sum(axis=-1))
    along, across = (steep * gap).sum(axis=-1), (steep**2 * size).sum(axis=-1)
    most = np.maximum(most, _ratio(along, across))
    nearest = np.abs(search.lags_ns - delays_ns[:, None]).argmin(axis=-1)
    for lag, chosen in by_phase(nearest):
        zones = search.zones(lag).T
        ratio = _ratio(gap[chosen] @ zones, size[chosen] @ zones)
        most[chosen] = np.maximum(most[chosen], ratio.max(axis=-1))
    return np.sqrt(most)


def _wide_sums(light: NDArray[Any], tables: ModelTables) -> NDArray[np.float64]:
    """Return counts (pixel, wide bin)."""
    return tables.search.summed(tables.fine.summed(np.asarray(light, np.float64)))


def _ratio(gap: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.divide(gap**2, size, out=np.zeros_like(gap), where=size > 0)
