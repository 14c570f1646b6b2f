# SPDX-License-Identifier: Apache-2.0
"""Tables of the search over whole lags of the wide bins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.tiles import TILE_BINS, Waveforms, count_tiles, make_tiles, summed

RATIOS = (3.0, 15.0, 75.0)  #: peak of a band over background that the search tries
SHAPE_FLOOR = 1e-3  #: a bin counts for a band down to this part of the band's peak
BYTES_PER_COMPARED_TILE = 1500  #: that the entries of a tile take while they are compared, measured
ZONE_FLOOR = 0.02  #: a band's zone ends where its share falls to this part of the highest


@dataclass(frozen=True, eq=False)
class SearchTables:
    """Tables of the search over whole lags.

    Every bin belongs to the one band that is brightest in it. A band whose peak stands ρ times
    above the background b changes the log-likelihood of counts h by Σ_j h_j·log(1 + ρ·x_j) −
    ρ·b·Σ_j x_j w_j, where x is its shape relative to its peak. *Entries* are the bins where x is
    not 0, sorted by lag, band and bin.

    Attributes
    ----------
    starts : ndarray of int, shape (bin,)
        First fine bin of each bin.
    widths : ndarray of float32, shape (bin,)
        Share of the background.
    lags_ns : ndarray of float, shape (lag,)
        Delays that are searched.
    lag, band, bin : ndarray of int, shape (entry,)
        Where each entry stands.
    shape : ndarray of float, shape (entry,)
        Values of x.
    costs : ndarray of float32, shape (ratio, band, lag)
        Values of ρ·Σ x w.
    zone_widths, zone_shares : ndarray of float32, shape (band, lag)
        Share of the background and of the band in the band's zone.
    separation : int
        Lags between which two maxima are two delays, not one.
    """

    starts: NDArray[np.intp]
    widths: NDArray[np.float32]
    lags_ns: NDArray[np.float64]
    lag: NDArray[np.int64]
    band: NDArray[np.int64]
    bin: NDArray[np.int64]
    shape: NDArray[np.float64]
    costs: NDArray[np.float32]
    zone_widths: NDArray[np.float32]
    zone_shares: NDArray[np.float32]
    separation: int

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.costs.shape[1]

    @property
    def in_zone(self) -> NDArray[np.bool_]:
        """Whether each entry is in its band's zone, shape (entry,)."""
        return self.shape > ZONE_FLOOR

    def gains(self) -> NDArray[np.float32]:
        """Return log(1 + ρ·x) of each entry.

        Returns
        -------
        ndarray of float32, shape (ratio, entry)
            The values.
        """
        return np.log1p(np.array(RATIOS)[:, None] * self.shape).astype(np.float32)

    def gained(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return Σ_j h_j·log(1 + ρ·x_j) of counts at every lag.

        Parameters
        ----------
        counts : ndarray of float, shape (pixel, bin)
            Counts in the bins of the search.

        Returns
        -------
        ndarray of float, shape (ratio, band, pixel, lag)
            The sums.
        """
        from scipy import sparse  # slow to import, and the compiled kernel does not need it

        lags = self.lags_ns.size
        size = (lags * self.bands, self.widths.size)
        rows = self.lag * self.bands + self.band
        sums = [
            sparse.csr_matrix((gains.astype(np.float64), (rows, self.bin)), shape=size) @ counts.T
            for gains in self.gains()
        ]
        shape = (len(RATIOS), lags, self.bands, len(counts))
        return np.reshape(sums, shape).transpose(0, 2, 3, 1)

    def zones(self, lag: int) -> NDArray[np.float64]:
        """Return which bins count for each band at one lag.

        Parameters
        ----------
        lag : int
            Number of the lag.

        Returns
        -------
        ndarray of float, shape (band, bin)
            1 where a bin counts for a band, else 0.
        """
        here = slice(*np.searchsorted(self.lag, [lag, lag + 1]))
        chosen = self.in_zone[here]
        zones = np.zeros((self.bands, self.widths.size))
        zones[self.band[here][chosen], self.bin[here][chosen]] = 1.0
        return zones

    def summed(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return counts in the bins of the search.

        Parameters
        ----------
        counts : ndarray of float, shape (pixel, fine bin)
            Counts in the fine bins.

        Returns
        -------
        ndarray of float, shape (pixel, bin)
            Their sums.
        """
        return summed(counts, self.starts)


def make_search_tables(
    sources: Sequence[Waveforms],
    starts: NDArray[np.intp],
    widths: NDArray[np.float64],
    range_ns: tuple[float, float],
    step_ns: float,
    shortest_fwhm_ns: float,
    white: NDArray[np.float64],
) -> SearchTables:
    """Compute the tables of the search.

    Parameters
    ----------
    sources : sequence of Waveforms
        Schedules at the wide bins, which stand side by side.
    starts : ndarray of int, shape (bin,)
        First fine bin of each bin.
    widths : ndarray of float, shape (bin,)
        Share of the background.
    range_ns : tuple of float
        Least and greatest delay.
    step_ns : float
        Step between lags, ns.
    shortest_fwhm_ns : float
        Width of the shortest pulse at half its maximum, ns.
    white : ndarray of float, shape (band,)
        Photons of a white target, as shares of their sum.

    Returns
    -------
    SearchTables
        The tables.
    """
    first, last = lag_range(range_ns, step_ns)
    lags, bands = last + 1 - first, white.size
    lag, band, bin_, share = _entries(sources, first, lags, step_ns)
    own = _brightest(lag * widths.size + bin_, share * white[band])
    lag, band, bin_, share = lag[own], band[own], bin_[own], share[own]
    density = share / widths[bin_]
    peak = np.zeros(bands)
    np.maximum.at(peak, band, density)
    shape = density / np.maximum(peak, 1e-300)[band]
    kept = shape >= SHAPE_FLOOR
    lag, band, bin_, share, shape = lag[kept], band[kept], bin_[kept], share[kept], shape[kept]

    def total(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(band, lag) sums of entries."""
        sums = np.bincount(band * lags + lag, values, bands * lags)
        return np.asarray(sums, np.float64).reshape(bands, lags)

    zone = shape > ZONE_FLOOR
    return SearchTables(
        starts=starts,
        widths=widths.astype(np.float32),
        lags_ns=np.arange(first, last + 1) * np.float64(step_ns),
        lag=lag,
        band=band,
        bin=bin_,
        shape=shape,
        costs=(np.array(RATIOS)[:, None, None] * total(shape * widths[bin_])).astype(np.float32),
        zone_widths=total(zone * widths[bin_]).astype(np.float32),
        zone_shares=total(zone * share).astype(np.float32),
        separation=max(2, round(shortest_fwhm_ns / step_ns)),
    )


def search_bytes(
    sources: Sequence[Waveforms], range_ns: tuple[float, float], step_ns: float
) -> int:
    """Estimate the memory that `make_search_tables` takes, without making them.

    Parameters
    ----------
    sources : sequence of Waveforms
        Schedules at the wide bins, which stand side by side.
    range_ns : tuple of float
        Least and greatest delay.
    step_ns : float
        Step between lags, ns.

    Returns
    -------
    int
        Bytes.
    """
    first, last = lag_range(range_ns, step_ns)
    lags_ns = np.arange(first, last + 1, dtype=np.float64) * step_ns
    return BYTES_PER_COMPARED_TILE * count_tiles(sources, lags_ns)


def lag_range(range_ns: tuple[float, float], step_ns: float) -> tuple[int, int]:
    """Return the first and the last lag of a range, in steps.

    Parameters
    ----------
    range_ns : tuple of float
        Least and greatest delay, ns.
    step_ns : float
        Step between lags, ns.

    Returns
    -------
    tuple of int
        First and last lag.
    """
    return ceil(range_ns[0] / step_ns - 0.5), floor(range_ns[1] / step_ns + 0.5)


def _entries(
    sources: Sequence[Waveforms], first: int, lags: int, step_ns: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Lag, band, bin and share wherever there is light, sorted in this order."""
    tiles = make_tiles(sources, first, lags, step_ns, crop=0.0, with_slopes=False, dtype=np.float64)
    lag = np.repeat(np.arange(lags), np.diff(tiles.places))
    share = np.asarray(tiles.shares[tiles.row], np.float64)
    tile, place = np.nonzero(share > 0)
    bin_ = tiles.block[tile].astype(np.int64) * TILE_BINS + place
    return lag[tile], tiles.band[tile].astype(np.int64), bin_, share[tile, place]


def _brightest(key: NDArray[np.int64], value: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each entry has the highest value of those with its key, the first of equal ones."""
    if not key.size:
        return np.zeros(0, bool)
    order = np.lexsort((np.arange(key.size), -value, key))
    ordered = key[order]
    own = np.zeros(key.size, bool)
    own[order[np.concatenate([[True], ordered[1:] != ordered[:-1]])]] = True
    return own
