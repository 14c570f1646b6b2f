"""Tables of the model over the delay, computed once per calibration.

The fit compares counts with μ_i(τ) = Σ_k A_k T_ki(τ) + b·w_i, where T_ki is the share of band k's
photons in bin i at delay τ, and w_i that of the background. Tables hold T and its derivative on a
fine grid of delays, exact on the circle of the period, for unequal bins and for trains of any
order. Schedules that alternate frame by frame are *views* of the same pixel: their bins stand side
by side, and their delay and amplitudes are common.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, log

import numpy as np
from numpy.typing import NDArray

from hueflight.model.time_bins import TimeBins
from hueflight.model.undersampling import is_resolved
from hueflight.model.waveforms import Templates

PHASES_PER_FWHM = 50  #: delays in a table; the fit is linear between them
FINE_BINS_PER_FWHM = 24  #: bins that are narrower are summed: pulses don't need them
WIDE_BINS_PER_FWHM = 2.75  #: bins of the first search
RATIOS = (3.0, 15.0, 75.0)  #: peak of a band over background that the first search tries
BACKGROUND_SHARES = (0.05, 0.2, 0.5)  #: share of background among all counts that it tries
CROP = 1e-7  #: a share below this part of a band's highest is taken for 0
ZONE_FLOOR = 0.02  #: a band's zone ends where its share falls to this part of the highest
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
    """

    bins: TimeBins
    templates: Templates
    weight: float = 1.0


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
    shares : ndarray of float32, shape (phase, band, bin)
        Share of a band's photons.
    slopes : ndarray of float32, shape (phase, band, bin)
        Derivative of `shares` by the delay, per ns.
    """

    starts: NDArray[np.intp]
    widths: NDArray[np.float32]
    first_ns: float
    phase_ns: float
    shares: NDArray[np.float32]
    slopes: NDArray[np.float32]

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
class SearchTables:
    """Tables of the search over whole lags.

    Every bin belongs to the one band that is brightest in it. A band whose peak stands ρ times
    above the background b changes the log-likelihood of counts h by Σ_j h_j·log(1 + ρ·x_j) −
    ρ·b·Σ_j x_j w_j, where x is its shape relative to its peak.

    Attributes
    ----------
    starts : ndarray of int, shape (bin,)
        First fine bin of each bin.
    widths : ndarray of float32, shape (bin,)
        Share of the background.
    lags_ns : ndarray of float, shape (lag,)
        Delays that are searched.
    gains : ndarray of float32, shape (ratio, band, bin, lag)
        Values of log(1 + ρ·x).
    costs : ndarray of float32, shape (ratio, band, lag)
        Values of ρ·Σ x w.
    zones : ndarray of float32, shape (band, bin, lag)
        1 where a bin counts for a band, else 0.
    zone_widths, zone_shares : ndarray of float32, shape (band, lag)
        Share of the background and of the band in the band's zone.
    separation : int
        Lags between which two maxima are two delays, not one.
    """

    starts: NDArray[np.intp]
    widths: NDArray[np.float32]
    lags_ns: NDArray[np.float64]
    gains: NDArray[np.float32]
    costs: NDArray[np.float32]
    zones: NDArray[np.float32]
    zone_widths: NDArray[np.float32]
    zone_shares: NDArray[np.float32]
    separation: int

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
        return self.fine.shares.shape[1]


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
    """
    bin_ns = max(view.bins.span_ns / view.bins.count for view in views)
    fine = max(1, floor(shortest_fwhm_ns / FINE_BINS_PER_FWHM / bin_ns))
    wide = max(1, floor(shortest_fwhm_ns / WIDE_BINS_PER_FWHM / (bin_ns * fine)))
    phase_ns = shortest_fwhm_ns / PHASES_PER_FWHM
    delays_ns = search_ns[0] + offsets_ns[0], search_ns[1] + offsets_ns[1]
    sensor_edges = [view.bins.edges_ns for view in views]
    fine_starts, fine_edges = _grouped(sensor_edges, fine)
    fine_level = _level(views, fine_starts, fine_edges, delays_ns, phase_ns)
    white = np.asarray(brightness, np.float64) / np.sum(brightness)
    step_ns = wide * fine * bin_ns
    wide_bins = _grouped(fine_edges, wide)
    wide_level = fine_level
    if wide > 1:
        wide_level = _level(views, *wide_bins, delays_ns, phase_ns)
    return ModelTables(
        search=_search_tables(views, *wide_bins, delays_ns, step_ns, shortest_fwhm_ns, white),
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


def _grouped(edges: list[NDArray], factor: int) -> tuple[NDArray[np.intp], list[NDArray]]:
    """First bin of every group of bins, and each view's edges of groups."""
    starts, grouped, before = [], [], 0
    for edge in edges:
        first = np.arange(0, edge.size - 1, factor)
        starts.append(first + before)
        grouped.append(np.append(edge[first], edge[-1]))
        before += edge.size - 1
    return np.concatenate(starts), grouped


def _widths(views: Sequence[ScheduleView], edges: list[NDArray]) -> NDArray[np.float64]:
    widths = [
        view.weight * np.diff(edge) / view.bins.span_ns
        for view, edge in zip(views, edges, strict=True)
    ]
    return np.concatenate(widths) / sum(view.weight for view in views)


def _shares(
    views: Sequence[ScheduleView], edges: list[NDArray], delays_ns: NDArray
) -> NDArray[np.float64]:
    """(delay, band, bin) over all views."""
    whole = sum(view.weight for view in views)
    parts = [
        view.templates.shares(edge, delays_ns[:, None]) * (view.weight / whole)
        for view, edge in zip(views, edges, strict=True)
    ]
    return np.concatenate(parts, axis=-1).transpose(1, 0, 2)


def _level(
    views: Sequence[ScheduleView],
    starts: NDArray[np.intp],
    edges: list[NDArray],
    range_ns: tuple[float, float],
    phase_ns: float,
) -> DelayTables:
    first, last = floor(range_ns[0] / phase_ns) - 1, ceil(range_ns[1] / phase_ns) + 1
    delays_ns = np.arange(first, last + 1) * np.float64(phase_ns)
    shares = _shares(views, edges, delays_ns)
    whole = sum(view.weight for view in views)
    slopes = np.concatenate(
        [
            view.templates.slopes(edge, delays_ns[:, None]) * (view.weight / whole)
            for view, edge in zip(views, edges, strict=True)
        ],
        axis=-1,
    ).transpose(1, 0, 2)
    empty = shares < CROP * shares.max(axis=(0, 2), keepdims=True)
    shares[empty] = 0.0
    slopes[empty] = 0.0
    return DelayTables(
        starts=starts,
        widths=_widths(views, edges).astype(np.float32),
        first_ns=float(delays_ns[0]),
        phase_ns=phase_ns,
        shares=np.ascontiguousarray(shares, np.float32),
        slopes=np.ascontiguousarray(slopes, np.float32),
    )


def _search_tables(
    views: Sequence[ScheduleView],
    starts: NDArray[np.intp],
    edges: list[NDArray],
    range_ns: tuple[float, float],
    step_ns: float,
    shortest_fwhm_ns: float,
    white: NDArray[np.float64],
) -> SearchTables:
    widths = _widths(views, edges)
    first, last = ceil(range_ns[0] / step_ns - 0.5), floor(range_ns[1] / step_ns + 0.5)
    lags_ns = np.arange(first, last + 1) * np.float64(step_ns)
    shares = _shares(views, edges, lags_ns)
    brightest = (shares * white[:, None]).argmax(axis=1)
    own = brightest[:, None, :] == np.arange(len(white))[:, None]
    density = np.where(own, shares, 0.0) / widths
    shape = density / np.maximum(density.max(axis=(0, 2), keepdims=True), 1e-300)
    shape[shape < 1e-3] = 0.0
    zones = own & (shape > ZONE_FLOOR)
    ratios = np.array(RATIOS)[:, None, None, None]
    return SearchTables(
        starts=starts,
        widths=widths.astype(np.float32),
        lags_ns=lags_ns,
        gains=np.log1p(ratios * shape).transpose(0, 2, 3, 1).astype(np.float32),
        costs=(ratios[..., 0] * (shape * widths).sum(axis=-1))
        .transpose(0, 2, 1)
        .astype(np.float32),
        zones=zones.transpose(1, 2, 0).astype(np.float32),
        zone_widths=(zones * widths).sum(axis=-1).T.astype(np.float32),
        zone_shares=(zones * shares).sum(axis=-1).T.astype(np.float32),
        separation=max(2, round(shortest_fwhm_ns / step_ns)),
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
