# SPDX-License-Identifier: Apache-2.0
"""Non-negative least squares of many small problems at once, from their normal equations.

The problems are the last dimension of all arrays, so that each step of an elimination is one
operation on all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: rounds in which all infeasible entries are exchanged, before they are exchanged one at a time
BLOCK_ROUNDS = 8
#: a gradient is taken for 0 up to this share of the largest right-hand side
ROUNDING = 1e-10


def nonnegative_solutions(matrices: Array, sides: Array, free: Array, /) -> Array:
    """Minimize ½ xᵀ M x − sᵀ x over x ≥ 0 for many positive definite matrices M.

    Parameters
    ----------
    matrices : ndarray, shape (entry, entry, problem)
        Matrices M, such as those of normal equations.
    sides : ndarray, shape (entry, problem)
        Right-hand sides s.
    free : ndarray, shape (entry, problem)
        Solutions without the bound, M⁻¹ s; those that are not negative stay as they are.

    Returns
    -------
    ndarray, shape (entry, problem)
        Solutions x.

    Notes
    -----
    Block principal pivoting (Kim and Park, SIAM J. Sci. Comput. 33, 3261, 2011): entries that are
    negative leave the set of positive ones, entries with a negative gradient enter it. After
    `BLOCK_ROUNDS` only the last infeasible entry is exchanged, which ends for positive definite
    matrices (Murty, Linear Algebra Appl. 7, 65, 1974).
    """
    found = free.copy()
    left = np.flatnonzero((free < 0).any(axis=0))
    part, side, positive = matrices[..., left], sides[:, left], free[:, left] >= 0
    rounds = 0
    while left.size:
        solved = _restricted(part, side, positive)
        gradient = (part * solved).sum(axis=1) - side
        slack = ROUNDING * np.abs(side).max(axis=0)
        wrong = np.where(positive, solved < 0, gradient < -slack)
        done = ~wrong.any(axis=0)
        found[:, left[done]] = solved[:, done]
        if rounds >= BLOCK_ROUNDS:
            wrong = _last(wrong)
        open_ = ~done
        left, part, side = left[open_], part[..., open_], side[:, open_]
        positive = (positive ^ wrong)[:, open_]
        rounds += 1
    return found


def inverses(matrices: Array, /) -> Array:
    """Return the inverses of positive definite matrices.

    Parameters
    ----------
    matrices : ndarray, shape (entry, entry, problem)
        The matrices.

    Returns
    -------
    ndarray, shape (entry, entry, problem)
        Their inverses, by Gauss-Jordan elimination, which needs no pivoting here.
    """
    found = matrices.copy()
    for place in range(len(found)):
        pivot = 1 / found[place, place]
        row, column = found[place] * pivot, found[:, place].copy()
        found -= column[:, None] * row
        found[place], found[:, place] = row, -column * pivot
        found[place, place] = pivot
    return found


def _restricted(matrices: Array, sides: Array, positive: NDArray[np.bool_]) -> Array:
    """Solutions in which all entries but the positive ones are 0, by Gaussian elimination."""
    left = matrices * (positive[:, None] & positive)
    entries = np.arange(len(left))
    left[entries, entries] += ~positive
    solved = sides * positive
    for place in entries[:-1]:
        factors = left[place + 1 :, place] / left[place, place]
        left[place + 1 :, place + 1 :] -= factors[:, None] * left[place, place + 1 :]
        solved[place + 1 :] -= factors * solved[place]
    for place in entries[::-1]:
        known = (left[place, place + 1 :] * solved[place + 1 :]).sum(axis=0)
        solved[place] = (solved[place] - known) / left[place, place]
    return solved


def _last(marks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The last mark of each problem alone."""
    last = len(marks) - 1 - marks[::-1].argmax(axis=0)
    return marks & (np.arange(len(marks))[:, None] == last)
