# SPDX-License-Identifier: Apache-2.0
"""Whether one surface explains a fitted pixel's counts: a cheap test of all pixels, and a full one.

All tests use the bins of the search (a few to a pulse, which loses next to nothing) and the
parameters that the fit found. Departures are looked for in eight ways, each a standard normal
score:

1. *Broader pulses* in all bands: two surfaces of equal light, a changed pulse, multipath.
2. *Some light earlier* or *later* in all bands: two surfaces, one much brighter than the other.
3. *Delays that change smoothly over wavelength*, along either of two contrasts and in either
   direction, with pulses that are somewhat broader: two surfaces of different colors.
4. *Anything else*: χ² or deviance over all bins.

All but the last are efficient scores (C(α) tests; Neyman, in Probability and Statistics, 1959) of
directions in which counts would change. An allowance is subtracted from all but the first: tests of
what is rarer may cause fewer of the false alarms.

The *screen* computes the first, the last, and a χ² of the third for every pixel, with the score of
amplitudes and background taken as 0 and the overlap of bands left out. A pixel one of whose scores
exceeds `ASKED` gets the *full* test: all directions, orthogonal to all fitted parameters, a
correction for skewness, and the deviance of groups of bins with the mean and variance that Poisson
counts give it. The misfit score is the greatest of all, of the full test where it was made.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, log_ndtr

from hueflight.fit.tables import DelayTables, ModelTables, by_phase

MISFIT = 3.5  #: misfit score from which one surface does not explain the counts
ASKED = 2.15  #: score of the screen from which a pixel gets the full test
LAG = 1.0  #: time by which some light is earlier or later, in deviations of one photon's delay
BROADENING = (0.06, 0.2)  #: that goes with each contrast of delays, in the same deviations
#: what is subtracted from the scores of earlier or later light, of each contrast, of the deviance
LAG_ALLOWANCE, CONTRAST_ALLOWANCES, DEVIANCE_ALLOWANCE = 0.1, (0.3, 0.1), 0.4
LARGEST_LOSS = 0.02  #: photons per period up to which corrected counts are nearly Poisson counts
LEAST_BACKGROUND = 0.5  #: photons of background in the weights, at least
RIDGE = 1e-6  #: on the unit diagonal of the normal equations
REACH = 2  #: tabulated delays to either side, whose slopes give the second derivative
DISTINCT = 0.02  #: share of a contrast's variance that the other one must leave
GROUPED = 2  #: bins of the search in one group of the deviance
LEAST_MEAN = 1e-3  #: expected counts of a group, at least, in the deviance
SCORE_STEP = 0.01  #: between scores whose probabilities are in a table
DEVIANCE_POINTS = 512  #: of the table of the deviance's mean and variance
DEVIANCE_LIMITS = (1e-3, 1e3)  #: expected counts that the table spans

_Floats = NDArray[np.float64]


def assess(
    counts: _Floats,
    delays_ns: _Floats,
    amplitudes: _Floats,
    background: _Floats,
    tables: ModelTables,
    *,
    asked: float = ASKED,
) -> tuple[_Floats, _Floats]:
    """Test every pixel's fit.

    Parameters
    ----------
    counts : ndarray, shape (pixel, bin)
        Counts at the bins of the search.
    delays_ns : ndarray, shape (pixel,)
        Arrival in the pixel, its own delay included, ns.
    amplitudes : ndarray, shape (pixel, band)
        Photons of each band; negative ones count as none.
    background : ndarray, shape (pixel,)
        Photons of background over all bins.
    tables : ModelTables
        Tables of the fit.
    asked : float, optional
        Score of the screen from which a pixel gets the full test.

    Returns
    -------
    chi_square : ndarray, shape (pixel,)
        Pearson's χ² per degree of freedom; NaN where there are no more bins than parameters.
    misfit : ndarray, shape (pixel,)
        Greatest of the scores.
    """
    level = tables.wide
    chi_square, misfit = np.empty((2, len(counts)))
    amplitudes = np.maximum(amplitudes, 0.0)
    background = np.maximum(background, LEAST_BACKGROUND)
    ratios = curvature_ratios(level)
    for phase, chosen in by_phase(level.phase_of(delays_ns)):
        pixels = _Pixels(counts[chosen], amplitudes[chosen], background[chosen], level, phase)
        chi_square[chosen], score = _screen(pixels, tables.contrasts, ratios)
        full = score > asked
        if full.any():
            score[full] = _full(pixels.take(full), tables.contrasts, tables.spread_ns)
        misfit[chosen] = score
    return chi_square, misfit


def p_value(misfit: _Floats) -> _Floats:
    """Probability that a pixel with one surface has a misfit score as great as this.

    Parameters
    ----------
    misfit : ndarray
        Greatest of the scores.

    Returns
    -------
    ndarray
        Probabilities, the scores taken as independent.
    """
    scores, logs = tails()
    place = (np.asarray(misfit) - scores[0]) / SCORE_STEP  # in a raster, there is nothing to search
    below = np.fmin(np.fmax(place, 0), scores.size - 2).astype(np.intp)
    part = np.clip(place - below, 0, 1)
    found = np.exp(logs[below] + part * np.diff(logs)[below])
    return np.where(misfit > scores[-1], 0.0, found)


def misfit_score(probability: _Floats) -> _Floats:
    """Misfit score that has a probability: the inverse of `p_value`.

    Parameters
    ----------
    probability : ndarray
        Probabilities, such as that of another test of the same pixel.

    Returns
    -------
    ndarray
        Scores.
    """
    scores, logs = tails()
    with np.errstate(divide="ignore"):
        return np.interp(-np.log(probability), -logs, scores)


@cache
def tails() -> tuple[_Floats, _Floats]:
    """Return how probable misfit scores are.

    Returns
    -------
    scores : ndarray of float, shape (score,)
        Scores, `SCORE_STEP` apart.
    logs : ndarray of float, shape (score,)
        Logarithm of the probability that the greatest of all exceeds them.
    """
    scores = np.arange(-10.0, 38.0, SCORE_STEP)
    allowances = (0.0, DEVIANCE_ALLOWANCE, *2 * (LAG_ALLOWANCE, *CONTRAST_ALLOWANCES))
    below = sum(log_ndtr(scores + allowance) for allowance in allowances)
    return scores, np.log(np.maximum(-np.expm1(below), 1e-320))


def wavelength_contrasts(wavelengths_nm: NDArray[np.floating]) -> _Floats:
    """Smooth contrasts over wavelength, along which delays may differ.

    Parameters
    ----------
    wavelengths_nm : ndarray, shape (band,)
        Wavelength of each band, nm.

    Returns
    -------
    ndarray, shape (contrast, band)
        Values of x and 3x² − 1, x the wavelength scaled to −1 … 1. There is one contrast with two
        bands, and none with one.
    """
    wavelengths = np.asarray(wavelengths_nm, np.float64)
    span = float(np.ptp(wavelengths))
    if span == 0:
        return np.empty((0, wavelengths.size))
    x = 2 * (wavelengths - wavelengths.min()) / span - 1
    return np.array([x, 3 * x**2 - 1])[: min(2, wavelengths.size - 1)]


def curvature_ratios(level: DelayTables) -> _Floats:
    """Information about a pulse's width per information about its delay, 1/ns².

    Parameters
    ----------
    level : DelayTables
        Tables at the bins of the search.

    Returns
    -------
    ndarray, shape (band,)
        Σ T″²/T ÷ Σ T′²/T of each band, as of a bright pulse.
    """
    middle = len(level.shares) // 2
    shares, slopes = (table[middle].astype(np.float64) for table in (level.shares, level.slopes))
    floor = 0.01 * shares.max(axis=-1, keepdims=True) + 1e-30
    weights = 1 / (shares + floor)
    along = (slopes**2 * weights).sum(axis=-1)
    across = (_curves(level, middle) ** 2 * weights).sum(axis=-1)
    return across / np.maximum(along, 1e-30)


def _curves(level: DelayTables, phase: int) -> _Floats:
    """Second derivative of the shares by the delay (band, bin)."""
    before, after = max(phase - REACH, 0), min(phase + REACH, len(level.shares) - 1)
    rise = level.slopes[after].astype(np.float64) - level.slopes[before]
    return rise / ((after - before) * level.phase_ns)


class _Pixels:
    """Pixels with one tabulated delay: what they counted, and what the fit expects."""

    def __init__(
        self, h: _Floats, amplitudes: _Floats, background: _Floats, level: DelayTables, phase: int
    ) -> None:
        self.h, self.amplitudes, self.background = h, amplitudes, background
        self.level, self.phase = level, phase
        tables = (level.shares, level.slopes)
        self.shares, self.slopes = (table[phase].astype(np.float64) for table in tables)
        self.mean = amplitudes @ self.shares + background[:, None] * level.widths
        self.weight = 1 / self.mean
        self.residual = h - self.mean

    def take(self, chosen: NDArray[np.bool_]) -> _Pixels:
        parts = (self.h[chosen], self.amplitudes[chosen], self.background[chosen])
        return _Pixels(*parts, self.level, self.phase)


def _screen(pixels: _Pixels, contrasts: _Floats, ratios: _Floats) -> tuple[_Floats, _Floats]:
    """Pearson's χ² per degree of freedom and the greatest score of the screen."""
    a, slopes = pixels.amplitudes, pixels.slopes
    pull = pixels.weight * pixels.residual
    u = a * (pull @ slopes.T)  # pixel, band
    v = a**2 * (pixels.weight @ (slopes**2).T)
    delay_u, delay_v = u.sum(axis=-1), v.sum(axis=-1) + 1e-30
    broad_u = (a * (pull @ _curves(pixels.level, pixels.phase).T)).sum(axis=-1)
    broadening = broad_u / np.sqrt((v * ratios).sum(axis=-1) + 1e-30)
    freedom = pixels.h.shape[-1] - a.shape[-1] - 2
    pearson = (pull * pixels.residual).sum(axis=-1) - delay_u**2 / delay_v
    chi_square = np.full(len(a), np.nan)
    score = broadening
    if freedom > 0:
        chi_square = pearson / freedom
        shape = freedom**2 / (2 * freedom + pixels.weight.sum(axis=-1))
        score = np.maximum(score, gamma_score(chi_square, shape) - DEVIANCE_ALLOWANCE)
    if len(contrasts):
        across = v @ contrasts.T  # pixel, contrast
        pulls = u @ contrasts.T - across * (delay_u / delay_v)[:, None]
        products = np.einsum("pk,ck,dk->pcd", v, contrasts, contrasts)
        products -= across[:, :, None] * across[:, None, :] / delay_v[:, None, None]
        raw = v @ (contrasts**2).T
        score = np.maximum(score, _contrast_score(pulls, products, raw))
    return chi_square, score


def _full(pixels: _Pixels, contrasts: _Floats, spread_ns: float) -> _Floats:
    """Greatest score of the full tests."""
    a, weight, residual = pixels.amplitudes, pixels.weight, pixels.residual
    linear = np.vstack([pixels.shares, pixels.level.widths]).astype(np.float64)
    # nuisances: photons of each band, background, common delay
    nuisance = np.concatenate(
        [np.broadcast_to(linear, (len(a), *linear.shape)), (a @ pixels.slopes)[:, None]], axis=1
    )
    weighted = nuisance * weight[:, None]
    normal = weighted @ nuisance.transpose(0, 2, 1)
    scale = 1 / np.sqrt(np.maximum(np.einsum("paa->pa", normal), 1e-30))
    scaled = normal * scale[:, :, None] * scale[:, None, :] + RIDGE * np.eye(normal.shape[-1])
    inverse = np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]
    step = np.einsum("pab,pb->pa", inverse, np.einsum("pcg,pg->pc", weighted, residual))
    given = np.stack([a @ table for table in _directions(pixels, contrasts, spread_ns)], axis=1)
    along = np.einsum("pcg,pdg->pcd", weighted, given)
    directions = given - np.einsum("pcd,pca,pag->pdg", along, inverse, nuisance)
    raw = np.einsum("pdg,pg->pd", given**2, weight)
    pulls = np.einsum("pdg,pg->pd", directions, weight * residual)
    products = np.einsum("pdg,pg,peg->pde", directions, weight, directions)
    cubes = np.einsum("pdg,pg->pd", directions**3, weight**2)
    score = _deviance_score(pixels, step, nuisance, weighted, inverse) - DEVIANCE_ALLOWANCE
    allowances = (0.0, LAG_ALLOWANCE, LAG_ALLOWANCE)
    for number, allowance in enumerate(allowances):
        variance = products[:, number, number] + 1e-30
        z = pulls[:, number] / np.sqrt(variance)
        z -= cubes[:, number] / variance**1.5 * (z**2 - 1) / 6
        distinct = variance > DISTINCT * raw[:, number]
        score = np.maximum(score, np.where(distinct, z - allowance, -np.inf))
    for number in range(len(contrasts)):
        own, broader = len(allowances) + number, BROADENING[number] * spread_ns
        distinct = products[:, own, own] > DISTINCT * raw[:, own]
        for sign in (1, -1):
            pull = sign * pulls[:, own] + broader * pulls[:, 0]
            variance = products[:, own, own] + broader**2 * products[:, 0, 0]
            variance += 2 * sign * broader * products[:, 0, own]
            z = pull / np.sqrt(np.maximum(variance, 1e-30)) - CONTRAST_ALLOWANCES[number]
            score = np.maximum(score, np.where(distinct, z, -np.inf))
    return score


def _directions(pixels: _Pixels, contrasts: _Floats, spread_ns: float) -> list[_Floats]:
    """Changes of a band's share (band, bin): broader, earlier, later, and along each contrast."""
    level, phase = pixels.level, pixels.phase
    shift, last = lag_steps(level, spread_ns), len(level.shares) - 1
    moved = [level.shares[max(phase - shift, 0)], level.shares[min(phase + shift, last)]]
    return [
        _curves(level, phase),
        *(shares.astype(np.float64) for shares in moved),
        *(contrast[:, None] * pixels.slopes for contrast in contrasts),
    ]


def lag_steps(level: DelayTables, spread_ns: float) -> int:
    """Tabulated delays by which some light is taken to be earlier or later.

    Parameters
    ----------
    level : DelayTables
        Tables at the bins of the search.
    spread_ns : float
        Standard deviation of the delay that one photon tells, ns.

    Returns
    -------
    int
        Number of steps, at least 1.
    """
    return max(1, round(LAG * spread_ns / level.phase_ns))


def _contrast_score(pulls: _Floats, products: _Floats, raw: _Floats) -> _Floats:
    """Normal score of the quadratic form of one or two directions.

    `raw` (pixel, direction) are their variances before they were made orthogonal: where little is
    left of one, as of a pixel that reflects a single band, it says nothing.
    """
    usable = products[:, 0, 0] > DISTINCT * raw[:, 0]
    first_v = np.where(usable, products[:, 0, 0], 1.0)
    first = np.where(usable, pulls[:, 0] ** 2 / first_v, 0.0)
    if pulls.shape[1] == 1:
        return gamma_score(first, np.float64(0.5))
    share = products[:, 0, 1] / first_v
    rest = products[:, 1, 1] - share * products[:, 0, 1]
    distinct = usable & (rest > DISTINCT * raw[:, 1])
    second = (pulls[:, 1] - share * pulls[:, 0]) ** 2 / np.where(distinct, rest, 1.0)
    both = gamma_score((first + second) / 2, np.float64(1.0))
    return np.where(distinct, both, gamma_score(first, np.float64(0.5)))


def gamma_score(ratio: _Floats, shape: _Floats | np.float64) -> _Floats:
    """Standard normal score of a gamma variate over its mean (Wilson and Hilferty, 1931).

    Parameters
    ----------
    ratio : ndarray
        Variates over their mean.
    shape : ndarray or float
        Shape of the gamma distribution: half the degrees of freedom of χ².

    Returns
    -------
    ndarray
        Scores.
    """
    return (np.cbrt(ratio) - (1 - 1 / (9 * shape))) * np.sqrt(9 * shape)


def _deviance_score(
    pixels: _Pixels, step: _Floats, nuisance: _Floats, weighted: _Floats, inverse: _Floats
) -> _Floats:
    """Normal score of the deviance of groups of bins, after one linear step."""
    starts = np.arange(0, pixels.h.shape[-1], GROUPED)
    moved = pixels.mean + np.einsum("pc,pcg->pg", step, nuisance)
    seen = np.add.reduceat(pixels.h, starts, axis=-1)
    expected = np.maximum(np.add.reduceat(moved, starts, axis=-1), LEAST_MEAN)
    parts = 2 * (expected - seen)
    parts += 2 * np.where(seen > 0, seen * np.log(np.maximum(seen, 1) / expected), 0.0)
    leverage = np.einsum("pag,pab,pbg->pg", weighted, inverse, nuisance)
    left = np.clip(1 - np.add.reduceat(leverage, starts, axis=-1), 0, 1)
    logs, means, variances = deviance_table()
    at = np.log(expected)
    average = (np.interp(at, logs, means) * left).sum(axis=-1) + 1e-30
    variance = (np.interp(at, logs, variances) * left).sum(axis=-1) + 1e-30
    return gamma_score(parts.sum(axis=-1) / average, average**2 / variance)


@cache
def deviance_table() -> tuple[_Floats, _Floats, _Floats]:
    """Mean and variance of one Poisson count's deviance over its expected value.

    Returns
    -------
    tuple of ndarray
        Natural logarithms of the expected counts, means, variances.
    """
    logs = np.linspace(np.log(DEVIANCE_LIMITS[0]), np.log(DEVIANCE_LIMITS[1]), DEVIANCE_POINTS)
    means, variances = np.empty((2, logs.size))
    for i, mu in enumerate(np.exp(logs)):
        k = np.arange(int(mu + 12 * np.sqrt(mu) + 25))
        p = np.exp(k * np.log(mu) - mu - gammaln(k + 1))
        d = 2 * (k * np.log(np.maximum(k, 1) / mu) - (k - mu))
        means[i] = p @ d
        variances[i] = p @ (d - means[i]) ** 2
    return logs, means, variances
