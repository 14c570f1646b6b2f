# SPDX-License-Identifier: Apache-2.0
"""Waveform of each band on the circle of the period, measured and independent of any pulse model.

A waveform is a periodic cubic spline with coefficients that are never negative; B-splines are
never negative either, so neither is the waveform. Integrals over bins, however placed on the
circle, and their derivatives with respect to the delay are exact (de Boor, A Practical Guide to
Splines, 1978).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.model.time_bins import TimeBins

if TYPE_CHECKING:
    from scipy import sparse

SMOOTHNESS = np.geomspace(1e-8, 1e4, 97)  #: weights of the roughness that are tried
CAUTION = 0.1  #: of the weight that fits the counts best: the rest is bias without gain
ROUNDS = 2  #: fits of a waveform, each with the variances of the one before
LEAST_EXPECTED = 0.1  #: variance of a bin, at least, of the mean count


@dataclass(frozen=True)
class Templates:
    """Waveforms of all bands, each of area 1, as they arrive from the reference target.

    Attributes
    ----------
    coefficients : ndarray of float, shape (band, knot)
        Coefficients of the cubic B-splines, photons per ns.
    circle_ns : float
        Period of the waveforms, ns; for a single shot, one too long for the waveform to wrap.
    """

    coefficients: NDArray[np.float64]
    circle_ns: float

    @classmethod
    def normalized(cls, coefficients: NDArray[np.floating], circle_ns: float) -> Templates:
        """Make waveforms of area 1 from coefficients of any scale.

        Parameters
        ----------
        coefficients : ndarray of float, shape (band, knot)
            Coefficients of the cubic B-splines; negative ones become 0.
        circle_ns : float
            Period of the waveforms, ns.

        Returns
        -------
        Templates
            The waveforms.
        """
        positive = np.maximum(np.atleast_2d(coefficients), 0.0)
        knot_ns = circle_ns / positive.shape[-1]
        return cls(positive / (positive.sum(axis=-1, keepdims=True) * knot_ns), float(circle_ns))

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.coefficients.shape[0]

    @property
    def knot_ns(self) -> float:
        """Spacing of the spline's knots, ns."""
        return self.circle_ns / self.coefficients.shape[-1]

    def shares(self, edges_ns: ArrayLike, delay_ns: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Compute the share of each band's light between successive edges.

        Parameters
        ----------
        edges_ns : array_like, shape (bin + 1,)
            Edges in ascending order, ns.
        delay_ns : array_like
            How much later the light arrives, ns: a number, or delays of shape (..., 1).

        Returns
        -------
        ndarray of float, shape (band, bin) or (band, ..., bin)
            Shares; over a whole period they sum to 1.
        """
        return np.diff(self._cumulative(np.asarray(edges_ns, np.float64) - np.asarray(delay_ns)))

    def slopes(self, edges_ns: ArrayLike, delay_ns: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Compute the derivative of `shares` with respect to the delay.

        Parameters
        ----------
        edges_ns : array_like, shape (bin + 1,)
            Edges in ascending order, ns.
        delay_ns : array_like
            How much later the light arrives, ns: a number, or delays of shape (..., 1).

        Returns
        -------
        ndarray of float, shape (band, bin) or (band, ..., bin)
            Derivatives, per ns.
        """
        return -np.diff(self.density(np.asarray(edges_ns, np.float64) - np.asarray(delay_ns)))

    def density(self, time_ns: ArrayLike) -> NDArray[np.float64]:
        """Evaluate the waveforms at given times.

        Parameters
        ----------
        time_ns : array_like, shape (time,)
            Times, ns; the waveforms repeat after `circle_ns`.

        Returns
        -------
        ndarray of float, shape (band, time)
            Share of each band's light per ns.
        """
        cell, phase = self._cell(np.asarray(time_ns, np.float64))
        knots = self.coefficients.shape[-1]
        return sum(
            (
                self.coefficients[:, (cell + offset) % knots] * b_spline(phase - offset)
                for offset in range(-1, 3)
            ),
            start=np.zeros((self.bands, *cell.shape)),
        )

    def _cumulative(self, time_ns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Light since time 0, going up by 1 with every turn of the circle, (band, time)."""
        cell, phase = self._cell(time_ns)
        knots = self.coefficients.shape[-1]
        running = np.cumsum(self.coefficients, axis=-1)
        turn, place = np.divmod(cell - 2, knots)
        total = running[:, place] + np.multiply.outer(running[:, -1], turn)
        for offset in range(-1, 3):
            total = total + self.coefficients[:, (cell + offset) % knots] * b_spline_integral(
                phase - offset
            )
        return total * self.knot_ns

    def _cell(self, time_ns: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        position = time_ns / self.knot_ns
        cell = np.floor(position)
        return cell.astype(np.intp), position - cell


def b_spline(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Evaluate the cubic B-spline with knots at distance 1, centred on 0, of area 1.

    Parameters
    ----------
    x : ndarray of float
        Positions, in units of the knot spacing.

    Returns
    -------
    ndarray of float
        Values, in the shape of `x`; 0 beyond ±2.
    """
    size = np.abs(x)
    inner = 2 / 3 - size**2 + size**3 / 2
    outer = np.maximum(2 - size, 0) ** 3 / 6
    return np.where(size < 1, inner, outer)


def b_spline_integral(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Evaluate the integral of `b_spline` from −∞.

    Parameters
    ----------
    x : ndarray of float
        Upper limits, in units of the knot spacing.

    Returns
    -------
    ndarray of float
        Values from 0 to 1, in the shape of `x`.
    """
    size = np.minimum(np.abs(x), 2.0)
    inner = 2 * size / 3 - size**3 / 3 + size**4 / 8
    outer = 0.5 - (2 - size) ** 4 / 24
    return 0.5 + np.copysign(np.where(size < 1, inner, outer), x)


def circle_of(bins: TimeBins) -> float:
    """Choose the circumference of the circle on which waveforms of some bins are described.

    Parameters
    ----------
    bins : TimeBins
        The bins.

    Returns
    -------
    float
        The period, or twice the span of the bins for a single shot, so that nothing wraps, ns.
    """
    return bins.span_ns * 2 if bins.period_ns is None else bins.period_ns


def design_matrix(
    edges_ns: NDArray[np.floating],
    knots: int,
    circle_ns: float,
    *,
    chosen: NDArray[np.intp] | None = None,
) -> sparse.csr_matrix:
    """Integrate the B-spline of every knot over every bin: shares are matrix @ coefficients.

    Parameters
    ----------
    edges_ns : ndarray of float, shape (bin + 1,)
        Edges of the bins in ascending order, ns.
    knots : int
        Number of knots on the circle.
    circle_ns : float
        Circumference of the circle, ns.
    chosen : ndarray of int, optional
        Bins whose rows are wanted; by default all.

    Returns
    -------
    scipy.sparse.csr_matrix, shape (bin, knot)
        The integrals, ns.
    """
    from scipy import sparse  # slow to import, and reading an instrument does not need it

    knot_ns = circle_ns / knots
    position = np.asarray(edges_ns, np.float64) / knot_ns
    begin, end = position[:-1], position[1:]
    if chosen is not None:
        begin, end = begin[chosen], end[chosen]
    bins = begin.size
    first = np.floor(begin).astype(np.intp) - 1
    last = np.floor(end).astype(np.intp) + 2
    offsets = np.arange(int((last - first).max(initial=0)) + 1)
    index = first[:, None] + offsets
    weight = knot_ns * (
        b_spline_integral(end[:, None] - index) - b_spline_integral(begin[:, None] - index)
    )
    rows = np.broadcast_to(np.arange(bins)[:, None], index.shape)
    return sparse.csr_matrix(
        (weight.ravel(), (rows.ravel(), (index % knots).ravel())), shape=(bins, knots)
    )


def fit_waveform(
    counts: NDArray[np.floating],
    offsets_ns: NDArray[np.floating],
    bins: TimeBins,
    *,
    knots: int,
    background: NDArray[np.floating],
    support: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Fit the spline coefficients that best explain the counts of one waveform.

    Weighted least squares with variances from the smoothed counts. Pixels come in groups of equal
    delay: each group samples the waveform at its own phase, so the delays sharpen the result
    instead of blurring it.

    Parameters
    ----------
    counts : ndarray of float, shape (group, bin)
        Counts in time order.
    offsets_ns : ndarray of float, shape (group,)
        How much later the light reaches each group, ns.
    bins : TimeBins
        Bins of the counts.
    knots : int
        Number of knots on the circle.
    background : ndarray of float, shape (group, bin)
        Counts that do not belong to this waveform.
    support : ndarray of bool, shape (knot,)
        Where the waveform may differ from 0.

    Returns
    -------
    ndarray of float, shape (knot,)
        Coefficients, none of them negative, in any scale; see `Templates.normalized`.
    """
    circle_ns = circle_of(bins)
    share = counts.sum(axis=-1) - background.sum(axis=-1)
    share = np.maximum(share, 0) / max(share[share > 0].sum(), 1e-300)
    chosen = np.flatnonzero(support)
    groups = np.flatnonzero(share)
    matrices, seen = [], []
    for group in groups:
        edges_ns = bins.edges_ns - offsets_ns[group]
        near = _near(edges_ns, support, circle_ns / knots)
        matrix = share[group] * design_matrix(edges_ns, knots, circle_ns, chosen=near)
        matrices.append(matrix[:, chosen])
        seen.append(near)
    signal = counts - background
    variances = [
        np.maximum(_smoothed(counts[group]), 1.0)[near]
        for group, near in zip(groups, seen, strict=True)
    ]
    solution = np.zeros(chosen.size)
    for _ in range(ROUNDS):  # variances of the counts at first, then those of the fit
        normal = np.zeros((chosen.size, chosen.size))
        right = np.zeros(chosen.size)
        parts = list(zip(groups, matrices, seen, variances, strict=True))
        for group, matrix, near, variance in parts:
            weighted = matrix.multiply(1 / variance[:, None]).tocsr()
            normal += (weighted.T @ matrix).toarray()
            right += weighted.T @ signal[group][near]
        solution = np.maximum(_smooth_solution(normal, right), 0)
        variances = [
            np.maximum(
                matrix @ solution + background[group][near], LEAST_EXPECTED * counts[group].mean()
            )
            for group, matrix, near, _ in parts
        ]
    coefficients = np.zeros(knots)
    coefficients[chosen] = solution
    return coefficients


def _near(
    edges_ns: NDArray[np.float64], support: NDArray[np.bool_], knot_ns: float
) -> NDArray[np.intp]:
    """Bins that a spline of the support reaches."""
    running = np.concatenate([[0], np.cumsum(support)])

    def before(knot: NDArray[np.intp]) -> NDArray[np.intp]:
        turns, place = np.divmod(knot, support.size)
        return turns * running[-1] + running[place]

    knot = np.floor(edges_ns / knot_ns).astype(np.intp)
    return np.flatnonzero(before(knot[1:] + 3) > before(knot[:-1] - 1))


def _smooth_solution(
    normal: NDArray[np.float64], right: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Solution of the normal equations, as smooth as the noise of the counts asks for.

    Second differences of the coefficients are taken as normal with a variance that the counts
    themselves tell (restricted maximum likelihood; Wood, Generalized Additive Models, 2017, 6.2).
    """
    from scipy.linalg import eigh  # slow to import, and reading an instrument does not need it

    size = right.size
    if size < 4:
        return np.linalg.solve(normal + 1e-12 * np.trace(normal) * np.eye(size), right)
    bend = np.diff(np.eye(size), n=2, axis=0)
    # knots that no bin resolves must not oscillate
    firm = normal + 1e-9 * np.trace(normal) / size * (bend.T @ bend + 1e-3 * np.eye(size))
    roughness, modes = eigh(bend.T @ bend, firm)
    roughness = np.maximum(roughness, 0.0)
    seen = modes.T @ right
    bent = np.arange(size) >= 2  # straight lines are not rough
    damping = np.outer(SMOOTHNESS / max(np.median(roughness), 1e-300), roughness[bent])
    # without noise a mode has the variance 1 / damping, with it 1 more
    spread = 1 + 1 / np.maximum(damping, 1e-300)
    misfit = (np.log(spread) + seen[bent] ** 2 / spread).sum(axis=-1)
    kept = np.ones(size)
    kept[bent] = 1 / (1 + CAUTION * damping[np.argmin(misfit)])
    return modes @ (kept * seen)


def _smoothed(counts: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean of each count with its neighbours: variances that don't follow single photons."""
    padded = np.concatenate([counts[-1:], counts, counts[:1]])
    return np.convolve(padded, [0.25, 0.5, 0.25], mode="valid")
