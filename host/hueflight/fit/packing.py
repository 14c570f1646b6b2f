"""Tables of the fit as the compiled kernel reads them: flat arrays in vectors of bins or lags."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit import FIT_RULES, TABLE_SIZES
from hueflight.fit import assessment, detection, reference
from hueflight.fit.tables import BACKGROUND_SHARES, DelayTables, ModelTables, SearchTables


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
    spans : ndarray of int32, shape (vector, band, 3)
        First bin, one past the last, and place in `gains`.
    gains : ndarray of float32
        Values (ratio, lane) for each bin of a span.
    costs : ndarray of float32, shape (vector, band, ratio, lane)
        Costs of the background; see `SearchTables`.
    places : ndarray of int32, shape (lag + 1,)
        First run of each lag.
    runs : ndarray of int16, shape (run, 3)
        Zone of a band: band, first bin, one past the last.
    widths, shares : ndarray of float32, shape (lag, band)
        Share of the background and of the band in its zone.
    """

    spans: NDArray[np.int32]
    gains: NDArray[np.float32]
    costs: NDArray[np.float32]
    places: NDArray[np.int32]
    runs: NDArray[np.int16]
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


def _level(level: DelayTables, lanes: int, *, skip_dark: bool) -> PackedDelays:
    phases, bands, bins = level.shares.shape
    blocks = -(-bins // lanes)
    room = blocks * lanes - bins
    widths = np.pad(level.widths, (0, room))

    def blocked(table: NDArray[np.float32]) -> NDArray[np.float32]:
        padded = np.pad(table, ((0, 0), (0, 0), (0, room)))
        return padded.reshape(phases, bands, blocks, lanes)

    shares, slopes = blocked(level.shares), blocked(level.slopes)
    lit = np.asarray(shares.any(axis=-1) | slopes.any(axis=-1))  # phase, band, block
    lit |= not skip_dark
    runs, counts = _runs(lit)  # phase, band, first block
    place = np.concatenate([[0], np.cumsum(2 * counts)])
    row = np.full(lit.shape, -1)  # of each lit block's shares
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    row[lit] = np.repeat(place[:-1], counts) + within
    data = np.empty((place[-1], lanes), np.float32)
    data[row[lit]] = shares[lit]
    data[row[lit] + np.repeat(counts, counts)] = slopes[lit]

    together = np.einsum("pib,pjb->ij", lit, lit, dtype=np.int64) > 0
    pairs = np.argwhere(np.tril(together, -1))
    both = lit[:, pairs[:, 0]] & lit[:, pairs[:, 1]]
    met, lengths = _runs(both)  # phase, pair, first block
    phase, pair, block = met.T
    one, other = (row[phase, pairs[pair, side], block] for side in (0, 1))
    return PackedDelays(
        blocks=blocks,
        widths=widths,
        places=np.searchsorted(runs[:, 0], np.arange(phases + 1)).astype(np.int32),
        runs=_table(*runs.T[1:], counts, place[:-1]),
        data=data,
        pairs=np.ascontiguousarray(pairs, np.uint8),
        meets=np.searchsorted(phase, np.arange(phases + 1)).astype(np.int32),
        meetings=_table(pair, block, lengths, one, other),
    )


def _table(*columns: NDArray[np.intp]) -> NDArray[np.int32]:
    return np.ascontiguousarray(np.column_stack(columns), np.int32)


def _runs(lit: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where runs of the last axis begin (run, axis), in order, and how long they are."""
    edges = np.diff(np.pad(lit.astype(np.int8), ((0, 0), (0, 0), (1, 1))))
    first, end = np.argwhere(edges > 0), np.argwhere(edges < 0)
    return first, end[:, -1] - first[:, -1]


def _search_tables(search: SearchTables, lanes: int) -> PackedSearch:
    ratios, bands, bins, lags = search.gains.shape
    blocks = -(-lags // lanes)
    room = blocks * lanes - lags
    gains = np.pad(search.gains, ((0, 0), (0, 0), (0, 0), (0, room)))
    gains = gains.reshape(ratios, bands, bins, blocks, lanes)
    costs = np.pad(search.costs, ((0, 0), (0, 0), (0, room)))
    costs = costs.reshape(ratios, bands, blocks, lanes).transpose(2, 1, 0, 3)
    spans = np.zeros((blocks, bands, 3), np.int32)
    pieces, place = [], 0
    for block in range(blocks):
        for band in range(bands):
            part = gains[:, band, :, block, :]  # ratio, bin, lane
            seen = np.flatnonzero(part.any(axis=(0, 2)))
            first, last = (int(seen[0]), int(seen[-1]) + 1) if seen.size else (0, 0)
            spans[block, band] = first, last, place
            piece = part[:, first:last].transpose(1, 0, 2)
            pieces.append(piece.ravel())
            place += piece.size
    places, runs = [0], []
    for lag in range(lags):
        for band in range(bands):
            zone = np.flatnonzero(np.diff(np.pad(search.zones[band, :, lag], 1)))
            runs += [(band, first, last) for first, last in zone.reshape(-1, 2)]
        places.append(len(runs))
    return PackedSearch(
        spans=spans,
        gains=np.concatenate([*pieces, np.zeros(1, np.float32)]),
        costs=np.ascontiguousarray(costs),
        places=np.array(places, np.int32),
        runs=np.array(runs, np.int16).reshape(-1, 3),
        widths=np.ascontiguousarray(search.zone_widths.T),
        shares=np.ascontiguousarray(search.zone_shares.T),
    )
