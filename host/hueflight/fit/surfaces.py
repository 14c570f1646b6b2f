# SPDX-License-Identifier: Apache-2.0
"""Light of several surfaces in a pixel: expected counts, scoring and positive amplitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.reference import FLOOR_PHOTONS, FLOOR_SHARE, RIDGE
from hueflight.fit.tables import DelayTables

MOST_MOVES = 20  #: a delay moves by this part of the searched range at most in a step
POLISH_ROUNDS = 4  #: of expectation maximisation after scoring, which keeps amplitudes positive

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Surfaces:
    """Parameters of the light of several surfaces.

    Attributes
    ----------
    delays : ndarray of float, shape (n, surface)
        Arrival in the pixel, its own delay included, ns.
    amplitudes : ndarray of float, shape (n, surface, band)
        Photons of each band.
    background : ndarray of float, shape (n,)
        Photons over all bins.
    """

    delays: _Floats
    amplitudes: _Floats
    background: _Floats

    def take(self, chosen: NDArray[np.intp]) -> Surfaces:
        """Return some of them.

        Parameters
        ----------
        chosen : ndarray of int
            Which ones.

        Returns
        -------
        Surfaces
            These.
        """
        return Surfaces(self.delays[chosen], self.amplitudes[chosen], self.background[chosen])


@dataclass(frozen=True)
class ScoredSurfaces:
    """Two surfaces after scoring.

    Attributes
    ----------
    state : Surfaces
        Their parameters.
    variances, information : ndarray of float, shape (n, parameter)
        Of amplitudes, background and delays: variances, and information if all others are known.
    influence : ndarray of float, shape (n, 2, band)
        Change of the delays by that of each band's pulse.
    """

    state: Surfaces
    variances: _Floats
    information: _Floats
    influence: _Floats

    def take(self, chosen: NDArray[np.intp]) -> ScoredSurfaces:
        """Return some of them.

        Parameters
        ----------
        chosen : ndarray of int
            Which ones.

        Returns
        -------
        ScoredSurfaces
            These.
        """
        rest = (self.variances[chosen], self.information[chosen], self.influence[chosen])
        return ScoredSurfaces(self.state.take(chosen), *rest)

    def where(self, kept: NDArray[np.bool_], other: ScoredSurfaces) -> ScoredSurfaces:
        """Return these where they are kept, and others elsewhere.

        Parameters
        ----------
        kept : ndarray of bool, shape (n,)
            True where these are kept.
        other : ScoredSurfaces
            What replaces the rest.

        Returns
        -------
        ScoredSurfaces
            The choice.
        """

        def choice(mine: _Floats, theirs: _Floats) -> _Floats:
            return np.where(kept.reshape(-1, *(1,) * (mine.ndim - 1)), mine, theirs)

        state = Surfaces(
            choice(self.state.delays, other.state.delays),
            choice(self.state.amplitudes, other.state.amplitudes),
            choice(self.state.background, other.state.background),
        )
        return ScoredSurfaces(
            state,
            choice(self.variances, other.variances),
            choice(self.information, other.information),
            choice(self.influence, other.influence),
        )


def dense_rows(rows: NDArray[np.intp], level: DelayTables, values: NDArray) -> NDArray[np.float32]:
    """Return rows of tables, each of which is made once.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        Numbers of tabulated delays.
    level : DelayTables
        The tables.
    values : ndarray
        Shares or slopes of their tiles.

    Returns
    -------
    ndarray of float32, shape (n, band, bin)
        The rows.
    """
    some, place = np.unique(rows, return_inverse=True)
    return np.stack([level.tiles.dense(values, int(row)) for row in some])[place.reshape(-1)]


def linear_parts(state: Surfaces, level: DelayTables) -> _Floats:
    """Return the shares that amplitudes are multiplied with, those of the background last.

    Parameters
    ----------
    state : Surfaces
        Surfaces, whose delays are rounded to tabulated ones.
    level : DelayTables
        The tables.

    Returns
    -------
    ndarray of float, shape (n, surface · band + 1, bin)
        Shares.
    """
    shape = len(state.delays), -1, level.widths.size
    shares = dense_rows(level.phase_of(state.delays).ravel(), level, level.tiles.shares)
    flat = np.broadcast_to(level.widths, (len(state.delays), 1, level.widths.size))
    return np.concatenate([shares.reshape(shape), flat], axis=1).astype(np.float64)


def score_surfaces(
    counts: _Floats, state: Surfaces, level: DelayTables, low: _Floats, high: _Floats, steps: int
) -> ScoredSurfaces:
    """Take steps of Fisher's scoring, as in the fit of one surface.

    Parameters
    ----------
    counts : ndarray of float, shape (n, bin)
        Counts at the bins of the tables.
    state : Surfaces
        Two surfaces each.
    level : DelayTables
        The tables.
    low, high : ndarray of float, shape (n, 1)
        Least and greatest delay, ns.
    steps : int
        Number of steps.

    Returns
    -------
    ScoredSurfaces
        The surfaces after the last step.
    """
    total = counts.sum(axis=-1)
    floor = FLOOR_PHOTONS + FLOOR_SHARE * total
    most_ns = (high - low) / MOST_MOVES
    variances = information = influence = np.empty(0)
    for step in range(steps):
        phases = level.phase_of(state.delays)
        linear = linear_parts(state, level)
        slopes = dense_rows(phases.ravel(), level, level.tiles.slopes)
        amplitudes = np.maximum(state.amplitudes, 0.0)
        moved = amplitudes[..., None] * slopes.reshape(*amplitudes.shape, -1)
        theta = amplitudes.reshape(len(counts), -1)
        theta = np.column_stack([theta, np.maximum(state.background, floor)])
        model = np.concatenate([linear, moved.sum(axis=2)], axis=1)
        weighted = model / (theta[:, None] @ linear)
        normal = weighted @ model.transpose(0, 2, 1)
        # a delay may be anywhere in the searched range, and a band has no more than was counted
        diagonal = np.einsum("paa->pa", normal)
        diagonal[:, -2:] += 12 / (high - low) ** 2
        diagonal[:, :-2] += ((2 * total + 10) ** -2.0)[:, None]
        information = diagonal.copy()
        scale = 1 / np.sqrt(information)
        both = scale[:, :, None] * scale[:, None, :]
        inverse = np.linalg.inv(normal * both + RIDGE * np.eye(normal.shape[-1])) * both
        solution = (inverse @ (weighted @ counts[..., None]))[..., 0]
        moves = np.clip(solution[:, -2:], -most_ns, most_ns)
        delays = np.clip(level.first_ns + phases * level.phase_ns + moves, low, high)
        state = Surfaces(delays, solution[:, :-3].reshape(amplitudes.shape), solution[:, -3])
        if step == steps - 1:
            variances = np.einsum("paa->pa", inverse).copy()
            pulls = weighted @ moved.sum(axis=1).transpose(0, 2, 1)  # of both surfaces' bands
            influence = inverse[:, -2:] @ pulls
    return ScoredSurfaces(state, variances, information, influence)


def polish_amplitudes(
    counts: _Floats, state: Surfaces, level: DelayTables
) -> tuple[Surfaces, _Floats, _Floats]:
    """Make amplitudes positive by expectation maximisation.

    Parameters
    ----------
    counts : ndarray of float, shape (n, bin)
        Counts at the bins of the tables.
    state : Surfaces
        Any number of surfaces each.
    level : DelayTables
        The tables.

    Returns
    -------
    state : Surfaces
        The same with amplitudes that are not negative.
    likelihood : ndarray of float, shape (n,)
        Log-likelihood, but for a constant that the counts determine.
    mean : ndarray of float, shape (n, bin)
        Expected counts.
    """
    linear = linear_parts(state, level)
    total = counts.sum(axis=-1)
    whole = np.maximum(linear.sum(axis=-1), 1e-3)
    least = (1e-3 * total)[:, None]
    theta = np.column_stack([state.amplitudes.reshape(len(counts), -1), state.background])
    theta = np.maximum(theta, least)
    for _ in range(POLISH_ROUNDS):
        mean = (theta[:, None] @ linear)[:, 0]
        theta = theta * (linear @ (counts / mean)[..., None])[..., 0] / whole
    mean = (theta[:, None] @ linear)[:, 0]
    likelihood = (counts * np.log(mean)).sum(axis=-1) - mean.sum(axis=-1)
    amplitudes = theta[:, :-1].reshape(state.amplitudes.shape)
    return Surfaces(state.delays, amplitudes, theta[:, -1]), likelihood, mean
