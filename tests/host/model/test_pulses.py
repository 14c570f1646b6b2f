# SPDX-License-Identifier: Apache-2.0
"""Pulses against scipy.stats.exponnorm and numerical integration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from hueflight.errors import InstrumentError
from hueflight.model.pulses import Pulse, full_width_half_maximum, gaussian_sigma

SIGMAS = st.floats(0.05, 10)
TAILS = st.one_of(st.just(0.0), st.floats(0.05, 20))


def scipy_twin(pulse: Pulse):
    if pulse.tail_ns == 0:
        return stats.norm(pulse.center_ns, pulse.sigma_ns)
    return stats.exponnorm(pulse.tail_ns / pulse.sigma_ns, pulse.center_ns, pulse.sigma_ns)


@given(SIGMAS, TAILS)
def test_density_and_cumulative_are_scipys(sigma: float, tail: float) -> None:
    pulse = Pulse(5.0, sigma, tail)
    reach = 6 * sigma + 6 * tail
    times = np.linspace(5 - reach, 5 + reach, 101)
    twin = scipy_twin(pulse)
    np.testing.assert_allclose(pulse.density(times), twin.pdf(times), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(pulse.cumulative(times), twin.cdf(times), rtol=0, atol=1e-9)


@given(SIGMAS, TAILS)
def test_slope_integrates_to_the_density(sigma: float, tail: float) -> None:
    pulse = Pulse(0.0, sigma, tail)
    times = np.linspace(-6 * sigma, 6 * sigma + 6 * tail, 20001)
    integral = integrate.cumulative_simpson(pulse.slope(times), x=times, initial=0)
    peak = pulse.density(times).max()
    np.testing.assert_allclose(
        integral + pulse.density(times[0]), pulse.density(times), atol=2e-4 * peak
    )


@given(SIGMAS, TAILS, st.floats(0, 320), st.integers(1, 600))
def test_a_pulse_on_the_circle_loses_nothing(
    sigma: float, tail: float, center: float, bins: int
) -> None:
    share = Pulse(center, sigma, tail).share(np.linspace(0, 320, bins + 1), 320.0)
    assert share.min() > -1e-12
    np.testing.assert_allclose(share.sum(), 1, atol=1e-12)


def test_a_late_pulse_wraps_to_the_start_of_the_period() -> None:
    edges = np.array([0.0, 10.0, 310.0, 320.0])
    np.testing.assert_allclose(Pulse(320.0, 2.0).share(edges, 320.0), [0.5, 0, 0.5], atol=1e-6)


def test_tail_of_an_extreme_ratio_does_not_overflow() -> None:
    """σ/tail = 2000: the factors of the closed form overflow, their product must not."""
    pulse = Pulse(0.0, 10.0, 0.005)
    gaussian = stats.norm(0.005, 10.0)
    times = np.linspace(-80, 80, 321)
    np.testing.assert_allclose(pulse.cumulative(times), gaussian.cdf(times), atol=1e-7)


@given(st.floats(0.1, 30), st.floats(0, 1.2))
def test_width_at_half_maximum_is_met(fwhm: float, tail_share: float) -> None:
    sigma = gaussian_sigma(fwhm, tail_share * fwhm)
    assert full_width_half_maximum(sigma, tail_share * fwhm) == pytest.approx(fwhm, rel=1e-9)


def test_a_tail_wider_than_its_pulse_is_refused() -> None:
    with pytest.raises(InstrumentError, match=r"tail of 20\.0 ns is alone as wide"):
        gaussian_sigma(10.0, 20.0)
