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
from functools import cache, cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from hueflight.backend.fit_results import INFORMATION_SCALE
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
LEAST_INFORMATION = 1e-30  #: that is divided by
WORST_LUCK = 2.0  #: standard deviations of noise in a pixel's favor, at most

#: where the kernel finds ratios in `DelayInformation.table`
RATIO_SCALE = INFORMATION_SCALE.pack(
    points=RATIOS.size,
    least=RATIOS[0],
    first_log=np.log(RATIOS[0]),
    per_log=1 / np.log(RATIOS[1] / RATIOS[0]),
)

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DelayInformation:
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

    @cached_property
    def table(self) -> NDArray[np.float32]:
        """Value, step to the next ratio, bias and its step, shape (ratio, band, 4)."""
        steps = (np.diff(table, axis=0, append=table[-1:]) for table in (self.value, self.bias))
        value_step, bias_step = steps
        columns = (self.value, value_step, self.bias, bias_step)
        return np.stack(columns, axis=-1).astype(np.float32)

    def noise(self, found: Fit, placement: _Floats) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return parts of the variance of the delay of pixels.

        Parameters
        ----------
        found : Fit
            Fit of the pixels.
        placement : ndarray of float, shape (band,)
            Variance of the place of each waveform in time, ns².

        Returns
        -------
        taken : ndarray of float, shape (pixel,)
            Share of the information on the delay that noise of the amplitudes adds.
        added : ndarray of float, shape (pixel,)
            Variance that the places of the waveforms add, ns².
        """
        background = np.maximum(found.background, 1.0)[:, None]
        ratios = np.maximum(found.amplitudes, 0.0) / background
        value, bias = self.at(ratios)
        by_band = ratios**2 * value
        total = np.maximum(by_band.sum(axis=-1), LEAST_INFORMATION)
        taken = (found.amplitude_std**2 / background**2 * bias).sum(axis=-1) / total
        return taken, (by_band / total[:, None]) ** 2 @ placement

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


_kept: WeakKeyDictionary[Calibration, DelayInformation] = WeakKeyDictionary()


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
    above, great = (int(np.count_nonzero(known > limit)) for limit in (1, PLAIN_MISFIT))
    if not may_share_misfit(known.size, above, great):
        return 1.0
    median = float(np.median(known))
    told = above - known.size / 2 >= SIGN_TEST * np.sqrt(known.size)
    return max(median, 1.0) if told or median > PLAIN_MISFIT else 1.0


def may_share_misfit(known: int, above: int, great: int) -> bool:
    """Tell whether pixels may have a misfit in common, which takes no median to rule out.

    Parameters
    ----------
    known : int
        Number of pixels whose χ² per degree of freedom is known.
    above : int
        Those of them that lie above 1.
    great : int
        Those that lie above `PLAIN_MISFIT`.

    Returns
    -------
    bool
        False if `common_misfit` is 1.
    """
    half = known / 2
    return known > 0 and (above - half >= SIGN_TEST * np.sqrt(known) or great >= half)


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
    taken, added = information_for(calibration).noise(found, placement_variance(calibration))
    variance /= 1 - np.where(taken > LEAST_BIAS, np.minimum(taken, MOST_BIAS), 0.0)
    variance += added
    return variance + calibration.pixel_delay_std_ns[chosen] ** 2


def brightness_variance(calibration: Calibration) -> tuple[_Floats, _Floats]:
    """Return the variance of reflectance, relative to its square, that the calibration leaves.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    by_pixel : ndarray of float, shape (row, col)
        Variance of the brightness of each pixel, which all bands share; 0 where the calibration was
        made by a version that did not state it.
    by_band : ndarray of float, shape (band,)
        Variance of the brightness of each band, which all pixels share, likewise.
    """
    by_pixel = np.zeros(calibration.flat_field.shape)
    by_band = np.zeros(calibration.brightness.size)
    if calibration.flat_field_std is not None:
        by_pixel += (calibration.flat_field_std / calibration.flat_field) ** 2
    if calibration.brightness_std is not None:
        by_band += (calibration.brightness_std / calibration.brightness) ** 2
    return by_pixel, by_band


def placement_variance(calibration: Calibration) -> _Floats:
    """Return the variance of the places of the bands' waveforms in time.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    ndarray of float, shape (band,)
        Variance, ns²; 0 where the calibration does not know it.
    """
    if calibration.waveform_delay_std_ns is None:
        return np.zeros(calibration.brightness.size)
    return calibration.waveform_delay_std_ns**2


def information_for(calibration: Calibration) -> DelayInformation:
    """Return the information about the delay, which is kept as long as the calibration lives.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    DelayInformation
        Its tables.
    """
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

        _kept[calibration] = DelayInformation(
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
    periods = periods_per_exposure(instrument)
    if periods == 1:
        return np.zeros_like(photons)
    arrivals = arrivals_per_exposure(photons, exposures)
    whole = variance_factor(arrivals)
    per_period = arrivals / periods
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
    # what `arrivals_per_exposure` and the share that is open come to, without their logarithms
    most = 1 - LEAST_OPEN ** periods_per_exposure(instrument)
    closed = np.minimum(photons, exposures - 0.5) > most * np.maximum(exposures, 0)
    return closed | (exposures - photons < LEAST_EMPTY * exposures)


@cache
def luck() -> tuple[_Floats, _Floats]:
    """Return how far a unit normal lies above a limit on average where it exceeds it.

    Returns
    -------
    beyond : ndarray of float, shape (limit,)
        Mean heights above the limits, ascending.
    limit : ndarray of float, shape (limit,)
        The limits, less the mean of all.
    """
    limit = np.linspace(WORST_LUCK, -6, 200)
    density = np.exp(-(limit**2) / 2) / np.sqrt(2 * np.pi)
    return density / ndtr(-limit) - limit, limit


def _detection_factor(detection: _Floats, least: float) -> _Floats:
    """Detection ratio as it came out, over what is likely given that it passed the test."""
    factor = np.ones_like(detection)
    root = np.sqrt(least)
    beyond, limit = luck()
    near = (detection > 0) & (detection < (root + beyond[-1]) ** 2)
    if not near.any():
        return factor
    seen = np.sqrt(np.maximum(detection[near], least))
    likely = root - np.interp(seen - root, beyond, limit)
    factor[near] = (seen / np.minimum(likely, seen)) ** 2
    return factor
