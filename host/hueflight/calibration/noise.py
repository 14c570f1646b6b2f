# SPDX-License-Identifier: Apache-2.0
"""What the photons of the captures leave unknown of waveforms and brightness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import Instrument
from hueflight.model.pileup import arrivals_per_exposure, photons_per_period, variance_factor
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates

LEAST_SHARE = 1e-6  #: of the highest expected count, below which bins say nothing


def correction_noise(
    hits: NDArray[np.float64], exposures: NDArray[np.float64] | None, instrument: Instrument
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute how much more counts corrected for lost photons scatter than Poisson counts.

    Parameters
    ----------
    hits : ndarray of float
        Photons that were recorded.
    exposures : ndarray of float, or None
        Exposures behind them; None where nothing was corrected.
    instrument : Instrument
        Instrument whose period and exposure time apply.

    Returns
    -------
    shape : ndarray of float
        Variance over that of Poisson counts, of as many photons as arrived, for what rests on the
        distribution of the photons over time.
    total : ndarray of float
        The same for their number.
    """
    per_period = photons_per_period(hits, exposures, instrument)
    if per_period is None or exposures is None:
        return np.ones_like(hits), np.ones_like(hits)
    arrivals = arrivals_per_exposure(hits, exposures)
    lost = np.where(hits > 0, arrivals * exposures / np.maximum(hits, 1e-300), 1.0)
    return lost * variance_factor(per_period), lost * variance_factor(arrivals)


def waveform_noise(
    photons: NDArray[np.float64],
    background: NDArray[np.float64],
    templates: Templates,
    bins: TimeBins,
    *,
    together: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute how well the place of each waveform and its brightness are known.

    Parameters
    ----------
    photons : ndarray of float, shape (band,)
        Photons of each band, of all pixels together.
    background : ndarray of float, shape (band,)
        Photons of background in the capture of each band; the same number in all where they were
        captured together.
    templates : Templates
        The waveforms.
    bins : TimeBins
        Bins of the counts.
    together : bool
        All bands are in one capture, where they overlap.

    Returns
    -------
    delay_std_ns : ndarray of float, shape (band,)
        Standard deviation of the place in time, ns.
    photons_std : ndarray of float, shape (band,)
        Standard deviation of the photons.
    """
    shares, slopes = templates.shares(bins.edges_ns), templates.slopes(bins.edges_ns)
    flat = bins.widths_ns / bins.span_ns
    mean = photons[:, None] * shares + background[:, None] * flat
    if together:
        mean = np.broadcast_to(photons @ shares + background[0] * flat, shares.shape)
    mean = np.maximum(mean, LEAST_SHARE * mean.max())
    delay = photons**2 * (slopes**2 / mean).sum(axis=-1)
    deviations = np.empty(photons.size)
    for band in range(photons.size):
        rows = np.vstack([shares if together else shares[[band]], flat])
        inverse = np.linalg.pinv((rows / mean[band]) @ rows.T)
        deviations[band] = np.sqrt(inverse[band if together else 0, band if together else 0])
    return 1 / np.sqrt(np.maximum(delay, 1e-300)), deviations
