# SPDX-License-Identifier: Apache-2.0
"""Tables of the model over the delay, computed once per calibration.

The fit compares counts with μ_i(τ) = Σ_k A_k T_ki(τ) + b·w_i, where T_ki is the share of band k's
photons in bin i at delay τ, and w_i that of the background. Tables hold T and its derivative on a
fine grid of delays, exact on the circle of the period, for unequal bins and for trains of any
order, and only for the bins that a pulse lights; see `tiles`. Schedules that alternate frame by
frame are *views* of the same pixel: their bins stand side by side, and their delay and amplitudes
are common.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.search_tables import SearchTables, make_search_tables, search_bytes
from hueflight.fit.tiles import (
    TILE_BINS,
    DenseRows,
    Tiles,
    Waveforms,
    equal_bin_ns,
    make_tiles,
    summed,
    tiles_bytes,
)
from hueflight.memory import require_memory
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.model.time_bins import TimeBins
from hueflight.model.undersampling import is_resolved
from hueflight.model.waveforms import Templates

PHASES_PER_FWHM = 50  #: delays in a table; the fit is linear between them
FINE_BINS_PER_FWHM = 24  #: bins that are narrower are summed: pulses don't need them
WIDE_BINS_PER_FWHM = 2.75  #: bins of the first search
BACKGROUND_SHARES = (0.05, 0.2, 0.5)  #: share of background among all counts that it tries
CROP = 1e-7  #: a share below this part of a band's highest is taken for 0
SHARED_FROM = 8.0  #: blocks of bins that delays span from which equal bins share their values
FALSE_ALARM_RATE = 1e-3  #: probability that background alone passes for a surface
DETECTION_THRESHOLD = 28.0  #: of twice the log-likelihood ratio, for that rate and the range below
DETECTION_RANGE_NS = 28.0  #: searched range that the threshold was measured for


@dataclass(frozen=True, eq=False)
class ScheduleView:
    """Bins and waveforms of one schedule.

    Attributes
    ----------
    bins : TimeBins
        Its bins.
    templates : Templates
        Its waveforms.
    weight : float
        Its share of a pixel's exposures, on any scale.
    background : BackgroundShape
        How the background is distributed over the bins.
    """

    bins: TimeBins
    templates: Templates
    weight: float = 1.0
    background: BackgroundShape = FLAT


@dataclass(frozen=True, eq=False)
class DelayTables:
    """Tables at one bin width.

    Attributes
    ----------
    starts : ndarray of int, shape (bin,)
        First of the next finer bins that each bin sums: those of the sensor for the fine tables,
        the fine bins for all others.
    widths : ndarray of float32, shape (bin,)
        Share of the background.
    first_ns, phase_ns : float
        First tabulated delay, and the step between them.
    tiles : Tiles
        Shares of the bands' photons, and their derivatives by the delay.
    """

    starts: NDArray[np.intp]
    widths: NDArray[np.float32]
    first_ns: float
    phase_ns: float
    tiles: Tiles

    @property
    def shares(self) -> DenseRows:
        """Share of a band's photons (phase, band, bin), made for one phase at a time."""
        return DenseRows(self.tiles, self.tiles.shares)

    @property
    def slopes(self) -> DenseRows:
        """Derivative of `shares` by the delay, per ns, made for one phase at a time."""
        return DenseRows(self.tiles, self.tiles.slopes)

    def summed(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return counts in the bins of these tables.

        Parameters
        ----------
        counts : ndarray of float, shape (pixel, finer bin)
            Counts in the next finer bins.

        Returns
        -------
        ndarray of float, shape (pixel, bin)
            Their sums.
        """
        return summed(counts, self.starts)

    def phase_of(self, delay_ns: NDArray[np.floating]) -> NDArray[np.intp]:
        """Return the nearest tabulated delay of each delay.

        Parameters
        ----------
        delay_ns : ndarray of float
            Delays.

        Returns
        -------
        ndarray of int
            Numbers of tabulated delays.
        """
        nearest = np.rint((delay_ns - self.first_ns) / self.phase_ns)
        return np.clip(nearest, 0, len(self.shares) - 1).astype(np.intp)


@dataclass(frozen=True, eq=False)
class ModelTables:
    """All tables of the joint fit.

    Attributes
    ----------
    search : SearchTables
        Tables of the search.
    wide, fine : DelayTables
        Tables at the bin width of the search and at that of the result.
    fine_factor, wide_factor : int
        Sensor's bins in a fine bin, and fine bins in a wide one.
    search_ns : tuple of float
        Least and greatest delay against the reference.
    spread_ns : float
        Standard deviation of the delay of a white target that one photon tells.
    views : tuple of ScheduleView
        Schedules that the tables are for.
    resolved : bool
        Whether the bins resolve the shortest pulse.
    contrasts : ndarray of float, shape (contrast, band)
        Along which delays are tested for differences; see `assessment.wavelength_contrasts`.
    """

    search: SearchTables
    wide: DelayTables
    fine: DelayTables
    fine_factor: int
    wide_factor: int
    search_ns: tuple[float, float]
    spread_ns: float
    views: tuple[ScheduleView, ...]
    resolved: bool
    contrasts: NDArray[np.float64]

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.fine.tiles.bands

    def wide_counts(self, light: NDArray[Any]) -> NDArray[np.float64]:
        """Return counts in the bins of the search.

        Parameters
        ----------
        light : ndarray, shape (pixel, bin)
            Counts in the sensor's bins, in time order.

        Returns
        -------
        ndarray of float, shape (pixel, wide bin)
            Their sums.
        """
        return self.search.summed(self.fine.summed(np.asarray(light, np.float64)))


def detection_threshold(
    search_ns: tuple[float, float], *, false_alarm_rate: float = FALSE_ALARM_RATE
) -> float:
    """Return the least detection ratio that counts as a surface; see `detection`.

    Parameters
    ----------
    search_ns : tuple of float
        Least and greatest delay that was searched, ns.
    false_alarm_rate : float, optional
        Probability that a pixel with background alone exceeds it.

    Returns
    -------
    float
        The threshold: wider searches try more delays.
    """
    tries = max(search_ns[1] - search_ns[0], 1.0) / DETECTION_RANGE_NS
    return DETECTION_THRESHOLD + 2 * log(tries) + 2 * log(FALSE_ALARM_RATE / false_alarm_rate)


def make_tables(
    views: Sequence[ScheduleView],
    *,
    shortest_fwhm_ns: float,
    brightness: NDArray[np.floating],
    search_ns: tuple[float, float],
    offsets_ns: tuple[float, float] = (0.0, 0.0),
    contrasts: NDArray[np.float64] | None = None,
) -> ModelTables:
    """Compute the tables for one schedule, or for several that alternate.

    Parameters
    ----------
    views : sequence of ScheduleView
        Schedules; each pixel's counts hold their bins in this order.
    shortest_fwhm_ns : float
        Width of the shortest pulse at half its maximum.
    brightness : ndarray of float, shape (band,)
        Photons of a white target, on any scale.
    search_ns : tuple of float
        Least and greatest delay against the reference.
    offsets_ns : tuple of float
        Least and greatest delay that belongs to a pixel itself.
    contrasts : ndarray of float, shape (contrast, band), optional
        At most two contrasts along which delays are tested for differences; by default none.

    Returns
    -------
    ModelTables
        The tables.

    Raises
    ------
    MemoryLimitError
        If they would take more memory than `memory.limit_bytes`.
    """
    bin_ns = max(view.bins.span_ns / view.bins.count for view in views)
    fine = max(1, floor(shortest_fwhm_ns / FINE_BINS_PER_FWHM / bin_ns))
    wide = max(1, floor(shortest_fwhm_ns / WIDE_BINS_PER_FWHM / (bin_ns * fine)))
    delays_ns = search_ns[0] + offsets_ns[0], search_ns[1] + offsets_ns[1]
    fine_starts, fine_edges = _grouped([view.bins.edges_ns for view in views], fine)
    sources = _sources(views, fine_edges)
    phase_ns, turn = _phases(sources, delays_ns, shortest_fwhm_ns / PHASES_PER_FWHM)
    wide_starts, wide_edges = _grouped(fine_edges, wide)
    wide_sources = _sources(views, wide_edges)
    step_ns = wide * fine * bin_ns
    _require_memory(sources, wide_sources, delays_ns, phase_ns, turn, step_ns)
    fine_level = _level(sources, fine_starts, delays_ns, phase_ns, turn)
    white = np.asarray(brightness, np.float64) / np.sum(brightness)
    wide_level = fine_level
    if wide > 1:
        wide_level = _level(wide_sources, wide_starts, delays_ns, phase_ns, turn * wide)
    return ModelTables(
        search=make_search_tables(
            wide_sources,
            wide_starts,
            _widths(wide_sources),
            delays_ns,
            step_ns,
            shortest_fwhm_ns,
            white,
        ),
        wide=wide_level,
        fine=fine_level,
        fine_factor=fine,
        wide_factor=wide,
        search_ns=search_ns,
        spread_ns=_spread(fine_level, white),
        views=tuple(views),
        resolved=all(is_resolved(shortest_fwhm_ns, view.bins) for view in views),
        contrasts=np.empty((0, white.size)) if contrasts is None else contrasts,
    )


def _grouped(edges: list[NDArray], factor: int) -> tuple[NDArray[np.intp], list[NDArray]]:
    """First bin of every group of bins, and each view's edges of groups."""
    starts, grouped, before = [], [], 0
    for edge in edges:
        first = np.arange(0, edge.size - 1, factor)
        starts.append(first + before)
        grouped.append(np.append(edge[first], edge[-1]))
        before += edge.size - 1
    return np.concatenate(starts), grouped


def _sources(views: Sequence[ScheduleView], edges: list[NDArray]) -> list[Waveforms]:
    whole = sum(view.weight for view in views)
    return [
        Waveforms(edge, view.templates, view.weight / whole, view.background)
        for view, edge in zip(views, edges, strict=True)
    ]


def _widths(sources: Sequence[Waveforms]) -> NDArray[np.float64]:
    """Share of the background in every bin."""
    return np.concatenate(
        [source.weight * source.background.shares(source.edges_ns) for source in sources]
    )


def _numbers(range_ns: tuple[float, float], phase_ns: float) -> tuple[int, int]:
    """First tabulated delay, in steps, and how many there are."""
    first, last = floor(range_ns[0] / phase_ns) - 1, ceil(range_ns[1] / phase_ns) + 1
    return first, last + 1 - first


def _phases(
    sources: Sequence[Waveforms], range_ns: tuple[float, float], phase_ns: float
) -> tuple[float, int]:
    """Step between delays, and the steps after which values are shared (0: never).

    Where delays span many blocks of bins, their step is the nearest shorter one that divides a
    block.
    """
    width_ns = equal_bin_ns(sources)
    if width_ns is None or range_ns[1] - range_ns[0] < SHARED_FROM * TILE_BINS * width_ns:
        return phase_ns, 0
    turn = ceil(TILE_BINS * width_ns / phase_ns)
    return TILE_BINS * width_ns / turn, turn


def _require_memory(
    sources: Sequence[Waveforms],
    wide_sources: Sequence[Waveforms],
    range_ns: tuple[float, float],
    phase_ns: float,
    turn: int,
    step_ns: float,
) -> None:
    numbers = _numbers(range_ns, phase_ns)
    needed = search_bytes(wide_sources, range_ns, step_ns)
    needed += tiles_bytes(sources, *numbers, phase_ns, turn=turn)
    if wide_sources[0].edges_ns.size < sources[0].edges_ns.size:
        wide = round((sources[0].edges_ns.size - 1) / (wide_sources[0].edges_ns.size - 1))
        needed += tiles_bytes(wide_sources, *numbers, phase_ns, turn=turn * wide)
    require_memory(
        needed,
        f"the tables of {numbers[1]} delays, {sources[0].templates.bands} bands and "
        f"{sum(source.edges_ns.size - 1 for source in sources)} bins",
        advice="Give a narrower depth_range, which needs fewer delays, or sum neighboring codes to "
        "wider bins",
    )


def _level(
    sources: Sequence[Waveforms],
    starts: NDArray[np.intp],
    range_ns: tuple[float, float],
    phase_ns: float,
    turn: int,
) -> DelayTables:
    first, count = _numbers(range_ns, phase_ns)
    return DelayTables(
        starts=starts,
        widths=_widths(sources).astype(np.float32),
        first_ns=float(first * np.float64(phase_ns)),
        phase_ns=phase_ns,
        tiles=make_tiles(sources, first, count, phase_ns, crop=CROP, turn=turn),
    )


def _spread(level: DelayTables, white: NDArray[np.float64]) -> float:
    """Root of the inverse information of one background-free photon about the delay, ns."""
    middle = len(level.shares) // 2
    mean = white @ level.shares[middle]
    slope = white @ level.slopes[middle]
    lit = mean > 1e-6 * mean.max()
    return float(1 / np.sqrt(np.sum(slope[lit] ** 2 / mean[lit]) / mean.sum()))


def by_phase(phase: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Group pixels by the delay of their tables.

    Parameters
    ----------
    phase : ndarray of int, shape (pixel,)
        Index of each pixel's delay in the tables.

    Yields
    ------
    tuple of int and ndarray of int
        An index, and the pixels that have it.
    """
    order = np.argsort(phase, kind="stable")
    values, first = np.unique(phase[order], return_index=True)
    parts = np.split(order, first[1:]) if phase.size else []
    for value, chosen in zip(values, parts, strict=True):
        yield int(value), chosen
