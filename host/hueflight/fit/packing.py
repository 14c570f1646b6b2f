# SPDX-License-Identifier: Apache-2.0
"""Tables of the fit as the compiled kernel reads them: flat arrays, the same for all its builds.

The kernel has pixels of one tabulated delay side by side, one in each lane of a vector, and goes
through the bins together for all of them. Its tables are therefore single numbers, and *segments*
say which bands light which bins: all bins of a segment have the same ones.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit import FIT_RULES, TABLE_SIZES
from hueflight.fit import assessment, detection, reference
from hueflight.fit.search_tables import RATIOS, SearchTables
from hueflight.fit.tables import BACKGROUND_SHARES, DelayTables, ModelTables
from hueflight.fit.tiles import TILE_BINS, Tiles


@dataclass(frozen=True, eq=False)
class PackedDelays:
    """Tables of one bin width.

    Attributes
    ----------
    blocks : int
        Blocks of ``BLOCK_BINS`` bins.
    widths : ndarray of float32, shape (block · bin,)
        Share of the background.
    run_places : ndarray of int32, shape (phase + 1,)
        First run of each phase.
    runs : ndarray of int32, shape (run, 6)
        Successive blocks that one band lights: band, first bin, bins, place in `data`, and of the
        bins that are lit the first one and how many; bands rise.
    data : ndarray of float32, shape (place,)
        Of each run all shares, then all slopes.
    segment_places : ndarray of int32, shape (phase + 1,)
        First segment of each phase.
    segments : ndarray of int32, shape (segment, 4)
        Successive bins that the same bands light: first bin, bins, bands, first row of `lit`.
    lit : ndarray of int32, shape (band of a segment, 3)
        Band, and the places of its first share and slope; bands rise.
    sums : ndarray of float32, shape (phase, band, 2)
        Sums of shares and of slopes over all bins.
    """

    blocks: int
    widths: NDArray[np.float32]
    run_places: NDArray[np.int32]
    runs: NDArray[np.int32]
    data: NDArray[np.float32]
    segment_places: NDArray[np.int32]
    segments: NDArray[np.int32]
    lit: NDArray[np.int32]
    sums: NDArray[np.float32]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name."""
        return _arrays(self)


@dataclass(frozen=True, eq=False)
class PackedSearch:
    """Tables of the search; of each lag only the bins that matter.

    Attributes
    ----------
    gain_places : ndarray of int32, shape (lag + 1,)
        First run of each lag.
    gain_runs : ndarray of int32, shape (run, 4)
        Successive bins that count for a band: band, first bin, one past the last, place in
        `gains`; bands rise.
    gains : ndarray of float32
        Values (bin, ratio) of all runs.
    costs : ndarray of float32, shape (lag, band, share, ratio)
        Costs of each share of background; see `SearchTables`.
    places : ndarray of int32, shape (lag + 1,)
        First zone of each lag.
    runs : ndarray of int32, shape (run, 3)
        Zone of a band: band, first bin, one past the last.
    widths, shares : ndarray of float32, shape (lag, band)
        Share of the background and of the band in its zone.
    """

    gain_places: NDArray[np.int32]
    gain_runs: NDArray[np.int32]
    gains: NDArray[np.float32]
    costs: NDArray[np.float32]
    places: NDArray[np.int32]
    runs: NDArray[np.int32]
    widths: NDArray[np.float32]
    shares: NDArray[np.float32]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name."""
        return _arrays(self)


def _arrays(packed: PackedDelays | PackedSearch) -> dict[str, NDArray[Any]]:
    values = {field.name: getattr(packed, field.name) for field in fields(packed)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


@dataclass(frozen=True, eq=False)
class PackedTables:
    """Tables of the fit as the kernel reads them.

    Attributes
    ----------
    fine, wide : PackedDelays
        Tables at the bin width of the result and at that of the search.
    search : PackedSearch
        Tables of the search.
    """

    fine: PackedDelays
    wide: PackedDelays
    search: PackedSearch


def pack(tables: ModelTables, *, skip_dark: bool = True) -> PackedTables:
    """Lay out tables for the kernel.

    Parameters
    ----------
    tables : ModelTables
        The tables.
    skip_dark : bool
        Leave out a band's bins in which its pulse is not; the results are the same.

    Returns
    -------
    PackedTables
        The same tables in flat arrays.
    """
    fine = _level(tables.fine, skip_dark=skip_dark)
    wide = fine if tables.wide is tables.fine else _level(tables.wide, skip_dark=skip_dark)
    return PackedTables(fine=fine, wide=wide, search=_search_tables(tables.search))


def sizes(tables: ModelTables, packed: PackedTables) -> NDArray[np.void]:
    """Return the sizes and scales of tables as the kernel reads them.

    Parameters
    ----------
    tables : ModelTables
        The tables.
    packed : PackedTables
        The same tables, packed.

    Returns
    -------
    ndarray of void, shape (1,)
        A `TableSizes` record.
    """
    search = tables.search
    lags_ns = search.lags_ns
    return TABLE_SIZES.pack(
        bands=tables.bands,
        views=len(tables.views),
        sensor_bins=sum(view.bins.count for view in tables.views),
        fine_factor=tables.fine_factor,
        wide_factor=tables.wide_factor,
        **_level_sizes("fine", tables.fine, packed.fine),
        **_level_sizes("wide", tables.wide, packed.wide),
        search_bins=search.widths.size,
        lags=lags_ns.size,
        separation=search.separation,
        first_lag_ns=lags_ns[0],
        lag_ns=lags_ns[1] - lags_ns[0] if lags_ns.size > 1 else 1.0,
    )


def _level_sizes(name: str, level: DelayTables, packed: PackedDelays) -> dict[str, float]:
    return {
        f"{name}_bins": level.widths.size,
        f"{name}_blocks": packed.blocks,
        f"{name}_phases": len(level.shares),
        f"{name}_first_ns": level.first_ns,
        f"{name}_phase_ns": level.phase_ns,
        f"{name}_whole": level.widths.sum(dtype=np.float64),
    }


def rules(tables: ModelTables, options: reference.FitOptions) -> NDArray[np.void]:
    """Return the constants of the fit and its options as the kernel reads them.

    Parameters
    ----------
    tables : ModelTables
        Tables of the fit.
    options : FitOptions
        What the fit may leave out.

    Returns
    -------
    ndarray of void, shape (1,)
        A `FitRules` record.
    """
    logs = assessment.deviance_table()[0]
    return FIT_RULES.pack(
        background_shares=BACKGROUND_SHARES,
        background_logs=np.log(BACKGROUND_SHARES),
        steps=reference.MOST_STEPS,
        few_steps=reference.FEW_STEPS,
        nodes=reference.NODES,
        rounds=reference.LIKELIHOOD_ROUNDS,
        settled=reference.SETTLED,
        settled_amplitude=reference.SETTLED_AMPLITUDE,
        floor_photons=reference.FLOOR_PHOTONS,
        floor_share=reference.FLOOR_SHARE,
        dark_width=reference.DARK_WIDTH,
        ridge=reference.RIDGE,
        margin=reference.MARGIN,
        raster=reference.RASTER,
        ambiguous=reference.AMBIGUOUS,
        few_photons=reference.FEW_PHOTONS,
        posterior_photons=reference.POSTERIOR_PHOTONS,
        node_spacing=reference.NODE_SPACING,
        certain_photons=detection.CERTAIN_PHOTONS,
        detection_share=detection.BACKGROUND_SHARE,
        assessed=options.assessment,
        asked=assessment.ASKED,
        least_background=assessment.LEAST_BACKGROUND,
        distinct=assessment.DISTINCT,
        least_mean=assessment.LEAST_MEAN,
        reach=assessment.REACH,
        contrasts=len(tables.contrasts),
        lag=assessment.lag_steps(tables.wide, tables.spread_ns),
        first_broadening=assessment.BROADENING[0] * tables.spread_ns,
        second_broadening=assessment.BROADENING[1] * tables.spread_ns,
        lag_allowance=assessment.LAG_ALLOWANCE,
        first_allowance=assessment.CONTRAST_ALLOWANCES[0],
        second_allowance=assessment.CONTRAST_ALLOWANCES[1],
        deviance_allowance=assessment.DEVIANCE_ALLOWANCE,
        first_log=logs[0],
        log_step=logs[1] - logs[0],
        points=logs.size,
        spread_ns=tables.spread_ns,
        low_ns=tables.search_ns[0],
        high_ns=tables.search_ns[1],
        target_ns=options.target_ns,
        starts_wide=options.starts_wide and tables.wide is not tables.fine,
        settle=options.settle,
        posterior=options.posterior,
    )


@dataclass(frozen=True, eq=False)
class _Parts:
    """Tiles, sorted: of each its phase, band, block and row of the shares and slopes."""

    phase: NDArray[np.int64]
    band: NDArray[np.int64]
    block: NDArray[np.int64]
    row: NDArray[np.int64]
    shares: NDArray[np.floating]
    slopes: NDArray[np.floating]


def _parts(tiles: Tiles, *, skip_dark: bool) -> _Parts:
    phases = tiles.places.size - 1
    phase = np.repeat(np.arange(phases), np.diff(tiles.places))
    band, block, row = (a.astype(np.int64) for a in (tiles.band, tiles.block, tiles.row))
    if skip_dark:
        return _Parts(phase, band, block, row, tiles.shares, tiles.slopes)
    everywhere = np.full((phases, tiles.bands, tiles.blocks), len(tiles.shares))  # row of zeros
    everywhere[phase, band, block] = row
    phase, band, block = (i.ravel() for i in np.indices(everywhere.shape))
    none = np.zeros((1, TILE_BINS), np.float32)
    shares, slopes = (np.concatenate([table, none]) for table in (tiles.shares, tiles.slopes))
    return _Parts(phase, band, block, everywhere.ravel(), shares, slopes)


def _level(level: DelayTables, *, skip_dark: bool) -> PackedDelays:
    tiles = level.tiles
    parts = _parts(tiles, skip_dark=skip_dark)
    phases = np.arange(tiles.places.size)
    begin, counts = _runs((parts.phase, parts.band), (parts.block, parts.row))
    # runs with the same values share them
    most = int(counts.max(initial=0)) + 1
    known, run_values = np.unique(parts.row[begin] * most + counts, return_inverse=True)
    rows, lengths = np.divmod(known, most)
    place = np.concatenate([[0], np.cumsum(2 * lengths)])
    data = np.empty((place[-1], TILE_BINS), np.float32)
    tables = (parts.shares, parts.slopes)
    for table, before in zip(tables, (np.zeros_like(lengths), lengths), strict=True):
        data[_stretched(place[:-1] + before, lengths)] = table[_stretched(rows, lengths)]
    phase, first = parts.phase[begin], parts.block[begin] * TILE_BINS
    low, high = first, np.minimum(first + counts * TILE_BINS, tiles.bins)
    if skip_dark:
        ends = begin + counts - 1
        lit = (parts.shares != 0) | (parts.slopes != 0)
        low = first + lit.argmax(axis=-1)[parts.row[begin]]
        high = (parts.block[ends] + 1) * TILE_BINS - lit[:, ::-1].argmax(axis=-1)[parts.row[ends]]
    bins, places = counts * TILE_BINS, place[run_values] * TILE_BINS
    runs = _table(parts.band[begin], first, bins, places, low, high - low)
    segment_phase, segments, lit_rows = _segments(phase, low, high, runs, phases, tiles.bins)
    return PackedDelays(
        blocks=tiles.blocks,
        widths=np.pad(level.widths, (0, tiles.blocks * TILE_BINS - tiles.bins)),
        run_places=np.searchsorted(phase, phases).astype(np.int32),
        runs=runs,
        data=data.ravel(),
        segment_places=np.searchsorted(segment_phase, phases).astype(np.int32),
        segments=segments,
        lit=lit_rows,
        sums=_sums(parts, phases.size - 1, tiles.bands),
    )


def _sums(parts: _Parts, phases: int, bands: int) -> NDArray[np.float32]:
    """Sums of shares and slopes over all bins, shape (phase, band, 2)."""
    whole = [
        np.bincount(
            parts.phase * bands + parts.band,
            values.sum(axis=-1, dtype=np.float64)[parts.row],
            phases * bands,
        )
        for values in (parts.shares, parts.slopes)
    ]
    return np.stack(whole, axis=-1).astype(np.float32).reshape(phases, bands, 2)


def _segments(
    phase: NDArray[np.int64],
    low: NDArray[np.int64],
    high: NDArray[np.int64],
    runs: NDArray[np.int32],
    phases: NDArray[np.int64],
    bins: int,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """Phase of each segment, segments, and the bands that light them.

    Each run is lit from bin `low` up to `high`; all bins of a phase are in one segment.
    """
    turn = bins + 1
    whole = phases[:-1] * turn
    edges = np.unique(
        np.concatenate([phase * turn + low, phase * turn + high, whole, whole + bins])
    )
    begin = np.flatnonzero(edges % turn != bins)
    first, end = edges[begin], edges[begin + 1]
    from_ = np.searchsorted(first, phase * turn + low)
    counts = np.searchsorted(first, phase * turn + high) - from_
    segment, run = _stretched(from_, counts), np.repeat(np.arange(phase.size), counts)
    order = np.argsort(segment, kind="stable")  # bands rise among the runs of a phase
    segment, run = segment[order], run[order]
    band, run_first, run_bins, place = runs[run, :4].T.astype(np.int64)
    share = place + first[segment] % turn - run_first
    bands = np.bincount(segment, minlength=first.size)
    segments = _table(first % turn, end - first, bands, np.cumsum(bands) - bands)
    return first // turn, segments, _table(band, share, share + run_bins)


def _table(*columns: NDArray[np.int64]) -> NDArray[np.int32]:
    return np.ascontiguousarray(np.column_stack(columns), np.int32)


def _runs(
    same: tuple[NDArray[np.int64], ...], rising: tuple[NDArray[np.int64], ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where runs begin in which some values stay and others rise by 1; their lengths."""
    size = same[0].size
    ends = np.zeros(max(size - 1, 0), bool)
    for values in same:
        ends |= np.diff(values) != 0
    for values in rising:
        ends |= np.diff(values) != 1
    begin = np.flatnonzero(np.concatenate([[size > 0], ends]))
    return begin, np.diff(np.append(begin, size))


def _stretched(first: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """As many successive numbers from each first one on as there are counts."""
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.repeat(first, counts) + within


def _search_tables(search: SearchTables) -> PackedSearch:
    lags = np.arange(search.lags_ns.size + 1)
    begin, counts = _runs((search.lag, search.band), (search.bin,))
    first = search.bin[begin]
    costs = np.array(BACKGROUND_SHARES)[:, None, None, None] * search.costs
    inside = np.flatnonzero(search.in_zone)
    lag, band, bin_ = search.lag[inside], search.band[inside], search.bin[inside]
    zone, zone_bins = _runs((lag, band), (bin_,))
    return PackedSearch(
        gain_places=np.searchsorted(search.lag[begin], lags).astype(np.int32),
        gain_runs=_table(search.band[begin], first, first + counts, begin * len(RATIOS)),
        gains=np.ascontiguousarray(search.gains().T).ravel(),
        costs=np.ascontiguousarray(costs.transpose(3, 2, 0, 1), np.float32),
        places=np.searchsorted(lag[zone], lags).astype(np.int32),
        runs=_table(band[zone], bin_[zone], bin_[zone] + zone_bins),
        widths=np.ascontiguousarray(search.zone_widths.T),
        shares=np.ascontiguousarray(search.zone_shares.T),
    )
