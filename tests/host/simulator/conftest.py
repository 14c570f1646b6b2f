# SPDX-License-Identifier: Apache-2.0
"""Small instruments, and the statistics that the tests share."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from hueflight import Instrument


@pytest.fixture(scope="session")
def resized() -> Callable[..., Instrument]:
    """The same instrument with other pixels (and exposure)."""

    def make(instrument: Instrument, rows: int, cols: int, **sensor: object) -> Instrument:
        changes = {"rows": rows, "cols": cols, "scan_steps": 1, **sensor}
        return instrument.replace(sensor=msgspec.structs.replace(instrument.sensor, **changes))

    return make


@pytest.fixture(scope="session")
def goodness_of_fit() -> Callable[[NDArray[np.integer], NDArray[np.floating]], float]:
    """Pearson's test: probability of a fit as bad as this or worse.

    Outcomes expected less than 10 times are counted together.
    """

    def p_value(counts: NDArray[np.integer], probabilities: NDArray[np.floating]) -> float:
        expected = counts.sum() * probabilities
        rare = expected < 10
        observed = np.append(counts[~rare], counts[rare].sum())
        wanted = np.append(expected[~rare], expected[rare].sum())
        possible = wanted > 0
        assert not observed[~possible].any(), "something impossible happened"
        statistic = np.sum((observed - wanted)[possible] ** 2 / wanted[possible])
        return float(stats.chi2.sf(statistic, np.count_nonzero(possible) - 1))

    return p_value


@pytest.fixture(scope="session")
def one_pixel(paper: Instrument, resized: Callable[..., Instrument]) -> Instrument:
    return resized(paper, 1, 1)


@pytest.fixture(scope="session")
def full_rate_pixel(resized: Callable[..., Instrument]) -> Instrument:
    """168 periods per exposure, where pile-up within a period can be seen."""
    return resized(Instrument.load("fullrate"), 1, 1)
