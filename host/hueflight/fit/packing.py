"""A plan's tables as the compiled kernel reads them: flat arrays, in vectors of bins or of lags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.fit import reference as fit
from hueflight.fit.tables import BACKGROUND_SHARES, Level, ModelTables, SearchTables

MOST_BANDS = 30  #: that the kernel has room for


@dataclass(frozen=True, eq=False)
class PackedLevel:
    """Tables of one bin width, in blocks of as many bins as a vector has lanes.

    Attributes
    ----------
    blocks : of bins.
    widths : (block · lane,).
    places : (phase + 1,) first run of each phase.
    runs : (run, 4) successive blocks that one band lights: band, first block, blocks, place in
        `data`; bands rise.
    data : (place, lane) of each run all shares, then all slopes.
    pairs : (pair, 2) bands that share a block at some delay, the greater first.
    meets : (phase + 1,) first meeting of each phase.
    meetings : (meeting, 5) successive blocks that two bands light: pair, first block, blocks,
        places of their shares.
    """

    blocks: int
    widths: NDArray[np.float32]
    places: NDArray[np.int32]
    runs: NDArray[np.int32]
    data: NDArray[np.float32]
    pairs: NDArray[np.uint8]
    meets: NDArray[np.int32]
    meetings: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class PackedSearch:
    """Tables of the first search; of each vector of lags only the bins that matter.

    Attributes
    ----------
    spans : (vector, band, 3) first bin, one past the last, place in `gains`.
    gains : for each bin of a span (ratio, lane).
    costs : (vector, band, ratio, lane).
    places : (lag + 1,) first run of each lag.
    runs : (run, 3) a band's zone: band, first bin, one past the last.
    widths, shares : (lag, band).
    """

    spans: NDArray[np.int32]
    gains: NDArray[np.float32]
    costs: NDArray[np.float32]
    places: NDArray[np.int32]
    runs: NDArray[np.int16]
    widths: NDArray[np.float32]
    shares: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PackedTables:
    """All that the kernel is given of a plan, but for the rules that may be switched."""

    fine: PackedLevel
    rough: PackedLevel
    coarse: PackedSearch


def pack(plan: ModelTables, lanes: int, *, skip_dark: bool = True) -> PackedTables:
    """Tables of a plan for a kernel with vectors of so many lanes.

    Parameters
    ----------
    skip_dark : a band's blocks of bins in which its pulse is not are left out; the results are
        the same.
    """
    fine = _level(plan.fine, lanes, skip_dark=skip_dark)
    rough = fine if plan.rough is plan.fine else _level(plan.rough, lanes, skip_dark=skip_dark)
    return PackedTables(fine=fine, rough=rough, coarse=_coarse(plan.coarse, lanes))


def rules(
    plan: ModelTables, packed: PackedTables, switches: fit.FitOptions
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Sizes and constants in the order in which the kernel reads them."""
    fine, rough, coarse = plan.fine, plan.rough, plan.coarse
    integers = [
        plan.bands,
        len(plan.views),
        plan.fine_factor,
        sum(view.bins.count for view in plan.views),
        *(fine.widths.size, packed.fine.blocks, len(fine.shares)),
        *(rough.widths.size, packed.rough.blocks, len(rough.shares)),
        *(plan.coarse_factor, coarse.widths.size, coarse.lags_ns.size, coarse.separation),
        *(fit.MOST_STEPS, fit.NODES, fit.LIKELIHOOD_ROUNDS),
        *(switches.starts_rough and rough is not fine, switches.settle, switches.posterior),
        fit.FEW_STEPS,
    ]
    lag_ns = coarse.lags_ns[1] - coarse.lags_ns[0] if coarse.lags_ns.size > 1 else 1.0
    reals = [
        *(fine.first_ns, fine.phase_ns, rough.first_ns, rough.phase_ns),
        *(coarse.lags_ns[0], lag_ns),
        *BACKGROUND_SHARES,
        *np.log(BACKGROUND_SHARES),
        *(fit.SETTLED, fit.FLOOR_PHOTONS, fit.FLOOR_SHARE, fit.RIDGE),
        *(fit.MARGIN, fit.AMBIGUOUS, fit.FEW_PHOTONS, fit.NODE_SPACING),
        *(plan.spread_ns, *plan.search_ns, switches.target_ns, fit.RASTER, fit.DARK_WIDTH),
        *(fit.SETTLED_AMPLITUDE, fit.POSTERIOR_PHOTONS),
    ]
    return np.array(integers, np.int32), np.array(reals, np.float32)


def _level(level: Level, lanes: int, *, skip_dark: bool) -> PackedLevel:
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
    return PackedLevel(
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


def _coarse(coarse: SearchTables, lanes: int) -> PackedSearch:
    ratios, bands, bins, lags = coarse.gains.shape
    blocks = -(-lags // lanes)
    room = blocks * lanes - lags
    gains = np.pad(coarse.gains, ((0, 0), (0, 0), (0, 0), (0, room)))
    gains = gains.reshape(ratios, bands, bins, blocks, lanes)
    costs = np.pad(coarse.costs, ((0, 0), (0, 0), (0, room)))
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
            zone = np.flatnonzero(np.diff(np.pad(coarse.zones[band, :, lag], 1)))
            runs += [(band, first, last) for first, last in zone.reshape(-1, 2)]
        places.append(len(runs))
    return PackedSearch(
        spans=spans,
        gains=np.concatenate([*pieces, np.zeros(1, np.float32)]),
        costs=np.ascontiguousarray(costs),
        places=np.array(places, np.int32),
        runs=np.array(runs, np.int16).reshape(-1, 3),
        widths=np.ascontiguousarray(coarse.zone_widths.T),
        shares=np.ascontiguousarray(coarse.zone_shares.T),
    )
