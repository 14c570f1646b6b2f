# SPDX-License-Identifier: Apache-2.0
"""Sparse tables of the model over the delay: only the bins that a pulse lights are stored.

A pulse lights few of a sensor's bins, at any delay. Tables therefore hold *tiles* of successive
bins: the light of one band, at one delay, in one block of bins. Where bins are equal, a delay that
is later by the width of a block moves the light by one block, and both delays share their values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit import BLOCK_BINS
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.model.waveforms import Templates

TILE_BINS = BLOCK_BINS  #: bins of a tile
EQUAL = 1e-6  #: edges that differ by less than this part of a bin are equal
DARK = 1e-6  #: coefficients below this part of a band's highest give no light that is kept
ROWS_AT_ONCE = 1 << 14  #: tiles that are computed together, which bounds the memory it takes
BYTES_PER_ROW = 600  #: that values take while they are computed and cropped, measured
BYTES_PER_TILE = 140  #: that the place of a tile takes while it is sorted, measured


@dataclass(frozen=True, eq=False)
class Waveforms:
    """Waveforms of one schedule over some bins.

    Attributes
    ----------
    edges_ns : ndarray of float, shape (bin + 1,)
        Edges of the bins, ns.
    templates : Templates
        Waveform of each band.
    weight : float
        Share of the exposures; those of all schedules add up to 1.
    background : BackgroundShape
        How the background is distributed over the bins.
    """

    edges_ns: NDArray[np.float64]
    templates: Templates
    weight: float
    background: BackgroundShape = FLAT


@dataclass(frozen=True, eq=False)
class Tiles:
    """Light of each band at each delay, where there is any.

    Attributes
    ----------
    bands, bins : int
        Size of the tables.
    places : ndarray of int, shape (delay + 1,)
        First tile of each delay; the bands and the blocks of a delay rise.
    band : ndarray of uint8, shape (tile,)
        Band of each tile.
    block : ndarray of int32, shape (tile,)
        Its block: it has the bins from ``TILE_BINS * block`` on.
    row : ndarray of int32, shape (tile,)
        Row of its values.
    shares, slopes : ndarray of float32 or float64, shape (row, TILE_BINS)
        Share of the band's photons in each bin, and its derivative by the delay, per ns.
    """

    bands: int
    bins: int
    places: NDArray[np.int64]
    band: NDArray[np.uint8]
    block: NDArray[np.int32]
    row: NDArray[np.int32]
    shares: NDArray[np.floating]
    slopes: NDArray[np.floating]

    @property
    def blocks(self) -> int:
        """Number of blocks that all bins make, the last of which may have fewer."""
        return -(-self.bins // TILE_BINS)

    def dense(self, values: NDArray[np.floating], delay: int) -> NDArray[np.float32]:
        """Return values of all bins at one delay.

        Parameters
        ----------
        values : ndarray of float, shape (row, TILE_BINS)
            `shares` or `slopes`.
        delay : int
            Number of the delay.

        Returns
        -------
        ndarray of float32, shape (band, bin)
            The values; 0 where there is no tile.
        """
        here = slice(self.places[delay], self.places[delay + 1])
        whole = np.zeros((self.bands, self.blocks, TILE_BINS), np.float32)
        whole[self.band[here], self.block[here]] = values[self.row[here]]
        return whole.reshape(self.bands, -1)[:, : self.bins]


@dataclass(frozen=True, eq=False)
class DenseRows:
    """Values of tiles as an array (delay, band, bin), each delay of which is made when asked for.

    Attributes
    ----------
    tiles : Tiles
        The tiles.
    values : ndarray of float, shape (row, TILE_BINS)
        Their shares or slopes.
    """

    tiles: Tiles
    values: NDArray[np.floating]

    def __len__(self) -> int:
        """Return the number of delays."""
        return self.tiles.places.size - 1

    def __getitem__(self, delay: int) -> NDArray[np.float32]:
        """Return the values (band, bin) at a delay."""
        return self.tiles.dense(self.values, int(delay))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of delays, bands and bins."""
        return len(self), self.tiles.bands, self.tiles.bins


def summed(counts: NDArray[np.float64], starts: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return sums of counts between successive starts.

    Parameters
    ----------
    counts : ndarray of float, shape (pixel, bin)
        Counts.
    starts : ndarray of int, shape (group,)
        First bin of each group.

    Returns
    -------
    ndarray of float, shape (pixel, group)
        Sums.
    """
    if starts.size == counts.shape[-1]:
        return counts
    return np.add.reduceat(counts, starts, axis=-1)


def lit_stretches(templates: Templates) -> list[NDArray[np.float64]]:
    """Return where on the circle each band has light.

    Parameters
    ----------
    templates : Templates
        Waveforms.

    Returns
    -------
    list of ndarray, shape (stretch, 2)
        First and last time of each stretch of a band, ns; the last may end beyond the circle.
    """
    knots = templates.coefficients.shape[-1]
    stretches = []
    for coefficients in templates.coefficients:
        lit = coefficients > DARK * coefficients.max()
        if lit.all():
            stretches.append(np.array([[0.0, templates.circle_ns]]))
            continue
        turned = int(np.argmin(lit))  # begin where there is no light, so that none is cut in two
        padded = np.pad(np.roll(lit, -turned), 1)
        first = np.flatnonzero(padded[1:] & ~padded[:-1]) + turned
        end = np.flatnonzero(padded[:-1] & ~padded[1:]) + turned
        # a spline's light reaches two knots to either side; stretches that meet are one
        apart = first[1:] - end[:-1] >= 4
        first = first[np.concatenate([[True], apart])] if first.size else first
        end = end[np.concatenate([apart, [True]])] if end.size else end
        times = np.column_stack([first - 2, end + 1]) * templates.knot_ns
        stretches.append(np.minimum(times, times[:, :1] + knots * templates.knot_ns))
    return stretches


def lit_blocks(
    sources: Sequence[Waveforms], delays_ns: NDArray[np.float64]
) -> list[tuple[int, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Find the blocks of bins that each stretch of light reaches.

    Parameters
    ----------
    sources : sequence of Waveforms
        Schedules, whose bins stand side by side.
    delays_ns : ndarray of float, shape (delay,)
        Delays.

    Returns
    -------
    list of tuple
        For each stretch a band, the numbers of delays, and of each the first and last block.
    """
    found, before = [], 0
    for source in sources:
        edges, circle_ns = source.edges_ns, source.templates.circle_ns
        for band, stretches in enumerate(lit_stretches(source.templates)):
            for begin, end in stretches:
                low = np.floor((edges[0] - end - delays_ns.max()) / circle_ns)
                high = np.ceil((edges[-1] - begin - delays_ns.min()) / circle_ns)
                for turn in np.arange(low, high + 1) * circle_ns:
                    first_ns, last_ns = begin + turn + delays_ns, end + turn + delays_ns
                    seen = np.flatnonzero((last_ns > edges[0]) & (first_ns < edges[-1]))
                    if not seen.size:
                        continue
                    first = np.searchsorted(edges, first_ns[seen], side="right") - 1
                    last = np.searchsorted(edges, last_ns[seen], side="left") - 1
                    first, last = (np.clip(b, 0, edges.size - 2) + before for b in (first, last))
                    found.append((band, seen, first // TILE_BINS, last // TILE_BINS))
        before += edges.size - 1
    return found


def count_tiles(sources: Sequence[Waveforms], delays_ns: NDArray[np.float64]) -> int:
    """Count the tiles of some delays without making them, at most.

    Parameters
    ----------
    sources : sequence of Waveforms
        Schedules, whose bins stand side by side.
    delays_ns : ndarray of float, shape (delay,)
        Delays.

    Returns
    -------
    int
        The number.
    """
    return sum(
        int((last - first + 1).sum()) for _, _, first, last in lit_blocks(sources, delays_ns)
    )


def tiles_bytes(
    sources: Sequence[Waveforms], first: int, delays: int, step_ns: float, *, turn: int = 0
) -> int:
    """Estimate the memory that `make_tiles` takes at most, without making them.

    Parameters
    ----------
    sources : sequence of Waveforms
        Schedules, whose bins stand side by side.
    first, delays : int
        First delay in units of the step, and how many there are.
    step_ns : float
        Step between delays, ns.
    turn : int
        Delays after which values are shared; 0 if they are not.

    Returns
    -------
    int
        Bytes.
    """
    tiles = count_tiles(sources, np.arange(first, first + delays) * np.float64(step_ns))
    # light that comes over an end of the bins at some delays is counted twice
    rows = min(tiles, 2 * tiles * turn // delays) if turn else tiles
    return BYTES_PER_TILE * tiles + BYTES_PER_ROW * rows


def equal_bin_ns(sources: Sequence[Waveforms]) -> float | None:
    """Return the width that nearly all bins have, or None where they differ.

    Parameters
    ----------
    sources : sequence of Waveforms
        Schedules.

    Returns
    -------
    float or None
        The width, ns.
    """
    width_ns = float(np.median(np.diff(sources[0].edges_ns)))
    for source in sources:
        widths = np.diff(source.edges_ns)
        if (np.abs(widths - width_ns) < EQUAL * width_ns).sum() < widths.size - 2:
            return None
    return width_ns


def make_tiles(
    sources: Sequence[Waveforms],
    first: int,
    delays: int,
    step_ns: float,
    *,
    crop: float,
    turn: int = 0,
    with_slopes: bool = True,
    dtype: type[np.floating] = np.float32,
) -> Tiles:
    """Compute the tiles of equally spaced delays.

    Parameters
    ----------
    sources : sequence of Waveforms
        Schedules, whose bins stand side by side.
    first, delays : int
        First delay in units of the step, and how many there are.
    step_ns : float
        Step between delays, ns.
    crop : float
        Shares below this part of a band's highest are taken for 0.
    turn : int
        Delays after which light has moved by one block of equal bins, so that values are shared; 0
        to compute each delay on its own.
    with_slopes : bool
        Compute the slopes too; otherwise they are 0.
    dtype : type
        Type of the values.

    Returns
    -------
    Tiles
        The tiles.
    """
    numbers = np.arange(first, first + delays)
    delays_ns = numbers * np.float64(step_ns)
    bands = sources[0].templates.bands
    bins = sum(source.edges_ns.size - 1 for source in sources)
    blocks = -(-bins // TILE_BINS)
    keys = _tile_keys(lit_blocks(sources, delays_ns), bands, blocks)
    delay, band, block = _split(keys, bands, blocks)
    example, row = _shared_rows(sources, numbers[delay], band, block, turn)
    where = delays_ns[delay[example]], band[example], block[example]
    shares, slopes = _values(sources, *where, with_slopes=with_slopes)

    highest = np.zeros(bands)
    np.maximum.at(highest, band[example], shares.max(axis=-1, initial=0))
    empty = shares < crop * highest[band[example], None]
    shares[empty] = 0.0
    slopes[empty] = 0.0
    lit = np.asarray(shares.any(axis=-1))
    kept = lit[row]
    moved = np.cumsum(lit) - 1
    return Tiles(
        bands=bands,
        bins=bins,
        places=np.searchsorted(delay[kept], np.arange(delays + 1)),
        band=band[kept].astype(np.uint8),
        block=block[kept].astype(np.int32),
        row=moved[row[kept]].astype(np.int32),
        shares=shares[lit].astype(dtype),
        slopes=slopes[lit].astype(dtype),
    )


def _tile_keys(
    found: list[tuple[int, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]],
    bands: int,
    blocks: int,
) -> NDArray[np.int64]:
    """Delay, band and block of every tile in one number, rising."""
    keys = [np.empty(0, np.int64)]
    for band, delay, first, last in found:
        count = last - first + 1
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        keys.append(np.repeat((delay * bands + band) * blocks + first, count) + within)
    rising = np.concatenate(keys)
    apart = np.diff(rising) > 0
    if not apart.all():  # stretches meet in a block, or another one comes first
        rising.sort()
        apart = np.diff(rising) > 0
    return rising[np.concatenate([np.ones(min(rising.size, 1), bool), apart])]


def _split(
    keys: NDArray[np.int64], bands: int, blocks: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    rest, block = np.divmod(keys, blocks)
    delay, band = np.divmod(rest, bands)
    return delay, band, block


def _shared_rows(
    sources: Sequence[Waveforms],
    number: NDArray[np.int64],
    band: NDArray[np.int64],
    block: NDArray[np.int64],
    turn: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """A tile that has the values of each row, and the row of each tile."""
    if not turn:
        own = np.arange(number.size)
        return own, own
    width_ns = equal_bin_ns(sources)
    grids = [_equal_blocks(source, place, width_ns) for place, source in _placed(sources)]
    blocks = -(-sum(source.edges_ns.size - 1 for source in sources) // TILE_BINS)
    grid = np.full(blocks, -1)  # in which blocks all bins are equal, and in whose grid they are
    for index, (first, last) in enumerate(grids):
        grid[first:last] = index
    shared = grid[block] >= 0
    turns, phase = np.divmod(number, turn)
    columns = np.column_stack(
        [
            np.where(shared, grid[block], len(grids)),
            np.where(shared, phase, number),
            band,
            np.where(shared, block - turns, block),
        ]
    )
    columns -= columns.min(axis=0, initial=0)
    key = np.ravel_multi_index(tuple(columns.T), tuple(columns.max(axis=0, initial=0) + 1))
    _, example, row = np.unique(key, return_index=True, return_inverse=True)
    return example, row


def _placed(sources: Sequence[Waveforms]) -> list[tuple[int, Waveforms]]:
    """Each schedule with its first bin."""
    sizes = [source.edges_ns.size - 1 for source in sources]
    return list(zip(np.cumsum([0, *sizes[:-1]]).tolist(), sources, strict=True))


def _equal_blocks(source: Waveforms, place: int, width_ns: float | None) -> tuple[int, int]:
    """First and one past the last block whose bins are all of one schedule and equal."""
    widths = np.diff(source.edges_ns)
    if width_ns is None:
        return 0, 0
    odd = np.flatnonzero(np.abs(widths - width_ns) >= EQUAL * width_ns)
    first, last = 0, widths.size
    for index in odd.tolist():  # the first or the last bin may be narrower
        first, last = (index + 1, last) if index < widths.size // 2 else (first, index)
    return -(-(first + place) // TILE_BINS), (last + place) // TILE_BINS


def _values(
    sources: Sequence[Waveforms],
    delays_ns: NDArray[np.float64],
    band: NDArray[np.int64],
    block: NDArray[np.int64],
    *,
    with_slopes: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares and slopes (row, bin) of tiles."""
    shares, slopes = np.zeros((2, band.size, TILE_BINS))
    for place, source in _placed(sources):
        edges = source.edges_ns
        last = (place + edges.size - 2) // TILE_BINS
        mine = (block >= place // TILE_BINS) & (block <= last)
        for k in range(source.templates.bands):
            own = Templates(source.templates.coefficients[k : k + 1], source.templates.circle_ns)
            rows = np.flatnonzero(mine & (band == k))
            for start in range(0, rows.size, ROWS_AT_ONCE):
                some = rows[start : start + ROWS_AT_ONCE]
                # bins of another schedule, or beyond the last one, have no width here
                edge = block[some, None] * TILE_BINS + np.arange(TILE_BINS + 1) - place
                times_ns = edges[np.clip(edge, 0, edges.size - 1)]
                later_ns = delays_ns[some, None]
                shares[some] += own.shares(times_ns, later_ns)[0] * source.weight
                if with_slopes:
                    slopes[some] += own.slopes(times_ns, later_ns)[0] * source.weight
    return shares, slopes
