# SPDX-License-Identifier: Apache-2.0
"""The joint fit of delay, one amplitude per band and a flat background: its definition.

Maximum likelihood for Poisson counts, in four steps:

1. *Search*: the likelihood over whole lags, each band free to be dark or bright.
2. *Scoring*: Fisher's method of scoring (weighted least squares with the model's own variances,
   Osborne, Int. Stat. Rev. 60, 1992), until the delay moves by no more than a fraction of its
   standard deviation. It starts from the photons in each band's zone and those in no zone. Pixels
   with few photons take a second step, and the weights assume some background: otherwise photons in
   the tails of the pulses are taken for background, up to a tenth of a photon of each band.
3. *Choice*: where the search left a second delay, both are fitted and their likelihoods compared.
4. *Posterior*: where photons are few, the likelihood is not a parabola; the delay and its deviation
   are then the mean and deviation of the likelihood on a few delays around its maximum. From 40
   photons on, a third-order correction of the parabola suffices.

Everything here works on many pixels at once; `hueflight/fit/_c` holds the same in C.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit import LEAST_AMPLITUDE, LEAST_SHARE
from hueflight.fit import assessment, detection
from hueflight.fit.search_tables import SearchTables
from hueflight.fit.tables import (
    BACKGROUND_SHARES,
    DelayTables,
    ModelTables,
    by_phase,
)

MOST_STEPS = 6  #: of scoring at the full bin width
SETTLED = 0.3  #: a delay that moves by less than this share of its deviation has settled
SETTLED_AMPLITUDE = 3.0  #: the same for amplitudes: where bands overlap, theirs need steps
FLOOR_PHOTONS = 2.0  #: in the weights background is taken for no less than this
FLOOR_SHARE = 0.003  #: and this share of all counts together
DARK_WIDTH = 0.1  #: share of the bins that must be in no band's zone to tell the background
RIDGE = 1e-6  #: on the unit diagonal of the normal equations
MARGIN = 6.0  #: log-likelihood by which a second delay may be worse and is still looked at
RASTER = 0.07  #: and by this much per photon: a delay between two lags of the search loses that
AMBIGUOUS = 3.0  #: log-likelihood by which the better delay must win (20 : 1)
FEW_PHOTONS = 300.0  #: pixels that know no more of their delay than this many would tell
FEW_STEPS = 2  #: take this many steps at least: amplitudes settle later than the delay
POSTERIOR_PHOTONS = 40.0  #: the posterior stage is for pixels that know no more than this many tell
NODES = 7  #: delays on which the posterior is looked at,
NODE_SPACING = 1.2  #: this many deviations apart: of a parabola exact to 1e-5 (trapezoids)
LIKELIHOOD_ROUNDS = 6  #: of expectation maximisation before two likelihoods are compared


@dataclass(frozen=True)
class FitOptions:
    """Steps that the fit may leave out.

    Attributes
    ----------
    wide_first : bool
        Begin scoring at the wide bins of the search. With a `target_ns` it always begins there.
    settle : bool
        End scoring when a delay has settled; otherwise all steps are taken.
    posterior : bool
        Evaluate the posterior of pixels with the fewest photons; otherwise only correct the
        parabola.
    target_ns : float
        End scoring after the wide bins where the deviation is below this already.
    assessment : bool
        Test whether one surface explains the counts; otherwise those results are NaN.
    """

    wide_first: bool = False
    settle: bool = True
    posterior: bool = True
    target_ns: float = 0.0
    assessment: bool = True

    @property
    def starts_wide(self) -> bool:
        """Whether there is a step at the bins of the search."""
        return self.wide_first or self.target_ns > 0


DEFAULT = FitOptions()


@dataclass(frozen=True)
class Fit:
    """Result of the fit for each pixel.

    Attributes
    ----------
    delay_ns, delay_std_ns : ndarray of float, shape (pixel,)
        Arrival against the templates, and its standard deviation.
    other_ns : ndarray of float, shape (pixel,)
        Second plausible delay, else NaN.
    amplitudes, amplitude_std : ndarray of float, shape (pixel, band)
        Photons of each band, and their standard deviation.
    background : ndarray of float, shape (pixel,)
        Photons over all bins.
    detection : ndarray of float, shape (pixel,)
        Twice the log-likelihood ratio against background alone; NaN for a delay that is known too
        well to come from background.
    chi_square : ndarray of float, shape (pixel,)
        Pearson's χ² per degree of freedom; NaN where it was not computed or means nothing.
    misfit : ndarray of float, shape (pixel,)
        Greatest standard normal score of the tests in `assessment`; NaN likewise.
    steps : ndarray of uint8, shape (pixel,)
        Steps of scoring at the fine bins.
    """

    delay_ns: NDArray[np.float64]
    delay_std_ns: NDArray[np.float64]
    other_ns: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    amplitude_std: NDArray[np.float64]
    background: NDArray[np.float64]
    detection: NDArray[np.float64]
    chi_square: NDArray[np.float64]
    misfit: NDArray[np.float64]
    steps: NDArray[np.uint8]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name.

        Returns
        -------
        dict of str to ndarray
            Attributes of this class, one number or one row for each pixel.
        """
        return {name: getattr(self, name) for name in Fit.__dataclass_fields__}

    def take(self, chosen: NDArray[Any] | slice) -> Fit:
        """Return the fit of some of the pixels.

        Parameters
        ----------
        chosen : ndarray or slice
            Pixels to take.

        Returns
        -------
        Fit
            Their fit; a view if `chosen` is a slice.
        """
        return Fit(*(getattr(self, name)[chosen] for name in Fit.__dataclass_fields__))

    def put(self, chosen: NDArray[Any] | slice, other: Fit) -> None:
        """Replace the fit of some pixels.

        Parameters
        ----------
        chosen : ndarray or slice
            Pixels to replace.
        other : Fit
            Their new fit.
        """
        for name in Fit.__dataclass_fields__:
            getattr(self, name)[chosen] = getattr(other, name)


def no_fit(pixels: int, bands: int) -> Fit:
    """Return a fit that is 0 everywhere, to be filled.

    Parameters
    ----------
    pixels, bands : int
        Size of the fit.

    Returns
    -------
    Fit
        The empty fit.
    """
    delay, deviation, other, background, ratio, chi_square, misfit = np.zeros((7, pixels))
    amplitudes, amplitude_std = np.zeros((2, pixels, bands))
    return Fit(
        delay_ns=delay,
        delay_std_ns=deviation,
        other_ns=other,
        amplitudes=amplitudes,
        amplitude_std=amplitude_std,
        background=background,
        detection=ratio,
        chi_square=chi_square,
        misfit=misfit,
        steps=np.zeros(pixels, np.uint8),
    )


@dataclass
class _State:
    """Parameters of pixels on their way; all float64."""

    delay: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    background: NDArray[np.float64]
    covariance: NDArray[np.float64]
    cubic: NDArray[np.float64]

    def take(self, chosen: NDArray) -> _State:
        return _State(*(getattr(self, name)[chosen] for name in _State.__annotations__))

    def put(self, chosen: NDArray, other: _State) -> None:
        for name in _State.__annotations__:
            getattr(self, name)[chosen] = getattr(other, name)


def fit(
    light: NDArray[np.floating],
    offsets_ns: NDArray[np.float64],
    tables: ModelTables,
    options: FitOptions = DEFAULT,
) -> Fit:
    """Fit every pixel.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order, all views side by side, at least one count in each pixel.
    offsets_ns : ndarray of float, shape (pixel,)
        Delay that belongs to the pixel, not to the scene.
    tables : ModelTables
        Tables of the fit.
    options : FitOptions
        Steps that may be left out.

    Returns
    -------
    Fit
        Result for each pixel.
    """
    counts = tables.fine.summed(np.asarray(light, np.float64))
    total = counts.sum(axis=-1)
    low, high = (offsets_ns + bound for bound in tables.search_ns)
    score, share = _search(counts, total, tables.search, low, high)
    best, second = _two_best(score, tables.search.separation)
    state, steps = _scored(counts, total, best, score, share, low, high, tables, options)
    other = np.full(len(counts), np.nan)
    rows = np.arange(len(counts))
    alternative = (second >= 0) & (
        score[rows, best] - score[rows, second] < MARGIN + RASTER * total
    )
    if alternative.any():
        here = np.flatnonzero(alternative)
        args = (counts[here], total[here], second[here], score[here], share[here])
        alternatives, _ = _scored(*args, low[here], high[here], tables, options)
        mine = state.take(here)
        lead = _log_likelihood(counts[here], total[here], mine, tables.fine) - _log_likelihood(
            counts[here], total[here], alternatives, tables.fine
        )
        apart = np.abs(mine.delay - alternatives.delay) > 3 * np.sqrt(mine.covariance[:, -1, -1])
        lead[~apart] = np.inf  # both found the same maximum
        worse = lead < 0
        other[here] = np.where(np.abs(lead) < AMBIGUOUS, alternatives.delay, np.nan)
        other[here[worse]] = np.where(np.abs(lead) < AMBIGUOUS, mine.delay, np.nan)[worse]
        state.put(here[worse], alternatives.take(worse))
    variance = state.covariance[:, -1, -1].copy()
    delay = state.delay + variance**2 * state.cubic / 4
    if options.posterior:
        few = np.flatnonzero(variance > tables.spread_ns**2 / POSTERIOR_PHOTONS)
        if few.size:
            delay[few], variance[few] = _posterior(
                counts[few], total[few], state.take(few), tables.fine
            )
    bands = tables.bands
    # what the parameters themselves took out of the photons
    variance *= 1 + (bands + 2) / total
    # a count's posterior is half a photon wider than the count (Jeffreys' prior)
    amplitude_variance = np.einsum("paa->pa", state.covariance)[:, :bands] + 0.5
    delay = np.clip(delay, low, high)
    ratio = np.full(len(counts), np.nan)
    tested = np.flatnonzero(variance > tables.spread_ns**2 / detection.CERTAIN_PHOTONS)
    ratio[tested] = detection.log_likelihood_ratio(
        tables.search.summed(counts[tested]),
        delay[tested],
        state.amplitudes[tested],
        state.background[tested],
        tables,
    )
    chi_square, misfit = np.full((2, len(counts)), np.nan)
    if options.assessment:
        chi_square, misfit = assessment.assess(
            tables.search.summed(counts), delay, state.amplitudes, state.background, tables
        )
    return Fit(
        delay_ns=delay - offsets_ns,
        delay_std_ns=np.sqrt(variance),
        other_ns=other - offsets_ns,
        amplitudes=state.amplitudes,
        amplitude_std=np.sqrt(amplitude_variance),
        background=state.background,
        detection=ratio,
        chi_square=chi_square,
        misfit=misfit,
        steps=steps,
    )


# -- search -----------------------------------------------------------------------------------


def _search(
    counts: NDArray[np.float64],
    total: NDArray[np.float64],
    search: SearchTables,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Log-likelihood (pixel, lag) but for a constant, and the background's share at it."""
    grouped = search.summed(counts)
    lags = search.lags_ns.size
    best = np.full((len(counts), lags), -np.inf)
    share = np.zeros_like(best)
    parts = search.gained(grouped)  # ratio, band, pixel, lag
    for tried in BACKGROUND_SHARES:
        background = (tried * total)[:, None]
        gained = parts - background * search.costs[:, :, None, :]
        score = np.maximum(gained.max(axis=0), 0).sum(axis=0)
        score += total[:, None] * np.log(tried) - background
        share = np.where(score > best, tried, share)
        best = np.maximum(best, score)
    half = np.diff(search.lags_ns).mean() / 2 if lags > 1 else np.inf
    outside = (search.lags_ns < low[:, None] - half) | (search.lags_ns > high[:, None] + half)
    best[outside] = -np.inf
    return best, share


def _two_best(
    score: NDArray[np.float64], separation: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Lag of the highest likelihood and of the highest that is farther off (−1: none)."""
    best = score.argmax(axis=-1)
    near = np.abs(np.arange(score.shape[-1]) - best[:, None]) < separation
    apart = np.where(near, -np.inf, score)
    second = apart.argmax(axis=-1)
    none = ~np.isfinite(apart[np.arange(len(score)), second])
    return best, np.where(none, -1, second)


def _start(
    counts: NDArray[np.float64],
    total: NDArray[np.float64],
    lag: NDArray[np.intp],
    score: NDArray[np.float64],
    share: NDArray[np.float64],
    search: SearchTables,
) -> _State:
    """Delay from a parabola through three lags, amplitudes from the bands' zones.

    The background is that of the bins in none of them, else the search's.
    """
    rows = np.arange(len(counts))
    last = score.shape[-1] - 1
    left, here, right = (score[rows, np.clip(lag + step, 0, last)] for step in (-1, 0, 1))
    with np.errstate(invalid="ignore"):
        bend = left - 2 * here + right
        shift = 0.5 * (left - right) / bend
    inner = (lag > 0) & (lag < last) & np.isfinite(shift) & (bend < 0)
    shift = np.where(inner, np.clip(shift, -0.5, 0.5), 0.0)
    step_ns = search.lags_ns[1] - search.lags_ns[0] if last > 0 else 0.0
    grouped = search.summed(counts)
    inside = np.empty((len(counts), search.bands))
    for value in np.unique(lag):
        chosen = lag == value
        inside[chosen] = grouped[chosen] @ search.zones(int(value)).T
    widths, shares = search.zone_widths.T[lag], search.zone_shares.T[lag]
    dark_width = 1 - widths.sum(axis=-1)
    dark = (total - inside.sum(axis=-1)) / np.maximum(dark_width, DARK_WIDTH)
    background = np.where(dark_width > DARK_WIDTH, dark, share[rows, lag] * total)
    amplitudes = (inside - background[:, None] * widths) / np.maximum(shares, LEAST_SHARE)
    size = search.bands + 2
    return _State(
        delay=search.lags_ns[lag] + shift * step_ns,
        amplitudes=np.maximum(amplitudes, 0),
        background=background,
        covariance=np.zeros((len(counts), size, size)),
        cubic=np.zeros(len(counts)),
    )


# -- scoring ----------------------------------------------------------------------------------


def _scored(
    counts: NDArray[np.float64],
    total: NDArray[np.float64],
    lag: NDArray[np.intp],
    score: NDArray[np.float64],
    share: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    tables: ModelTables,
    options: FitOptions,
) -> tuple[_State, NDArray[np.uint8]]:
    """Maximum of the likelihood near a lag, and the steps it took."""
    state = _start(counts, total, lag, score, share, tables.search)
    widest = 1 / (high - low) ** 2 * 12  # of a delay that may be anywhere
    steps = np.zeros(len(counts), np.uint8)
    active = np.arange(len(counts))
    if options.starts_wide and tables.wide is not tables.fine:
        grouped = tables.wide.summed(counts)
        state = _step(grouped, total, state, tables.wide, low, high, widest, tables.spread_ns)
        deviation = np.sqrt(state.covariance[:, -1, -1])
        active = np.flatnonzero(deviation > options.target_ns)
    for _ in range(MOST_STEPS):
        if not active.size:
            break
        before = state.take(active)
        limits = low[active], high[active], widest[active]
        after = _step(counts[active], total[active], before, tables.fine, *limits, tables.spread_ns)
        state.put(active, after)
        steps[active] += 1
        if options.settle:
            deviations = np.sqrt(np.einsum("paa->pa", after.covariance))
            moved = np.abs(after.delay - before.delay) / (SETTLED * deviations[:, -1])
            changes = np.abs(after.amplitudes - before.amplitudes)
            changes /= SETTLED_AMPLITUDE * deviations[:, : tables.bands]
            variance = deviations[:, -1] ** 2
            few = (variance > tables.spread_ns**2 / FEW_PHOTONS) & (steps[active] < FEW_STEPS)
            active = active[(moved > 1) | (changes > 1).any(axis=-1) | few]
    return state, steps


def _step(
    counts: NDArray[np.float64],
    total: NDArray[np.float64],
    state: _State,
    level: DelayTables,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    widest: NDArray[np.float64],
    spread_ns: float,
) -> _State:
    """One step of Fisher scoring from the nearest tabulated delay; counts at the level's bins."""
    phase = level.phase_of(state.delay)
    bands = level.tiles.bands
    size = bands + 2
    amplitudes = np.maximum(state.amplitudes, 0)
    background = np.maximum(state.background, FLOOR_PHOTONS + FLOOR_SHARE * total)
    normal = np.empty((len(counts), size, size))
    right = np.empty((len(counts), size))
    cubic = np.empty(len(counts))
    for value, chosen in by_phase(phase):
        shares = level.shares[value].astype(np.float64)
        slopes = level.slopes[value].astype(np.float64)
        linear = np.vstack([shares, level.widths])
        h, a, b = counts[chosen], amplitudes[chosen], background[chosen]
        mean = a @ shares + b[:, None] * level.widths
        slope = a @ slopes
        weight = 1 / mean
        pairs = linear[:, None, :] * linear[None, :, :]
        normal[chosen, :-1, :-1] = np.tensordot(weight, pairs, axes=(1, 2))
        along = weight * slope
        normal[chosen, :-1, -1] = normal[chosen, -1, :-1] = along @ linear.T
        normal[chosen, -1, -1] = (along * slope).sum(axis=-1)
        right[chosen, :-1] = (weight * h) @ linear.T
        right[chosen, -1] = (along * h).sum(axis=-1)
        cubic[chosen] = (along**2 * slope).sum(axis=-1)
    normal[:, -1, -1] += widest
    # a band or a background that nothing tells about stays within what was counted
    most = 2 * total + 10
    normal[:, np.arange(size - 1), np.arange(size - 1)] += (most**-2.0)[:, None]
    scale = 1 / np.sqrt(np.einsum("paa->pa", normal))
    scaled = normal * scale[:, :, None] * scale[:, None, :] + RIDGE * np.eye(size)
    covariance = np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]
    solution = np.einsum("pab,pb->pa", covariance, right)
    here = level.first_ns + phase * level.phase_ns
    move = np.clip(solution[:, -1], -spread_ns, spread_ns)
    return _State(
        delay=np.clip(here + move, low, high),
        amplitudes=solution[:, :bands],
        background=solution[:, bands],
        covariance=covariance,
        cubic=cubic,
    )


# -- likelihood -------------------------------------------------------------------------------


def _log_likelihood(
    counts: NDArray[np.float64], total: NDArray[np.float64], state: _State, level: DelayTables
) -> NDArray[np.float64]:
    """Greatest log-likelihood at a delay with no amplitude below 0, but for a constant."""
    result = np.empty(len(counts))
    amplitudes = np.maximum(state.amplitudes, LEAST_AMPLITUDE * total[:, None])
    background = np.maximum(state.background, FLOOR_PHOTONS + FLOOR_SHARE * total)
    for value, chosen in by_phase(level.phase_of(state.delay)):
        linear = np.vstack([level.shares[value], level.widths]).astype(np.float64)
        theta = np.column_stack([amplitudes[chosen], background[chosen]])
        h = counts[chosen]
        for _ in range(LIKELIHOOD_ROUNDS):
            theta = theta * ((h / (theta @ linear)) @ linear.T) / linear.sum(axis=-1)
        mean = theta @ linear
        result[chosen] = (h * np.log(mean)).sum(axis=-1) - mean.sum(axis=-1)
    return result


def _posterior(
    counts: NDArray[np.float64], total: NDArray[np.float64], state: _State, level: DelayTables
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and variance of the delay under the likelihood around its maximum.

    The amplitudes follow the delay along the ridge of the likelihood.
    """
    variance = state.covariance[:, -1, -1]
    follow = state.covariance[:, :-1, -1] / variance[:, None]  # d amplitude / d delay
    spacing = np.sqrt(variance) * NODE_SPACING
    stride = np.maximum(np.rint(spacing / level.phase_ns), 1)
    middle = np.rint((state.delay - level.first_ns) / level.phase_ns)
    floor = FLOOR_PHOTONS + FLOOR_SHARE * total
    logs = np.full((len(counts), NODES), -np.inf)
    delays = np.zeros_like(logs)
    for node in range(NODES):
        phase = middle + (node - NODES // 2) * stride
        valid = (phase >= 0) & (phase < len(level.shares))
        delays[:, node] = level.first_ns + phase * level.phase_ns
        shift = delays[:, node] - state.delay
        for value, chosen in by_phase(phase.astype(np.intp)):
            if not valid[chosen[0]]:
                continue
            moved = shift[chosen, None] * follow[chosen]
            a = np.maximum(state.amplitudes[chosen] + moved[:, :-1], 0)
            b = np.maximum(state.background[chosen] + moved[:, -1], floor[chosen])
            mean = a @ level.shares[value] + b[:, None] * level.widths
            logs[chosen, node] = (counts[chosen] * np.log(mean)).sum(-1) - mean.sum(-1)
    weight = np.exp(logs - logs.max(axis=-1, keepdims=True))
    weight /= weight.sum(axis=-1, keepdims=True)
    mean = (weight * delays).sum(axis=-1)
    # half a spacing of quadrature, so that a single node does not claim certainty
    spread = (weight * (delays - mean[:, None]) ** 2).sum(axis=-1)
    return mean, spread + (stride * level.phase_ns) ** 2 / 12 * (spread == 0)
