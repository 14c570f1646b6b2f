# SPDX-License-Identifier: Apache-2.0
"""Waveforms that change, against pulses in continuous time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import exponnorm, norm

from hueflight.errors import HueflightError
from hueflight.model import BackgroundShape, Templates
from hueflight.model.waveform_changes import centroids_ns, changed, drawn_out

CIRCLE_NS, KNOTS = 160.0, 640
EDGES = np.linspace(0, CIRCLE_NS, 200)


def gaussian(center_ns: float, sigma_ns: float) -> Templates:
    """A spline that is close to a Gaussian: each coefficient is the density at its knot."""
    knots = np.arange(KNOTS) * CIRCLE_NS / KNOTS
    apart = (knots - center_ns + CIRCLE_NS / 2) % CIRCLE_NS - CIRCLE_NS / 2
    return Templates(norm.pdf(apart, scale=sigma_ns)[None], CIRCLE_NS)


def shares(kind: object, center_ns: float) -> np.ndarray:
    turns = (-CIRCLE_NS, 0.0, CIRCLE_NS)
    return np.diff(sum(kind.cdf(EDGES - center_ns - turn) for turn in turns))


@pytest.mark.parametrize("center_ns", [60.0, 2.0])
def test_delay_and_width_change_as_stated(center_ns: float) -> None:
    moved = changed(gaussian(center_ns, 5.0), delay_ns=0.3, width_factor=1.1)
    expected = shares(norm(scale=5.5), center_ns + 0.3)
    np.testing.assert_allclose(moved.shares(EDGES)[0], expected, atol=3e-5)


def test_exponential_delay_is_that_of_scipy() -> None:
    late = drawn_out(gaussian(60.0, 5.0), 4.0)
    expected = shares(exponnorm(4.0 / 5.0, scale=5.0), 60.0)
    np.testing.assert_allclose(late.shares(EDGES)[0], expected, atol=3e-5)


def test_centroid_is_found_across_the_end_of_the_circle() -> None:
    found = centroids_ns(gaussian(159.0, 5.0))[0] % CIRCLE_NS
    assert found == pytest.approx(159.0, abs=1e-6)


@pytest.mark.parametrize("slope", [-1.0, 0.0, 0.5])
def test_slope_is_the_relative_change_to_either_side(slope: float) -> None:
    density = BackgroundShape(slope=slope).shares(EDGES) * 199
    assert density.sum() == pytest.approx(199)
    assert density[0] == pytest.approx(1 - slope, abs=0.02)
    assert density[-1] == pytest.approx(1 + slope, abs=0.02)


def test_decay_falls_by_its_time_constant() -> None:
    density = BackgroundShape(decay_share=1.0, decay_ns=20.0).shares(np.arange(161.0))
    assert density.sum() == pytest.approx(1)
    assert density[20] / density[0] == pytest.approx(np.exp(-1))


@pytest.mark.parametrize("wrong", [{"slope": 1.5}, {"decay_share": -0.1}, {"decay_ns": 0.0}])
def test_impossible_shapes_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(HueflightError, match=next(iter(wrong))):
        BackgroundShape(**wrong)
