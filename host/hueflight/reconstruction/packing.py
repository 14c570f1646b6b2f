"""A plan's tables as the compiled kernel reads them: flat arrays, sixteen bins or lags a vector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.reconstruction import fit
from hueflight.reconstruction.plan import BACKGROUND_SHARES, Coarse, Level, Plan

LANES = 16
MOST_BANDS = 30  #: that the kernel has room for


@dataclass(frozen=True, eq=False)
class PackedLevel:
    """Tables of one bin width; of each block of sixteen bins only the bands that light it.

    Attributes
    ----------
    widths : (block · 16,).
    places : (phase · (block + 1),) first entry of each block.
    owners : (entry,) band of each entry, rising within a block.
    data : (entry, 2, 16) shares and slopes.
    """

    widths: NDArray[np.float32]
    places: NDArray[np.int32]
    owners: NDArray[np.uint8]
    data: NDArray[np.float32]

    @property
    def blocks(self) -> int:
        """Blocks of sixteen bins."""
        return self.widths.size // LANES


@dataclass(frozen=True, eq=False)
class PackedCoarse:
    """Tables of the first search; of each block of sixteen lags only the bins that matter.

    Attributes
    ----------
    spans : (lag block, band, 3) first bin, one past the last, place in `gains`.
    gains : for each bin of a span (ratio, 16 lags).
    costs : (lag block, band, ratio, 16).
    owners : (lag, bin) band whose zone it is, or −1.
    widths, shares : (lag, band).
    """

    spans: NDArray[np.int32]
    gains: NDArray[np.float32]
    costs: NDArray[np.float32]
    owners: NDArray[np.int8]
    widths: NDArray[np.float32]
    shares: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PackedPlan:
    """All that the kernel is given of a plan, but for the rules that may be switched."""

    fine: PackedLevel
    half: PackedLevel
    coarse: PackedCoarse


def pack(plan: Plan) -> PackedPlan:
    """Tables of a plan for the kernel."""
    fine = _level(plan.fine)
    half = fine if plan.half is plan.fine else _level(plan.half)
    return PackedPlan(fine=fine, half=half, coarse=_coarse(plan.coarse))


def rules(
    plan: Plan, packed: PackedPlan, switches: fit.Switches
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Sizes and constants in the order in which the kernel reads them."""
    fine, half, coarse = plan.fine, plan.half, plan.coarse
    integers = [
        plan.bands,
        len(plan.views),
        plan.fine_factor,
        sum(view.bins.count for view in plan.views),
        *(fine.widths.size, packed.fine.blocks, len(fine.shares)),
        *(plan.half_factor, half.widths.size, packed.half.blocks, len(half.shares)),
        *(plan.coarse_factor, coarse.widths.size, coarse.lags_ns.size, coarse.separation),
        *(fit.MOST_STEPS, fit.NODES, fit.LIKELIHOOD_ROUNDS),
        *(switches.halves and half is not fine, switches.settle, switches.posterior),
    ]
    lag_ns = coarse.lags_ns[1] - coarse.lags_ns[0] if coarse.lags_ns.size > 1 else 1.0
    reals = [
        *(fine.first_ns, fine.phase_ns, half.first_ns, half.phase_ns),
        *(coarse.lags_ns[0], lag_ns),
        *BACKGROUND_SHARES,
        *np.log(BACKGROUND_SHARES),
        *(fit.SETTLED, fit.FLOOR_PHOTONS, fit.FLOOR_SHARE, fit.RIDGE),
        *(fit.MARGIN, fit.AMBIGUOUS, fit.FEW_PHOTONS, fit.NODE_SPACING),
        *(plan.spread_ns, *plan.search_ns, switches.target_ns, fit.RASTER),
    ]
    return np.array(integers, np.int32), np.array(reals, np.float32)


def _level(level: Level) -> PackedLevel:
    phases, bands, bins = level.shares.shape
    blocks = -(-bins // LANES)
    room = blocks * LANES - bins
    widths = np.pad(level.widths, (0, room))

    def blocked(table: NDArray[np.float32]) -> NDArray[np.float32]:
        padded = np.pad(table, ((0, 0), (0, 0), (0, room)))
        return padded.reshape(phases, bands, blocks, LANES).transpose(0, 2, 1, 3)

    shares, slopes = blocked(level.shares), blocked(level.slopes)
    lit = shares.any(axis=-1) | slopes.any(axis=-1)  # phase, block, band
    counts = lit.sum(axis=-1)
    ends = np.cumsum(counts.ravel()).reshape(phases, blocks)
    places = np.empty((phases, blocks + 1), np.int32)
    places[:, 1:] = ends
    places[:, 0] = ends[:, 0] - counts[:, 0]
    data = np.stack([shares[lit], slopes[lit]], axis=1)
    owners = np.nonzero(lit)[2].astype(np.uint8)
    return PackedLevel(widths, places.ravel(), owners, np.ascontiguousarray(data))


def _coarse(coarse: Coarse) -> PackedCoarse:
    ratios, bands, bins, lags = coarse.gains.shape
    blocks = -(-lags // LANES)
    room = blocks * LANES - lags
    gains = np.pad(coarse.gains, ((0, 0), (0, 0), (0, 0), (0, room)))
    gains = gains.reshape(ratios, bands, bins, blocks, LANES)
    costs = np.pad(coarse.costs, ((0, 0), (0, 0), (0, room)))
    costs = costs.reshape(ratios, bands, blocks, LANES).transpose(2, 1, 0, 3)
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
    owners = np.where(coarse.zones.any(axis=0), coarse.zones.argmax(axis=0), -1)
    return PackedCoarse(
        spans=spans,
        gains=np.concatenate([*pieces, np.zeros(1, np.float32)]),
        costs=np.ascontiguousarray(costs),
        owners=np.ascontiguousarray(owners.T, np.int8),
        widths=np.ascontiguousarray(coarse.zone_widths.T),
        shares=np.ascontiguousarray(coarse.zone_shares.T),
    )
