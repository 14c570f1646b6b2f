# SPDX-License-Identifier: Apache-2.0
"""Tell which pixels of a new histogram differ from the last one that was fitted.

Sums of the counts of the two histograms are compared in units of the standard deviation of their
difference: of all counts, of the counts where each band's pulse lies, and of the counts weighted as
a small change of delay would change them. Where none stands out, depth and reflectance have not
changed as far as photons can tell.

Of the earlier histogram only these sums are kept, and the weights, as whole numbers: any weights
that do not depend on the new counts make a fair test, and whole numbers to 127 lose nothing of its
power that could be measured, but are read in a live picture four times as fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit import MOST_WEIGHT, REFERENCE_MULTIPLE
from hueflight.fit.reference import FLOOR_PHOTONS, FLOOR_SHARE, Fit
from hueflight.fit.tables import ModelTables, by_phase

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ChangeReference:
    """What later counts of pixels are compared with.

    Attributes
    ----------
    weights : ndarray of int8, shape (pixel, room)
        Derivative of the fit's expected counts by the delay in each wide bin of the search,
        relative to themselves and to the greatest; bins that make up a whole multiple hold 0.
    sums : ndarray of float32, shape (pixel, 3 + band)
        Sums of the counts: with the squares of the weights, with the weights, all, and in each
        band's zone.
    delays_ns : ndarray of float32, shape (pixel,)
        Delays that were found, including those of the pixels themselves, which tell the zones.
    """

    weights: NDArray[np.int8]
    sums: NDArray[np.float32]
    delays_ns: NDArray[np.float32]

    def take(self, pixels: NDArray[np.integer]) -> ChangeReference:
        """Return the references of some of the pixels.

        Parameters
        ----------
        pixels : ndarray of int
            Pixels to take.

        Returns
        -------
        ChangeReference
            Their references.
        """
        return ChangeReference(self.weights[pixels], self.sums[pixels], self.delays_ns[pixels])

    def put(self, pixels: NDArray[np.integer], other: ChangeReference) -> None:
        """Replace the references of some pixels.

        Parameters
        ----------
        pixels : ndarray of int
            Pixels to replace.
        other : ChangeReference
            Their new references.
        """
        self.weights[pixels] = other.weights
        self.sums[pixels] = other.sums
        self.delays_ns[pixels] = other.delays_ns


def no_reference(pixels: int, tables: ModelTables) -> ChangeReference:
    """Return references that are 0, to be filled.

    Parameters
    ----------
    pixels : int
        Number of pixels.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ChangeReference
        The empty references.
    """
    room = -(-tables.search.starts.size // REFERENCE_MULTIPLE) * REFERENCE_MULTIPLE
    return ChangeReference(
        np.zeros((pixels, room), np.int8),
        np.zeros((pixels, 3 + tables.bands), np.float32),
        np.zeros(pixels, np.float32),
    )


def change_reference(
    light: NDArray[Any], found: Fit, offsets_ns: _Floats, tables: ModelTables
) -> ChangeReference:
    """Return what later counts are compared with.

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
    ChangeReference
        Weights and sums of the pixels.
    """
    level = tables.wide
    counts = tables.wide_counts(light)
    made = no_reference(len(counts), tables)
    made.delays_ns[:] = found.delay_ns + offsets_ns
    amplitudes = np.maximum(found.amplitudes, 0)
    background = np.maximum(found.background, FLOOR_PHOTONS + FLOOR_SHARE * counts.sum(axis=-1))
    for phase, chosen in by_phase(level.phase_of(found.delay_ns + offsets_ns)):
        mean = amplitudes[chosen] @ level.shares[phase] + background[chosen, None] * level.widths
        steep = (amplitudes[chosen] @ level.slopes[phase]) / mean
        steepest = np.abs(steep).max(axis=-1, keepdims=True)
        scale = np.divide(MOST_WEIGHT, steepest, out=np.zeros_like(steepest), where=steepest > 0)
        made.weights[chosen, : counts.shape[1]] = np.rint(steep * scale)
    made.sums[:] = _sums(counts, made, tables)
    return made


def change_significance(
    now: NDArray[Any], reference: ChangeReference, scales: _Floats, tables: ModelTables
) -> _Floats:
    """Return the greatest difference of each pixel in standard deviations.

    Parameters
    ----------
    now : ndarray, shape (pixel, bin)
        New counts.
    reference : ChangeReference
        The same pixels at their last fit; see `change_reference`.
    scales : ndarray of float, shape (pixel,)
        Exposures now per exposure then.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Significance of the change.
    """
    seen = _sums(tables.wide_counts(now), reference, tables)
    kept = reference.sums.astype(np.float64)
    scale = scales[:, None]
    gaps, sizes = seen - scale * kept, seen + scale**2 * kept  # the variance of a sum is the sum
    # but that of the sum with the weights is the sum with their squares
    gaps, sizes = gaps[:, 1:], np.delete(sizes, 1, axis=1)
    ratios = np.divide(gaps**2, sizes, out=np.zeros_like(gaps), where=sizes > 0)
    return np.sqrt(ratios.max(axis=-1))


def _sums(counts: _Floats, reference: ChangeReference, tables: ModelTables) -> _Floats:
    """Sums of counts (pixel, wide bin) as `ChangeReference` has them."""
    weights = reference.weights[:, : counts.shape[1]].astype(np.float64)
    zones = np.empty((len(counts), tables.bands))
    lags_ns = tables.search.lags_ns
    nearest = np.abs(lags_ns - reference.delays_ns[:, None]).argmin(axis=-1)
    for lag, chosen in by_phase(nearest):
        zones[chosen] = counts[chosen] @ tables.search.zones(lag).T
    weighted = [(weights**power * counts).sum(axis=-1) for power in (2, 1, 0)]
    return np.column_stack([*weighted, zones])
