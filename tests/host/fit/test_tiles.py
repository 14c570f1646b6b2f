# SPDX-License-Identifier: Apache-2.0
"""Sparse tables of the model against waveforms evaluated in every bin."""

import numpy as np
import pytest

from hueflight.fit import packing
from hueflight.fit.tables import CROP, ScheduleView, make_tables
from hueflight.fit.tiles import Waveforms, lit_stretches, make_tiles
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates

BIN_NS = 0.05
PERIOD_NS = 200 * 16 * BIN_NS


def templates(centers_ns, *, circle_ns=PERIOD_NS, sigma_ns=0.15):
    """Gaussian pulses; a band may have several."""
    time_ns = np.arange(round(circle_ns / 0.03)) * (circle_ns / round(circle_ns / 0.03))
    bands = []
    for centers in centers_ns:
        apart = time_ns[:, None] - np.atleast_1d(centers)
        apart -= circle_ns * np.rint(apart / circle_ns)
        bands.append(np.exp(-((apart / sigma_ns) ** 2) / 2).sum(axis=1))
    return Templates.normalized(np.array(bands), circle_ns)


def nominal(period_ns=PERIOD_NS, *, codes=1 << 14, reverse=False):
    return TimeBins.nominal(
        codes=codes, first_code=0, bin_width_ns=BIN_NS, period_ns=period_ns, reverse=reverse
    )


def uneven(bins):
    widths = np.random.default_rng(1).uniform(0.8, 1.2, bins.count)
    return bins.with_widths(widths * bins.span_ns / widths.sum())


CASES = {
    "period of whole blocks": [ScheduleView(nominal(), templates([20.0, 70.0, 120.0]))],
    "pulse over the end of the period": [ScheduleView(nominal(), templates([0.1, 80.0, 159.9]))],
    "partial bin first": [
        ScheduleView(nominal(160.02, reverse=True), templates([20.0, 70.0], circle_ns=160.02))
    ],
    "partial bin last": [ScheduleView(nominal(160.02), templates([20.0, 70.0], circle_ns=160.02))],
    "single shot": [
        ScheduleView(nominal(None, codes=3000), templates([20.0, 70.0], circle_ns=300.0))
    ],
    "bins of measured widths": [ScheduleView(uneven(nominal()), templates([20.0, 70.0]))],
    "trains of pulses": [ScheduleView(nominal(), templates([[20.0, 90.0, 21.0], [50.0, 140.0]]))],
    "bands that overlap": [ScheduleView(nominal(), templates([20.0, 20.2, 20.4]))],
    "two schedules": [
        ScheduleView(nominal(160.02), templates([20.0, 70.0], circle_ns=160.02), 2.0),
        ScheduleView(nominal(160.02), templates([30.0, 95.0], circle_ns=160.02), 1.0),
    ],
}


def tables(views, *, search_ns=(-40.0, 40.0), fwhm_ns=0.35):
    bands = views[0].templates.bands
    return make_tables(
        views, shortest_fwhm_ns=fwhm_ns, brightness=np.ones(bands), search_ns=search_ns
    )


def expected(level, views, factor, phase):
    """Shares and slopes (band, bin) in every bin, cropped as the tables are."""
    delay_ns = level.first_ns + phase * level.phase_ns
    whole = sum(view.weight for view in views)
    shares, slopes = [], []
    for view in views:
        edges = np.append(view.bins.edges_ns[:-1][::factor], view.bins.edges_ns[-1])
        shares.append(view.templates.shares(edges, delay_ns) * view.weight / whole)
        slopes.append(view.templates.slopes(edges, delay_ns) * view.weight / whole)
    return np.concatenate(shares, axis=-1), np.concatenate(slopes, axis=-1)


@pytest.mark.parametrize("views", CASES.values(), ids=CASES.keys())
@pytest.mark.parametrize("name", ["fine", "wide"])
def test_tables_hold_the_light_of_every_bin(views, name):
    made = tables(views)
    level = getattr(made, name)
    factor = made.fine_factor * (made.wide_factor if name == "wide" else 1)
    phases = len(level.shares)
    for phase in [*np.random.default_rng(2).integers(0, phases, 25).tolist(), 0, phases - 1]:
        shares, slopes = expected(level, views, factor, phase)
        atol = 2 * CROP * shares.max() + 1e-9
        np.testing.assert_allclose(level.shares[phase], shares, rtol=1e-5, atol=atol)
        lit = level.shares[phase] > 0
        np.testing.assert_allclose(
            level.slopes[phase][lit], slopes[lit], rtol=1e-4, atol=1e-5 * np.abs(slopes).max()
        )


def test_equal_bins_share_values():
    made = tables(CASES["period of whole blocks"])
    rows = made.fine.tiles.shares.shape[0]
    assert made.fine.tiles.row.size > 20 * rows
    lone = tables(CASES["bins of measured widths"])
    assert lone.fine.tiles.row.size == lone.fine.tiles.shares.shape[0]


def test_light_that_is_never_out():
    """A pulse as long as its period, beside a short one."""
    short, long = np.exp(-((np.arange(64) - 30.0) ** 2) / 8), np.full(64, 1.0)
    dark, bright = lit_stretches(Templates.normalized(np.array([short, long]), 32.0))
    np.testing.assert_array_equal(bright, [[0.0, 32.0]])
    assert (np.diff(dark) < 16).all()


def test_short_ranges_step_by_a_fiftieth_of_the_pulse():
    assert tables(CASES["two schedules"], search_ns=(-2.0, 2.0)).fine.phase_ns == 0.35 / 50
    large = tables(CASES["two schedules"])
    assert 0.9 * 0.35 / 50 < large.fine.phase_ns <= 0.35 / 50


@pytest.mark.parametrize("views", CASES.values(), ids=CASES.keys())
def test_packed_tables_hold_the_same(views):
    level = tables(views, search_ns=(-12.0, 12.0)).fine
    made = packing.pack(tables(views, search_ns=(-12.0, 12.0))).fine
    bands, bins = level.shares.shape[1:]
    for phase in np.random.default_rng(3).integers(0, len(level.shares), 10).tolist():
        shares, slopes = np.zeros((2, bands, made.widths.size), np.float32)
        runs = made.runs[slice(*made.run_places[phase : phase + 2])]
        for band, first, count, place, lit_first, lit_count in runs:
            shares[band, first : first + count] += made.data[place : place + count]
            slopes[band, first : first + count] += made.data[place + count : place + 2 * count]
            light = (shares[band] != 0) | (slopes[band] != 0)
            lit = first + np.flatnonzero(light[first : first + count])
            assert (lit[0], lit[-1]) == (lit_first, lit_first + lit_count - 1)
        for packed, table in ((shares, level.shares), (slopes, level.slopes)):
            np.testing.assert_array_equal(packed[:, :bins], table[phase])


@pytest.mark.parametrize("views", CASES.values(), ids=CASES.keys())
@pytest.mark.parametrize("skip_dark", [True, False])
def test_segments_hold_the_same(views, skip_dark):
    level = tables(views, search_ns=(-12.0, 12.0)).fine
    made = packing.pack(tables(views, search_ns=(-12.0, 12.0)), skip_dark=skip_dark).fine
    bands, bins = level.shares.shape[1:]
    for phase in np.random.default_rng(3).integers(0, len(level.shares), 10).tolist():
        shares, slopes = np.zeros((2, bands, bins), np.float32)
        end = 0
        for first, count, some, lit in made.segments[
            slice(*made.segment_places[phase : phase + 2])
        ]:
            assert first == end
            assert count > 0
            end = first + count
            rows = made.lit[lit : lit + some]
            assert (np.diff(rows[:, 0]) > 0).all()
            for band, share, slope in rows:
                shares[band, first:end] = made.data[share : share + count]
                slopes[band, first:end] = made.data[slope : slope + count]
        assert end == bins
        np.testing.assert_array_equal(shares, level.shares[phase])
        np.testing.assert_array_equal(slopes, level.slopes[phase])
        for column, table in enumerate((shares, slopes)):
            sums = table.sum(axis=-1, dtype=np.float64)
            np.testing.assert_allclose(made.sums[phase, :, column], sums, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("views", CASES.values(), ids=CASES.keys())
def test_the_search_gives_each_bin_to_its_brightest_band(views):
    made = tables(views, search_ns=(-12.0, 12.0))
    search, whole = made.search, sum(view.weight for view in views)
    factor = made.fine_factor * made.wide_factor
    packed = packing.pack(made).search
    rng = np.random.default_rng(4)
    for lag in rng.integers(0, search.lags_ns.size, 5).tolist():
        parts = []
        for view in views:
            edges = np.append(view.bins.edges_ns[:-1][::factor], view.bins.edges_ns[-1])
            shares = view.templates.shares(edges, search.lags_ns[lag])
            parts.append(shares * view.weight / whole)
        shares = np.concatenate(parts, axis=-1)
        own = shares.argmax(axis=0) == np.arange(len(shares))[:, None]
        density = np.where(own, shares, 0.0) / search.widths
        here = search.lag == lag
        shape = np.zeros_like(density)
        shape[search.band[here], search.bin[here]] = search.shape[here]
        # the peak is that over all lags: of the same band everywhere the same number
        for band in range(len(shares)):
            ratio = density[band][shape[band] > 0] / shape[band][shape[band] > 0]
            np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)
        assert (density[shape == 0] < 1.1e-3 * density.max()).all()
        found = np.zeros((len(shares), search.widths.size), np.float32)
        for run in packed.gain_runs[slice(*packed.gain_places[lag : lag + 2])]:
            band, first, last, place = run.tolist()
            found[band, first:last] = packed.gains[place : place + (last - first) * 3][1::3]
        np.testing.assert_allclose(found, np.log1p(15 * shape), rtol=1e-6)


def test_no_tile_where_no_pulse_reaches_a_bin():
    bins = nominal(None, codes=320)  # 16 ns of a single shot, whose pulse comes after 20
    waveforms = Waveforms(bins.edges_ns, templates([20.0], circle_ns=300.0), 1.0)
    tiles = make_tiles([waveforms], 0, 3, BIN_NS, crop=CROP)
    assert tiles.places.tolist() == [0, 0, 0, 0]
    assert tiles.shares.size == tiles.row.size == 0
