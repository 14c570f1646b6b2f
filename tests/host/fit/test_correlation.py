# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hueflight.fit.correlation import correlate, peak_centroid
from hueflight.model.pulses import Pulse


@settings(max_examples=40)
@given(
    bins=st.integers(4, 120),
    max_lag=st.integers(0, 60),
    seed=st.integers(0, 1000),
)
def test_correlation_is_numpys(bins, max_lag, seed):
    max_lag = min(max_lag, bins - 1)
    rng = np.random.default_rng(seed)
    image, reference = rng.poisson(3, (2, 5, bins)).astype(np.float32)
    full = np.array(
        [np.correlate(i, r, mode="full") for i, r in zip(image, reference, strict=True)]
    )
    lags = slice(bins - 1 - max_lag, bins + max_lag)
    # single precision: 120 products of about 10
    np.testing.assert_allclose(correlate(image, reference, max_lag), full[:, lags], atol=2e-2)


def test_one_reference_serves_all_pixels():
    rng = np.random.default_rng(0)
    image, reference = rng.random((3, 50)), rng.random(50)
    np.testing.assert_allclose(
        correlate(image, reference, 10), correlate(image, np.tile(reference, (3, 1)), 10)
    )


@pytest.mark.parametrize("delay", np.linspace(-14.9, 14.9, 23))
def test_centroid_of_a_symmetric_pulse_has_no_bias(delay):
    edges = np.arange(201.0)
    reference = 1e5 * Pulse(100.0, 7.0).share(edges, None)
    image = 1e4 * Pulse(100.0 + delay, 7.0).share(edges, None)
    lags = correlate(image[None], reference, 35)
    found = peak_centroid(lags, search=20, half_width=12.0, rounds=10)
    # the pedestal is taken at the search's edge, which cuts the foot of one side a little
    assert found[0] == pytest.approx(delay, abs=0.02 + 0.01 * abs(delay))


def test_centroid_ignores_flat_background():
    edges = np.arange(201.0)
    reference = 1e5 * Pulse(100.0, 7.0).share(edges, None)
    image = 1e4 * Pulse(103.3, 7.0).share(edges, None)
    plain = peak_centroid(correlate(image[None], reference, 35), search=20, half_width=12.0)
    lifted = correlate(image[None], reference, 35) + 1e8
    assert peak_centroid(lifted, search=20, half_width=12.0)[0] == pytest.approx(plain[0], abs=1e-2)


def test_centroid_stays_inside_the_search():
    falling = np.linspace(10, 0, 41)[None]
    assert abs(peak_centroid(falling, search=10, half_width=8.0)[0]) <= 10
