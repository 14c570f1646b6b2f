# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hueflight.model.pulses import Pulse
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates, design_matrix, fit_waveform

BINS = TimeBins.nominal(codes=512, first_code=1, bin_width_ns=0.642, period_ns=320.0, reverse=True)


def fitted(pulse: Pulse, photons: float = 1e6) -> Templates:
    counts = photons * pulse.share(BINS.edges_ns, 320.0)
    coefficients = fit_waveform(
        counts[None],
        np.zeros(1),
        BINS,
        knots=498,
        background=np.zeros((1, BINS.count)),
        support=np.ones(498, bool),
    )
    return Templates.normalized(coefficients, 320.0)


@given(
    coefficients=st.lists(st.floats(0, 1e3), min_size=8, max_size=40).filter(lambda c: sum(c) > 1),
    delay_ns=st.floats(-1e3, 1e3),
)
def test_any_waveform_is_positive_with_area_one_on_the_circle(coefficients, delay_ns):
    templates = Templates.normalized(np.array(coefficients), 320.0)
    shares = templates.shares(BINS.edges_ns, delay_ns)
    assert shares.min() >= -1e-12
    assert shares.sum() == pytest.approx(1, abs=1e-9)


@settings(max_examples=25)
@given(delay_ns=st.floats(-400, 400))
def test_slopes_are_the_derivative_of_shares(delay_ns):
    templates = Templates.normalized(np.random.default_rng(1).random((2, 30)), 320.0)
    step_ns = 1e-4
    difference = (
        templates.shares(BINS.edges_ns, delay_ns + step_ns)
        - templates.shares(BINS.edges_ns, delay_ns - step_ns)
    ) / (2 * step_ns)
    np.testing.assert_allclose(
        templates.slopes(BINS.edges_ns, delay_ns), difference, rtol=1e-5, atol=1e-9
    )


@pytest.mark.parametrize("tail_ns", [0.0, 2.0, 6.0])
@pytest.mark.parametrize("delay_ns", [0.0, 0.31, 13.7, 260.0])
def test_fitted_spline_follows_the_pulse_between_bins_and_across_the_wrap(tail_ns, delay_ns):
    pulse = Pulse(60.3, 2.0, tail_ns)
    shares = fitted(pulse).shares(BINS.edges_ns, delay_ns)[0]
    moved = Pulse(60.3 + delay_ns, 2.0, tail_ns).share(BINS.edges_ns, 320.0)
    assert np.abs(shares - moved).max() < 1e-3 * moved.max()
    # 1 ps is 0.15 mm of depth
    assert abs((shares - moved) @ BINS.centers_ns) < (1e-3 if delay_ns < 200 else np.inf)


def test_groups_with_different_delays_sharpen_one_another():
    pulse = Pulse(60.3, 0.3)  # narrower than two bins: one phase alone can't resolve it
    offsets_ns = np.arange(8) * 0.642 / 8
    counts = np.array(
        [1e5 * Pulse(60.3 + offset, 0.3).share(BINS.edges_ns, 320.0) for offset in offsets_ns]
    )

    def error(groups: int) -> float:
        coefficients = fit_waveform(
            counts[:groups],
            offsets_ns[:groups],
            BINS,
            knots=1500,
            background=np.zeros((groups, BINS.count)),
            support=np.ones(1500, bool),
        )
        time_ns = np.linspace(57, 64, 500)
        found = Templates.normalized(coefficients, 320.0).density(time_ns)[0]
        return float(np.abs(found - pulse.density(time_ns)).max())

    assert error(8) < 0.05 < 0.2 < error(1)


def test_design_matrix_gives_the_same_shares():
    coefficients = np.random.default_rng(2).random(100)
    templates = Templates.normalized(coefficients, 320.0)
    matrix = design_matrix(BINS.edges_ns - 17.3, 100, 320.0)
    np.testing.assert_allclose(
        matrix @ templates.coefficients[0], templates.shares(BINS.edges_ns, 17.3)[0], atol=1e-14
    )
