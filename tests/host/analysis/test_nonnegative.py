# SPDX-License-Identifier: Apache-2.0
"""Many small problems at once give what Lawson and Hanson's method gives for each."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from hueflight.analysis import nonnegative
from hueflight.analysis.nonnegative import inverses, nonnegative_solutions

PROBLEMS = 300


@pytest.mark.parametrize("rounds", [0, 8])
@pytest.mark.parametrize("entries", [1, 2, 5, 12])
def test_solutions_are_those_of_scipy(
    entries: int, rounds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By exchanges of blocks, and of one entry at a time."""
    monkeypatch.setattr(nonnegative, "BLOCK_ROUNDS", rounds)
    rng = np.random.default_rng(entries)
    designs = rng.random((PROBLEMS, entries + 3, entries))
    truth = np.maximum(rng.normal(size=(PROBLEMS, entries, 1)), 0)
    values = (designs @ truth)[..., 0] + 0.3 * rng.normal(size=(PROBLEMS, entries + 3))
    matrices = np.einsum("pbk,pbl->klp", designs, designs)
    sides = np.einsum("pbk,pb->kp", designs, values)
    inverse = inverses(matrices)
    identity = np.einsum("klp,lmp->pkm", matrices, inverse)
    np.testing.assert_allclose(
        identity, np.broadcast_to(np.eye(entries), identity.shape), atol=1e-7
    )
    found = nonnegative_solutions(matrices, sides, (inverse * sides).sum(axis=1))
    wanted = np.array([nnls(*one)[0] for one in zip(designs, values, strict=True)]).T
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert ((found == 0) == (wanted == 0)).all()
    assert 0.1 < (found == 0).mean() < 0.7
