# SPDX-License-Identifier: Apache-2.0
"""Codes and time: every photon's code, worked out one by one, against the bins."""

from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hueflight import Instrument
from hueflight.model.time_bins import TimeBins


def code_of(time_ns: float, *, width_ns: float, period_ns: float, first: int, reverse: bool) -> int:
    """What a converter gives for one photon: started by it in reverse mode, else stopped."""
    counted = period_ns - time_ns if reverse else time_ns
    return first + floor(counted / width_ns)


@given(
    st.floats(0.05, 5),
    st.floats(10, 400),
    st.booleans(),
    st.integers(0, 1),
    st.floats(0.001, 0.999),
)
def test_every_photon_falls_in_the_bin_of_its_code(
    width: float, period: float, reverse: bool, first: int, place: float
) -> None:
    bins = TimeBins.nominal(
        codes=1 << 16, first_code=first, bin_width_ns=width, period_ns=period, reverse=reverse
    )
    time = place * period
    if np.abs(bins.edges_ns - time).min() < 1e-9:
        return  # on an edge rounding decides
    found = int(bins.codes[np.searchsorted(bins.edges_ns, time) - 1])
    assert found == code_of(time, width_ns=width, period_ns=period, first=first, reverse=reverse)
    assert bins.edges_ns[0] == pytest.approx(0, abs=1e-9)
    assert bins.edges_ns[-1] == pytest.approx(period)


def test_the_papers_period_is_498_44_bins() -> None:
    """notes: 320 ns / 642 ps = 498.44; in reverse mode the partial bin is code 499, at time 0."""
    bins = Instrument.load("paper").time_bins()
    assert bins.count == 499
    assert bins.codes[0] == 499
    assert bins.codes[-1] == 1
    assert bins.widths_ns[0] / 0.642 == pytest.approx(0.4423, abs=1e-4)
    np.testing.assert_allclose(bins.widths_ns[1:], 0.642)


def test_forward_mode_has_its_partial_bin_last() -> None:
    bins = Instrument.load("fine").time_bins()
    assert bins.codes[0] == 1
    assert bins.widths_ns[-1] == pytest.approx(320 - 5818 * 0.055)


def test_a_whole_number_of_bins_gains_no_sliver() -> None:
    assert TimeBins.codes_needed(320.0, 0.1) == 3200
    assert TimeBins.codes_needed(0.3, 0.1) == 3


@given(st.booleans(), st.integers(0, 1))
def test_time_order_is_a_view_that_picks_the_right_codes(reverse: bool, first: int) -> None:
    bins = TimeBins.nominal(
        codes=16, first_code=first, bin_width_ns=1.0, period_ns=10.5, reverse=reverse
    )
    histogram = np.arange(2 * 3 * 16).reshape(2, 3, 16)
    ordered = bins.in_time_order(histogram)
    np.testing.assert_array_equal(ordered, histogram[..., bins.codes])
    assert np.shares_memory(ordered, histogram)


def test_measured_widths_close_the_circle() -> None:
    bins = Instrument.load("paper").time_bins()
    measured = bins.with_widths(bins.widths_ns * 1.01)
    assert measured.edges_ns[-1] == pytest.approx(320)
    np.testing.assert_allclose(measured.widths_ns, bins.widths_ns)
