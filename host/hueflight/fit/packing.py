# SPDX-License-Identifier: Apache-2.0
"""Tables of the fit as the compiled kernel reads them: flat arrays in vectors of bins or lags."""

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

SPAN_GAP = 4  #: bins without gain between two spans of the search that are kept apart


@dataclass(frozen=True, eq=False)
class PackedDelays:
    """Tables of one bin width, in blocks of as many bins as a vector has lanes.

    Attributes
    ----------
    blocks : int
        Blocks of bins.
    widths : ndarray of float32, shape (block · lane,)
        Share of the background.
    places : ndarray of int32, shape (phase + 1,)
        First run of each phase.
    runs : ndarray of int32, shape (run, 4)
        Successive blocks that one band lights: band, first block, blocks, place in `data`; bands
        rise.
    data : ndarray of float32, shape (place, lane)
        Of each run all shares, then all slopes.
    pairs : ndarray of uint8, shape (pair, 2)
        Bands that share a block at some delay, the greater first.
    meets : ndarray of int32, shape (phase + 1,)
        First meeting of each phase.
    meetings : ndarray of int32, shape (meeting, 5)
        Successive blocks that two bands light: pair, first block, blocks, places of their shares.
    """

    blocks: int
    widths: NDArray[np.float32]
    places: NDArray[np.int32]
    runs: NDArray[np.int32]
    data: NDArray[np.float32]
    pairs: NDArray[np.uint8]
    meets: NDArray[np.int32]
    meetings: NDArray[np.int32]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name."""
        return _arrays(self)


@dataclass(frozen=True, eq=False)
class PackedSearch:
    """Tables of the search; of each vector of lags only the bins that matter.

    Attributes
    ----------
    span_places : ndarray of int32, shape (vector · band + 1,)
        First span of each band at each vector of lags.
    spans : ndarray of int32, shape (span, 3)
        First bin, one past the last, and place in `gains`.
    gains : ndarray of float32
        Values (ratio, lane) for each bin of a span.
    costs : ndarray of float32, shape (vector, band, ratio, lane)
        Costs of the background; see `SearchTables`.
    places : ndarray of int32, shape (lag + 1,)
        First run of each lag.
    runs : ndarray of int32, shape (run, 3)
        Zone of a band: band, first bin, one past the last.
    widths, shares : ndarray of float32, shape (lag, band)
        Share of the background and of the band in its zone.
    """

    span_places: NDArray[np.int32]
    spans: NDArray[np.int32]
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


def pack(tables: ModelTables, lanes: int, *, skip_dark: bool = True) -> PackedTables:
    """Lay out tables for a kernel with vectors of so many lanes.

    Parameters
    ----------
    tables : ModelTables
        The tables.
    lanes : int
        Elements of a vector.
    skip_dark : bool
        Leave out a band's blocks of bins in which its pulse is not; the results are the same.

    Returns
    -------
    PackedTables
        The same tables in flat arrays.
    """
    fine = _level(tables.fine, lanes, skip_dark=skip_dark)
    wide = fine if tables.wide is tables.fine else _level(tables.wide, lanes, skip_dark=skip_dark)
    return PackedTables(fine=fine, wide=wide, search=_search_tables(tables.search, lanes))


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
    """Tiles cut to vectors: of each its phase, band, block and row of `values`, sorted so."""

    phase: NDArray[np.int64]
    band: NDArray[np.int64]
    block: NDArray[np.int64]
    row: NDArray[np.int64]
    values: tuple[NDArray[np.floating], NDArray[np.floating]]  # shares and slopes, (row, lane)


def _parts(tiles: Tiles, lanes: int, *, skip_dark: bool) -> _Parts:
    several = TILE_BINS // lanes
    values = tuple(table.reshape(-1, lanes) for table in (tiles.shares, tiles.slopes))
    lit = np.asarray(values[0].any(axis=-1)) | np.asarray(values[1].any(axis=-1))
    within = np.arange(several)
    row = (tiles.row[:, None].astype(np.int64) * several + within).ravel()
    block = (tiles.block[:, None].astype(np.int64) * several + within).ravel()
    phases = tiles.places.size - 1
    phase = np.repeat(np.arange(phases), several * np.diff(tiles.places))
    band = np.repeat(tiles.band.astype(np.int64), several)
    if not skip_dark:
        blocks = -(-tiles.bins // lanes)
        everywhere = np.full((phases, tiles.bands, blocks), lit.size)  # a row of zeros
        seen = block < blocks
        everywhere[phase[seen], band[seen], block[seen]] = row[seen]
        phase, band, block = (i.ravel() for i in np.indices(everywhere.shape))
        none = np.zeros((1, lanes), np.float32)
        shares, slopes = (np.concatenate([table, none]) for table in values)
        return _Parts(phase, band, block, everywhere.ravel(), (shares, slopes))
    kept = lit[row]
    return _Parts(phase[kept], band[kept], block[kept], row[kept], (values[0], values[1]))


def _level(level: DelayTables, lanes: int, *, skip_dark: bool) -> PackedDelays:
    tiles = level.tiles
    blocks = -(-tiles.bins // lanes)
    parts = _parts(tiles, lanes, skip_dark=skip_dark)
    phases = np.arange(tiles.places.size)
    begin, counts = _runs((parts.phase, parts.band), (parts.block, parts.row))
    # runs with the same values share them
    most = int(counts.max(initial=0)) + 1
    known, run_values = np.unique(parts.row[begin] * most + counts, return_inverse=True)
    rows, lengths = np.divmod(known, most)
    place = np.concatenate([[0], np.cumsum(2 * lengths)])
    data = np.empty((place[-1], lanes), np.float32)
    for table, before in zip(parts.values, (np.zeros_like(lengths), lengths), strict=True):
        data[_stretched(place[:-1] + before, lengths)] = table[_stretched(rows, lengths)]
    places = place[run_values]
    pairs, meetings, met_phase = _meetings(parts, blocks, tiles.bands, _stretched(places, counts))
    return PackedDelays(
        blocks=blocks,
        widths=np.pad(level.widths, (0, blocks * lanes - tiles.bins)),
        places=np.searchsorted(parts.phase[begin], phases).astype(np.int32),
        runs=_table(parts.band[begin], parts.block[begin], counts, places),
        data=data,
        pairs=pairs,
        meets=np.searchsorted(met_phase, phases).astype(np.int32),
        meetings=meetings,
    )


def _meetings(
    parts: _Parts, blocks: int, bands: int, places: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], NDArray[np.int32], NDArray[np.int64]]:
    """Pairs of bands that share blocks, their meetings, and the phase of each meeting."""
    key = parts.phase * blocks + parts.block
    order = np.argsort(key, kind="stable")  # bands rise among the parts of a block
    key = key[order]
    lower, upper = [], []
    for apart in range(1, bands):
        same = np.flatnonzero(key[apart:] == key[:-apart])
        if not same.size:
            break
        lower.append(order[same])
        upper.append(order[same + apart])
    nothing = np.empty(0, np.int64)
    one, other = np.concatenate([nothing, *upper]), np.concatenate([nothing, *lower])
    known, pair = np.unique(parts.band[one] * bands + parts.band[other], return_inverse=True)
    order = np.lexsort((parts.block[one], pair, parts.phase[one]))
    one, other, pair = one[order], other[order], pair[order]
    phase, block = parts.phase[one], parts.block[one]
    begin, counts = _runs((phase, pair), (block, places[one], places[other]))
    met = _table(pair[begin], block[begin], counts, places[one][begin], places[other][begin])
    pairs = np.column_stack(np.divmod(known, bands)).astype(np.uint8)
    return np.ascontiguousarray(pairs), met, phase[begin]


def _table(*columns: NDArray[np.int64]) -> NDArray[np.int32]:
    return np.ascontiguousarray(np.column_stack(columns), np.int32)


def _runs(
    same: tuple[NDArray[np.int64], ...], rising: tuple[NDArray[np.int64], ...], *, by: int = 1
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where runs begin in which some values stay and others rise by 1 to `by`; their lengths."""
    size = same[0].size
    ends = np.zeros(max(size - 1, 0), bool)
    for values in same:
        ends |= np.diff(values) != 0
    for values in rising:
        ends |= (np.diff(values) > by) | (np.diff(values) < 1)
    begin = np.flatnonzero(np.concatenate([[size > 0], ends]))
    return begin, np.diff(np.append(begin, size))


def _stretched(first: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """As many successive numbers from each first one on as there are counts."""
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.repeat(first, counts) + within


def _search_tables(search: SearchTables, lanes: int) -> PackedSearch:
    bins, lags, bands = search.widths.size, search.lags_ns.size, search.bands
    vectors = -(-lags // lanes)
    vector, lane = np.divmod(search.lag, lanes)
    columns, column = np.unique(
        (vector * bands + search.band) * bins + search.bin, return_inverse=True
    )
    group, column_bin = np.divmod(columns, bins)
    begin, counts = _runs((group,), (column_bin,), by=SPAN_GAP)
    first, last = column_bin[begin], column_bin[begin + counts - 1] + 1
    size = len(RATIOS) * lanes
    place = np.concatenate([[0], np.cumsum((last - first) * size)])
    span = np.repeat(np.arange(begin.size), counts)[column]
    gains = np.zeros(place[-1] + 1, np.float32)
    at = place[span] + (search.bin - first[span]) * size + lane
    for ratio, values in enumerate(search.gains()):
        gains[at + ratio * lanes] = values
    costs = np.pad(search.costs, ((0, 0), (0, 0), (0, vectors * lanes - lags)))
    costs = costs.reshape(len(RATIOS), bands, vectors, lanes).transpose(2, 1, 0, 3)
    inside = np.flatnonzero(search.in_zone)
    lag, band, bin_ = search.lag[inside], search.band[inside], search.bin[inside]
    zone, zone_bins = _runs((lag, band), (bin_,))
    return PackedSearch(
        span_places=np.searchsorted(group[begin], np.arange(vectors * bands + 1)).astype(np.int32),
        spans=_table(first, last, place[:-1]),
        gains=gains,
        costs=np.ascontiguousarray(costs),
        places=np.searchsorted(lag[zone], np.arange(lags + 1)).astype(np.int32),
        runs=_table(band[zone], bin_[zone], bin_[zone] + zone_bins),
        widths=np.ascontiguousarray(search.zone_widths.T),
        shares=np.ascontiguousarray(search.zone_shares.T),
    )
