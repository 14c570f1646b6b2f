# SPDX-License-Identifier: Apache-2.0
"""Which fitted pairs of surfaces are two, and which of their light is told apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.tables import ModelTables
from hueflight.fit.two_returns import TwoReturns
from hueflight.reconstruction.conversion_rules import LIMIT_NS

APART = 2.0  #: standard deviations of the distance between the surfaces, at least
LARGEST_INFLATION = 9.0  #: of an amplitude's variance by the other surface's pulses


def told_apart(found: TwoReturns, tables: ModelTables) -> NDArray[np.bool_]:
    """Tell the pairs that are two surfaces, neither of them at the end of the searched range.

    Parameters
    ----------
    found : TwoReturns
        Fit of two surfaces to pixels.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray of bool, shape (pixel,)
        True where the delays differ by more than chance and by more than a step of the search.
    """
    apart = np.diff(found.delay_ns, axis=1)[:, 0]
    noise = np.sqrt((found.delay_std_ns**2).sum(axis=1))
    low, high = tables.search_ns
    inside = (found.delay_ns > low + LIMIT_NS) & (found.delay_ns < high - LIMIT_NS)
    lags_ns = tables.search.lags_ns
    step_ns = np.diff(lags_ns).mean() if lags_ns.size > 1 else 0.0
    return np.asarray((apart > np.maximum(APART * noise, step_ns)) & inside.all(axis=1))


def divided(found: TwoReturns) -> NDArray[np.bool_]:
    """Return where the light of the two surfaces can be told apart, not only its sum.

    Parameters
    ----------
    found : TwoReturns
        Fit of two surfaces to pixels.

    Returns
    -------
    ndarray of bool, shape (pixel, 2, band)
        False where pulses of both surfaces coincide, so that either amplitude is unknown and may
        even have come out negative.
    """
    return found.inflation <= LARGEST_INFLATION
