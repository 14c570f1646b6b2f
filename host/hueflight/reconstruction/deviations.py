# SPDX-License-Identifier: Apache-2.0
"""What stated deviations contain besides the photon noise that the fit computes.

1. *Strong background.* The fit takes the information about the delay at the amplitudes that it
   found. Against background it grows with the square of an amplitude, so that noise of the
   amplitudes makes it too large on average, by half its second derivative times their variance.
2. *Detection.* Pixels that barely pass the test for a surface owe it to noise in their favor. The
   likelihood given that the test was passed says by how much; the square root of that factor holds
   between pulses that stand out and pulses in the background.
3. *Pile-up.* Counts that were corrected for lost photons scatter more than Poisson counts.
4. *Misfit* that all pixels have in common, such as that of a pulse which differs from the
   calibrated one: variances are multiplied by it.
5. *Noise of the calibration*: delay and brightness of each pixel, waveform and brightness of each
   band.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from hueflight.calibration import Calibration
from hueflight.fit.assessment import LARGEST_LOSS
from hueflight.fit.reference import Fit
from hueflight.fit.tables import ModelTables
from hueflight.model.instrument import Instrument
from hueflight.model.pileup import (
    arrivals_per_exposure,
    correction_weights,
    periods_per_exposure,
    variance_factor,
)

MOST_BIAS = 0.75  #: share of the information that is taken back, at most
LEAST_BIAS = 0.002  #: share that makes no difference
PLAIN_MISFIT = 2.5  #: median χ² per degree of freedom that a few pixels don't reach by chance
SIGN_TEST = 1.5  #: times the root of the number of pixels: three standard deviations
RATIOS = np.geomspace(1e-3, 1e3, 121)  #: photons of a band per photon of background, in tables
LEAST_OPEN = 0.05  #: share of the periods that must be open at their end
LEAST_EMPTY = 0.01  #: share of the exposures that must be empty
WORST_LUCK = 2.0  #: standard deviations of noise in a pixel's favor, at most

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class _DelayInformation:
    """Information about the delay that a band gives, over the ratio of its photons to background.

    Attributes
    ----------
    value : ndarray, shape (ratio, band)
        Information per photon of background, 1/ns².
    bias : ndarray, shape (ratio, band)
        Half its second derivative by the ratio.
    """

    value: _Floats
    bias: _Floats

    def at(self, ratios: _Floats) -> tuple[_Floats, _Floats]:
        """Return both at ratios (pixel, band)."""
        # single precision places a ratio to a millionth, in a third of the time
        place = np.log(np.maximum(ratios, RATIOS[0]), dtype=np.float32, casting="same_kind")
        place -= np.float32(np.log(RATIOS[0]))
        place *= np.float32(1 / np.log(RATIOS[1] / RATIOS[0]))
        below = np.minimum(place.astype(np.int32), RATIOS.size - 2)
        above = np.minimum(place - below, np.float32(1))
        bands = ratios.shape[-1]
        entry = below * bands + np.arange(bands, dtype=np.int32)
        value, bias = (
            np.take(table, entry) + np.take(np.diff(table, axis=0), entry) * above
            for table in (self.value, self.bias)
        )
        return value, bias


_kept: WeakKeyDictionary[Calibration, _DelayInformation] = WeakKeyDictionary()


def common_misfit(chi_square: _Floats) -> float:
    """Return the misfit that the pixels of an image have in common.

    Parameters
    ----------
    chi_square : ndarray
        Pearson's χ² per degree of freedom of each pixel that has a result; NaN where it is not
        known.

    Returns
    -------
    float
        The median, where more pixels lie above 1 than chance would put there or the median is
        above `PLAIN_MISFIT`; else 1.
    """
    known = chi_square[np.isfinite(chi_square)]
    if not known.size:
        return 1.0
    median = float(np.median(known))
    above = np.count_nonzero(known > 1) - known.size / 2
    told = above >= SIGN_TEST * np.sqrt(known.size) or median > PLAIN_MISFIT
    return max(median, 1.0) if told else 1.0


def delay_variance(
    found: Fit, chosen: NDArray[np.bool_], calibration: Calibration, *, misfit: float, least: float
) -> _Floats:
    """Return the variance of the delay with everything that it depends on.

    Parameters
    ----------
    found : Fit
        Fit of the chosen pixels, in order.
    chosen : ndarray of bool, shape (row, col)
        Pixels that were fitted.
    calibration : Calibration
        Calibration of the same instrument.
    misfit : float
        Misfit that all pixels have in common, 1 or more.
    least : float
        Detection ratio from which a pixel counts as a surface.

    Returns
    -------
    ndarray, shape (pixel,)
        Variances, ns².
    """
    variance = found.delay_std_ns**2 * misfit
    variance *= np.sqrt(_detection_factor(found.detection, least))
    background = np.maximum(found.background, 1.0)[:, None]
    amplitudes = np.maximum(found.amplitudes, 0.0)
    ratios = amplitudes / background
    value, bias = _information_for(calibration).at(ratios)
    by_band = ratios**2 * value
    total = np.maximum(by_band.sum(axis=-1), 1e-300)
    taken = (found.amplitude_std**2 / background**2 * bias).sum(axis=-1) / total
    variance /= 1 - np.where(taken > LEAST_BIAS, np.minimum(taken, MOST_BIAS), 0.0)
    if calibration.waveform_delay_std_ns is not None:
        influence = by_band / total[:, None]
        variance += influence**2 @ calibration.waveform_delay_std_ns**2
    return variance + calibration.pixel_delay_std_ns[chosen] ** 2


def brightness_variance(calibration: Calibration) -> _Floats:
    """Return the variance of reflectance, relative to its square, that the calibration leaves.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    ndarray, shape (row, col, band)
        Variances; 0 where the calibration was made by a version that did not state them.
    """
    bands = calibration.brightness.size
    variance = np.zeros((*calibration.flat_field.shape, bands))
    if calibration.flat_field_std is not None:
        variance += ((calibration.flat_field_std / calibration.flat_field) ** 2)[..., None]
    if calibration.brightness_std is not None:
        variance += (calibration.brightness_std / calibration.brightness) ** 2
    return variance


def _information_for(calibration: Calibration) -> _DelayInformation:
    if calibration not in _kept:
        edges_ns, span_ns = calibration.bins.edges_ns, calibration.bins.span_ns
        templates, flat = calibration.templates, calibration.bins.widths_ns / span_ns
        slopes = templates.slopes(edges_ns) ** 2
        shares = templates.shares(edges_ns)

        def value(ratio: float) -> _Floats:
            return (slopes / (ratio * shares + flat)).sum(axis=-1)

        def bias(ratio: float) -> _Floats:
            # half the second derivative of ratio² / (ratio · share + flat)
            return (slopes * flat**2 / (ratio * shares + flat) ** 3).sum(axis=-1)

        _kept[calibration] = _DelayInformation(
            np.array([value(ratio) for ratio in RATIOS]),
            np.array([bias(ratio) for ratio in RATIOS]),
        )
    return _kept[calibration]


def add_pileup_noise(
    found: Fit,
    light: NDArray[np.floating],
    offsets_ns: _Floats,
    per_period: _Floats,
    tables: ModelTables,
) -> None:
    """Increase the deviations of pixels whose counts were corrected for pile-up in a period.

    Parameters
    ----------
    found : Fit
        Fit, whose deviations are changed.
    light : ndarray, shape (pixel, bin)
        Counts as they were recorded, in time order.
    offsets_ns : ndarray of float, shape (pixel,)
        Delay that belongs to the pixel itself, ns.
    per_period : ndarray of float, shape (pixel,)
        Photons per period.
    tables : ModelTables
        Tables of the fit.
    """
    level = tables.fine
    phases = level.phase_of(found.delay_ns + offsets_ns)
    groups = np.diff([*level.starts, light.shape[-1]])
    bright = np.flatnonzero(per_period > LARGEST_LOSS)
    bright = bright[np.argsort(phases[bright], kind="stable")]
    # pixels of one phase share its rows of the tables, which are made when asked for
    for some in (
        np.split(bright, np.flatnonzero(np.diff(phases[bright])) + 1) if bright.size else ()
    ):
        phase = int(phases[some[0]])
        shares = level.shares[phase].astype(np.float64)
        slopes = level.slopes[phase].astype(np.float64)
        weights = correction_weights(light[some].astype(np.float64), per_period[some])
        weights = np.add.reduceat(weights, level.starts, axis=-1) / groups
        amplitudes = np.maximum(found.amplitudes[some], 0.0)
        background = np.maximum(found.background[some], 1.0)[:, None]
        told = (amplitudes @ slopes) ** 2 / (amplitudes @ shares + background * level.widths)
        information = np.maximum(told.sum(axis=-1), 1e-300)
        found.delay_std_ns[some] *= np.sqrt((told * weights).sum(axis=-1) / information)
        found.amplitude_std[some] *= np.sqrt(
            weights @ shares.T / np.maximum(shares.sum(axis=-1), 1e-300)
        )


def total_variance(photons: _Floats, exposures: _Floats, instrument: Instrument) -> _Floats:
    """Return what the correction of lost photons adds to the variance of all bands together.

    Parameters
    ----------
    photons : ndarray of float, shape (pixel,)
        Photons that were recorded.
    exposures : ndarray of float, shape (pixel,)
        Exposures.
    instrument : Instrument
        Instrument whose period and exposure time apply.

    Returns
    -------
    ndarray, shape (pixel,)
        Variance relative to the square of the brightness, without the part of Poisson counts and
        without what `add_pileup_noise` adds.
    """
    arrivals = arrivals_per_exposure(photons, exposures)
    whole = variance_factor(arrivals)
    per_period = arrivals / periods_per_exposure(instrument)
    return np.maximum(whole - variance_factor(per_period), 0.0) / np.maximum(photons, 1.0)


def is_piled_up(
    photons: _Floats, exposures: _Floats | None, instrument: Instrument
) -> NDArray[np.bool_]:
    """Return where occupancy leaves too little for the correction of lost photons.

    At the end of a period the share exp(−r) of the periods can still record a photon, with r
    photons per period: counts of the last pulse are divided by it. Below `LEAST_OPEN`, an error of
    0.1 % in the number of exposures changes the last band by 2 % or more. Over a whole exposure,
    brightness rests on the exposures that stayed empty.

    Parameters
    ----------
    photons : ndarray of float
        Photons that were recorded.
    exposures : ndarray of float, or None
        Exposures; None where they are not known.
    instrument : Instrument
        Instrument whose period and exposure time apply.

    Returns
    -------
    ndarray of bool
        True where fewer than `LEAST_OPEN` of the periods are open at their end, or fewer than
        `LEAST_EMPTY` of the exposures are empty.
    """
    if exposures is None:
        return np.zeros(photons.shape, bool)
    per_period = arrivals_per_exposure(photons, exposures) / periods_per_exposure(instrument)
    empty = exposures - photons
    return (np.exp(-per_period) < LEAST_OPEN) | (empty < LEAST_EMPTY * exposures)


@cache
def _luck() -> tuple[_Floats, _Floats]:
    """Mean height of a unit normal above a limit that it exceeds, and the limit less its mean."""
    limit = np.linspace(WORST_LUCK, -6, 200)
    return norm.pdf(limit) / norm.sf(limit) - limit, limit


def _detection_factor(detection: _Floats, least: float) -> _Floats:
    """Detection ratio as it came out, over what is likely given that it passed the test."""
    factor = np.ones_like(detection)
    root = np.sqrt(least)
    beyond, limit = _luck()
    near = (detection > 0) & (np.sqrt(np.maximum(detection, least)) < root + beyond[-1])
    seen = np.sqrt(np.maximum(detection[near], least))
    likely = root - np.interp(seen - root, beyond, limit)
    factor[near] = (seen / np.minimum(likely, seen)) ** 2
    return factor
