# SPDX-License-Identifier: Apache-2.0
"""Whether a pixel shows a surface at all, for methods whose fit is not that of the joint method.

A pixel shows a surface if pulses at some delay explain its counts better than background alone; how
well its method then finds that delay is another question. Counts in the windows of the bands tell
bright pixels at once. The others get the joint fit, whose likelihood ratio is compared with the
threshold that `hueflight.fit.detection` describes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration, window_sums
from hueflight.fit.tables import detection_threshold
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.joint import fit_chosen, search_range_ns, tables_for_calibration
from hueflight.reconstruction.options import EstimatorOptions

#: Twice the log-likelihood ratio above which there is a surface without a closer look: of all
#: windows together against the rest, and of each band's windows and the rest. With nine bands,
#: background alone exceeds either at one of twenty delays in less than one of 50 000 pixels.
PLAIN = 28.0
PLAIN_BANDS = 45.0
PEAK_MARGIN = 1.1  #: by which a peak may be higher where its delay falls otherwise among the bins


def without_return(
    prepared: PreparedHistogram,
    calibration: Calibration,
    options: EstimatorOptions,
    chosen: NDArray[np.bool_],
    sums: NDArray[np.float64],
    shift: NDArray[np.intp],
) -> NDArray[np.bool_]:
    """Find the pixels whose counts background alone explains.

    Parameters
    ----------
    prepared : PreparedHistogram
        The histogram, checked and in time order.
    calibration : Calibration
        Calibration of the same instrument.
    options : EstimatorOptions
        What was asked for.
    chosen : ndarray of bool, shape (row, col)
        Pixels to test.
    sums : ndarray of float, shape (band, pixel)
        Counts of the chosen pixels, in order, in the windows of each band.
    shift : ndarray of int, shape (pixel,)
        Whole bins by which the windows were moved.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True where a pixel was tested and shows no surface.
    """
    absent = np.zeros(chosen.shape, bool)
    doubtful = chosen.copy()
    doubtful[chosen] = ~_plain(sums, shift, prepared.photons[chosen], calibration)
    if not doubtful.any():
        return absent
    search_ns = search_range_ns(calibration, None)
    least = detection_threshold(search_ns)
    absent = doubtful & (prepared.photons * _most_per_photon(calibration) < least)
    doubtful &= ~absent
    shape = prepared.light.shape
    fitted = fit_chosen(
        prepared.light.reshape(-1, shape[-1]),
        doubtful,
        prepared.photons,
        prepared.exposures if options.pileup_correction else None,
        calibration,
        tables_for_calibration(calibration, search_ns),
        skips=replace(options.skips, assessment=False),
        threads=options.threads,
    )
    absent[doubtful] = fitted.detection < least
    return absent


def _most_per_photon(calibration: Calibration) -> float:
    """Most that one photon can add to twice the log-likelihood ratio.

    Nowhere is light more likely than at the peak of the most concentrated band.
    """
    bins = calibration.bins
    density = calibration.templates.shares(bins.edges_ns) / bins.widths_ns * bins.span_ns
    return 2 * float(np.log(max(PEAK_MARGIN * density.max(), 1.0)))


def _plain(
    sums: NDArray[np.float64],
    shift: NDArray[np.intp],
    photons: NDArray[np.float64],
    calibration: Calibration,
) -> NDArray[np.bool_]:
    """Whether the windows alone show that there is a surface, (pixel,)."""
    if not photons.size:
        return np.zeros(0, bool)
    bins = calibration.bins
    steps = np.arange(shift.min(), shift.max() + 1)
    shares = window_sums(  # of background, for each shift
        np.broadcast_to(bins.widths_ns / bins.widths_ns.sum(), (steps.size, bins.count)),
        calibration.windows,
        steps,
        bands=len(calibration.instrument.bands),
        circular=bins.period_ns is not None,
    )
    inside = sums.sum(axis=0)
    expected = shares.sum(axis=0).max() * photons
    both = np.stack([inside, photons - inside]), np.stack([expected, photons - expected])
    plain = (inside > expected) & (deviance(*both) > PLAIN)
    rest = np.flatnonzero(~plain)
    if rest.size:
        expected = shares[:, shift[rest] - steps[0]] * photons[rest]
        groups = [
            np.vstack([part, photons[rest] - part.sum(axis=0)])
            for part in (sums[:, rest], expected)
        ]
        plain[rest] = deviance(*groups) > PLAIN_BANDS
    return plain


def deviance(counts: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.float64]:
    """Twice the log-likelihood ratio of groups' own shares against expected ones.

    Parameters
    ----------
    counts : ndarray, shape (group, pixel)
        Counts of the groups.
    expected : ndarray, shape (group, pixel)
        Expected counts, with the same sum over the groups.

    Returns
    -------
    ndarray of float, shape (pixel,)
        The ratio, 0 where the counts are the expected ones.
    """
    ratio = np.maximum(counts, 1e-30) / np.maximum(expected, 1e-30)
    return 2 * (counts * np.log(ratio)).sum(axis=0)
