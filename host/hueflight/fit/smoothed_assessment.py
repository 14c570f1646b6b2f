# SPDX-License-Identifier: Apache-2.0
"""How well the fit explains counts that were smoothed because the bins do not resolve the pulse.

Counts averaged 1 : 2 : 1 over neighboring bins (`model.undersampling`) scatter less than Poisson
counts, and neighbors scatter together. A smooth error of the model, however, passes the average
unchanged. The deviance of the smoothed counts, less what their own scatter gives, is therefore what
the model's error adds to the deviance of the counts themselves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.assessment import gamma_score
from hueflight.fit.tables import ModelTables, by_phase

SCATTER = 6 / 16  #: variance of a count averaged 1 : 2 : 1, of that of the count itself
EFFECTIVE = 0.514  #: degrees of freedom for each bin: 2 (mean)² / variance, neighbors included
LEAST_EXPECTED = 5.0  #: counts of a bin, from which its deviance is on average `SCATTER`
LEAST_BACKGROUND = 0.5  #: photons of background over all bins, at least
SYSTEMATIC = 2.0  #: common misfit from which misfits differ by more than chance
SYSTEMATIC_FREEDOM = 6.0  #: directions of a smooth error of the model, whose size differs

_Floats = NDArray[np.float64]


def smoothed_misfit(
    counts: _Floats,
    delays_ns: _Floats,
    amplitudes: _Floats,
    background: _Floats,
    tables: ModelTables,
) -> tuple[_Floats, _Floats]:
    """Compute the deviance per degree of freedom that the counts had before they were smoothed.

    Parameters
    ----------
    counts : ndarray, shape (pixel, bin)
        Smoothed counts.
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
    misfit : ndarray, shape (pixel,)
        1 on average where the model is right; NaN where too few bins expect `LEAST_EXPECTED`
        counts.
    freedom : ndarray, shape (pixel,)
        Degrees of freedom.
    """
    level = tables.fine
    counts = level.summed(np.asarray(counts, np.float64))
    misfit, freedom = np.empty((2, len(counts)))
    parameters = amplitudes.shape[1] + 2
    amplitudes = np.maximum(amplitudes, 0.0)
    flat = np.maximum(background, LEAST_BACKGROUND)
    for phase, chosen in by_phase(level.phase_of(delays_ns)):
        rest_ns = delays_ns[chosen] - (level.first_ns + phase * level.phase_ns)
        shares, slopes = (table[phase].astype(float) for table in (level.shares, level.slopes))
        mean = amplitudes[chosen] @ shares + flat[chosen, None] * level.widths
        mean = np.maximum(mean + (amplitudes[chosen] @ slopes) * rest_ns[:, None], 1e-9)
        h, told = counts[chosen], mean >= LEAST_EXPECTED
        parts = 2 * (mean - h + np.where(h > 0, h * np.log(np.maximum(h, 1e-9) / mean), 0.0))
        bins = told.sum(axis=-1)
        expected = SCATTER * bins - parameters
        misfit[chosen] = 1 + ((parts * told).sum(axis=-1) - expected) / np.maximum(bins, 1)
        freedom[chosen] = EFFECTIVE * bins - parameters
    misfit[freedom < 1] = np.nan
    return misfit, freedom


def smoothed_score(misfit: _Floats, freedom: _Floats, common: float) -> _Floats:
    """Standard normal score of a pixel's misfit beyond that which all pixels have in common.

    Parameters
    ----------
    misfit, freedom : ndarray, shape (pixel,)
        What `smoothed_misfit` gives.
    common : float
        Misfit of the image as a whole, 1 or more.

    Returns
    -------
    ndarray, shape (pixel,)
        Scores. From a common misfit of `SYSTEMATIC` on, misfits differ from pixel to pixel by more
        than chance: they then have `SYSTEMATIC_FREEDOM` degrees of freedom.
    """
    if common > SYSTEMATIC:
        freedom = np.full_like(freedom, SYSTEMATIC_FREEDOM)
    return gamma_score(np.maximum(misfit, 0.0) / common, np.maximum(freedom, 1.0) / 2)
