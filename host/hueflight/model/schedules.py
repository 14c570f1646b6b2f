# SPDX-License-Identifier: Apache-2.0
"""When to fire which LED: the unambiguous range of a schedule, and the search for a better one.

An object whose light returns after one delay can be mistaken for an object at another delay if
the pulses of the bands that it reflects, shifted by the difference, coincide with pulses of other
bands: some spectrum then explains the counts at either delay. A shift is *ambiguous* for objects
of n bands if the pulses of n bands find such partners at it. Evenly spaced pulses all find one at
every multiple of the spacing; in a train whose differences are all distinct, no shift serves more
than one band (the idea of a Golomb ruler). Where two schedules are interleaved, a shift is
ambiguous only if it is so in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import msgspec
import numpy as np
from numpy.typing import NDArray

from hueflight.errors import InstrumentError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument

ROUNDS = 4000  #: of the search for a schedule
RESTARTS = 3
ENOUGH_NS = 10.0  #: a margin between two schedules that is not worth widening


@dataclass(frozen=True)
class Schedule:
    """Delays of the pulses of every band within a period.

    Attributes
    ----------
    delays_ns : tuple of tuple of float
        Firing times of each band within the period, ns.
    period_ns : float
        Period after which the schedule repeats, ns.
    """

    delays_ns: tuple[tuple[float, ...], ...]
    period_ns: float

    def __post_init__(self) -> None:
        if not (isfinite(self.period_ns) and self.period_ns > 0):
            raise InstrumentError(f"period_ns = {self.period_ns!r}: must be finite and above 0")
        for band, delays in enumerate(self.delays_ns):
            if not delays or any(not 0 <= delay < self.period_ns for delay in delays):
                raise InstrumentError(
                    f"band {band} fires at {delays} ns: give at least one delay from 0 to below "
                    f"the period of {self.period_ns} ns"
                )

    @classmethod
    def of(cls, instrument: Instrument) -> Schedule:
        """Take the schedule of an instrument.

        Parameters
        ----------
        instrument : Instrument
            Instrument that has a period.

        Returns
        -------
        Schedule
            Its delays and period.

        Raises
        ------
        InstrumentError
            If the instrument has no period.
        """
        period_ns = instrument.timing.period_ns
        if period_ns is None:
            raise InstrumentError(
                f"instrument {instrument.name!r} has no period: single shots have no schedule"
            )
        return cls(tuple(band.delays_ns for band in instrument.bands), period_ns)

    @classmethod
    def once(cls, delays_ns: Sequence[float], period_ns: float) -> Schedule:
        """Make a schedule in which every band fires once.

        Parameters
        ----------
        delays_ns : sequence of float
            Firing time of each band, ns.
        period_ns : float
            Period after which the schedule repeats, ns.

        Returns
        -------
        Schedule
            The schedule.
        """
        return cls(tuple((float(delay),) for delay in delays_ns), period_ns)

    def applied_to(self, instrument: Instrument) -> Instrument:
        """Copy an instrument with this schedule in place of its own.

        Parameters
        ----------
        instrument : Instrument
            Instrument with as many bands as the schedule.

        Returns
        -------
        Instrument
            Copy with the delays and the period of the schedule.

        Raises
        ------
        InstrumentError
            If the number of bands differs, or the period needs more codes than the sensor has.
        """
        if len(self.delays_ns) != len(instrument.bands):
            raise InstrumentError(
                f"the schedule is for {len(self.delays_ns)} bands, instrument "
                f"{instrument.name!r} has {len(instrument.bands)}"
            )
        bands = tuple(
            msgspec.structs.replace(band, delay_ns=delays[0] if len(delays) == 1 else delays)
            for band, delays in zip(instrument.bands, self.delays_ns, strict=True)
        )
        timing = msgspec.structs.replace(instrument.timing, period_ns=self.period_ns)
        return instrument.replace(bands=bands, timing=timing)


def unambiguous_range(*schedules: Schedule, colours: int = 1, resolution_ns: float = 1.0) -> float:
    """Compute how far objects are ranged without ambiguity.

    Parameters
    ----------
    *schedules : Schedule
        One schedule, or several of one period that are interleaved frame by frame.
    colours : int
        Number of bands that every object reflects at least; 1 includes objects of a single colour.
    resolution_ns : float
        Pulses closer to each other than this, in ns, can't be distinguished.

    Returns
    -------
    float
        Length in m of the longest interval of distances of which no two can be mistaken for each
        other; at most half the distance that light travels in a period.

    Raises
    ------
    InstrumentError
        If the schedules don't belong together or the resolution makes no sense.

    Examples
    --------
    >>> even = Schedule.once([0, 50, 100, 150], period_ns=200)
    >>> print(f"{unambiguous_range(even):.1f} m")
    7.5 m
    """
    shifts_ns, partners = ambiguity(*schedules, resolution_ns=resolution_ns)
    beyond = np.abs(shifts_ns) > resolution_ns
    confused = np.abs(shifts_ns[beyond & (partners >= colours)])
    nearest = float(confused.min(initial=schedules[0].period_ns))
    return nearest * SPEED_OF_LIGHT_M_PER_NS / 2


def ambiguity(
    *schedules: Schedule, resolution_ns: float = 1.0
) -> tuple[NDArray[np.floating], NDArray[np.intp]]:
    """Count the bands that find partners at each shift of the train.

    Parameters
    ----------
    *schedules : Schedule
        One schedule, or several of one period that are interleaved frame by frame.
    resolution_ns : float
        Pulses closer to each other than this, in ns, can't be distinguished.

    Returns
    -------
    shifts_ns : ndarray of float, shape (shift,)
        Shifts from −period/2 to period/2, ns.
    partners : ndarray of int, shape (shift,)
        Number of bands whose every pulse, so shifted, coincides in all schedules with a pulse of a
        band that has no pulse elsewhere.

    Raises
    ------
    InstrumentError
        If the schedules don't belong together or the resolution makes no sense.
    """
    _check(schedules, resolution_ns)
    period_ns = schedules[0].period_ns
    count = int(np.ceil(2 * period_ns / resolution_ns)) | 1  # odd: 0 is one of them
    shifts_ns = (np.arange(count) - count // 2) * (period_ns / count)
    bands = len(schedules[0].delays_ns)
    partners = np.zeros(count, np.intp)
    for band in range(bands):
        # whether all pulses of another band lie on shifted pulses of this one
        fits = np.ones((bands, count), bool)
        for schedule in schedules:
            for other in range(bands):
                fits[other] &= _meets(schedule, band, other, shifts_ns, resolution_ns).all(axis=0)
        explained = np.ones(count, bool)
        for schedule in schedules:
            for delay in schedule.delays_ns[band]:
                at = np.zeros(count, bool)
                for other in range(bands):
                    targets = np.array(schedule.delays_ns[other])[:, None]
                    near = _near(delay + shifts_ns, targets, period_ns, resolution_ns)
                    at |= fits[other] & near.any(axis=0)
                explained &= at
        partners += explained
    return shifts_ns, partners


def design_schedules(
    bands: int,
    *,
    period_ns: float,
    range_m: float | None = None,
    schedules: int = 2,
    gap_ns: float = 25.0,
    tick_ns: float = 1.25,
    resolution_ns: float = 1.0,
    seed: int = 0,
) -> tuple[Schedule, ...]:
    """Search for schedules of a long unambiguous range, with one pulse per band and period.

    A single schedule ranges objects that reflect two or more bands; two interleaved schedules range
    objects of a single colour as well. The search climbs from random starts.

    Parameters
    ----------
    bands : int
        Number of LEDs.
    period_ns : float
        Period of the train, ns. With few bands, a shorter period gives more light per second.
    range_m : float or None
        Range that must be reached, m; None for all that the period allows.
    schedules : {2, 1}
        Number of schedules.
    gap_ns : float
        Smallest time between two pulses, ns. About twice the FWHM keeps their overlap small.
    tick_ns : float
        Time step of the pulse generator, ns.
    resolution_ns : float
        Pulses closer to each other than this, in ns, can't be distinguished.
    seed : int
        Seed of the search; the same seed gives the same schedules.

    Returns
    -------
    tuple of Schedule
        The schedules, which reach `range_m`.

    Raises
    ------
    InstrumentError
        If the period is too short for the bands or the range, or no schedule was found.
    """
    whole_m = period_ns * SPEED_OF_LIGHT_M_PER_NS / 2
    range_m = whole_m if range_m is None else range_m
    if not 0 < range_m <= whole_m * (1 + 1e-9):
        raise InstrumentError(
            f"range_m = {range_m}: a period of {period_ns} ns repeats after {whole_m:.2f} m; ask "
            "for less or lengthen the period"
        )
    if schedules not in (1, 2):
        raise InstrumentError(f"schedules = {schedules}: must be 1, or 2 interleaved ones")
    ticks = int(period_ns / tick_ns + 1e-9)
    least = int(np.ceil(gap_ns / tick_ns - 1e-9))
    if bands < 1 or bands * least > ticks:
        raise InstrumentError(
            f"{bands} bands with {gap_ns} ns between pulses don't fit a period of {period_ns} ns: "
            f"it holds {ticks // max(least, 1)}"
        )
    reach_ns = min(2 * range_m / SPEED_OF_LIGHT_M_PER_NS, period_ns)
    rng = np.random.default_rng(seed)
    found: list[NDArray[np.floating]] = []
    for _ in range(schedules):
        found.append(_best(rng, bands, ticks, least, tick_ns, period_ns, reach_ns, found))
    chosen = tuple(Schedule.once(delays_ns.tolist(), period_ns) for delays_ns in found)
    # a single schedule can't serve a single colour, unless nothing else is within reach
    reached = unambiguous_range(*chosen, colours=3 - schedules, resolution_ns=resolution_ns)
    if reached < range_m * (1 - 1e-9):
        raise InstrumentError(
            f"no schedule of {bands} bands within {period_ns} ns was found that ranges "
            f"{range_m:.2f} m, the best reaches {reached:.2f} m: narrow the gap of {gap_ns} ns, "
            "lengthen the period or ask for less"
        )
    return chosen


# -- search -----------------------------------------------------------------------------------


def _best(
    rng: np.random.Generator,
    bands: int,
    ticks: int,
    least: int,
    tick_ns: float,
    period_ns: float,
    reach_ns: float,
    others: list[NDArray[np.floating]],
) -> NDArray[np.floating]:
    """Delays (band,) of the best schedule of several climbs."""
    best, best_merit = np.zeros(bands), -np.inf
    for _ in range(RESTARTS):
        here = _random(rng, bands, ticks, least)
        merit = _merit(here * tick_ns, period_ns, reach_ns, others)
        for _ in range(ROUNDS):
            tried = here.copy()
            one, two = rng.integers(bands, size=2)
            if rng.random() < 0.3:
                tried[[one, two]] = tried[[two, one]]
            else:
                tried[one] = (tried[one] + rng.integers(-least, least + 1)) % ticks
                order = np.sort(tried)
                if bands > 1 and np.diff(np.append(order, order[0] + ticks)).min() < least:
                    continue
            new = _merit(tried * tick_ns, period_ns, reach_ns, others)
            if new >= merit:
                here, merit = tried, new
        if merit > best_merit:
            best, best_merit = here * tick_ns, merit
    return best


def _random(rng: np.random.Generator, bands: int, ticks: int, least: int) -> NDArray[np.int64]:
    """Ticks (band,) with at least so many between any two, at random on the circle."""
    slack = ticks - bands * least
    extra = np.sort(rng.integers(0, slack + 1, bands))
    places = (np.arange(bands) * least + extra) % ticks
    return rng.permutation(places)


def _merit(
    delays_ns: NDArray[np.floating],
    period_ns: float,
    reach_ns: float,
    others: list[NDArray[np.floating]],
) -> float:
    """Distance, in ns, of the nearest two shifts that are each ambiguous for a band of their own.

    If it is to be interleaved with another schedule, the distance of that one's shifts from these
    counts as well.
    """
    apart = np.eye(delays_ns.size) == 0
    differences = (delays_ns[None, :] - delays_ns[:, None])[apart] % period_ns
    relevant = np.minimum(differences, period_ns - differences) <= reach_ns
    merit = _closest(differences[relevant], period_ns)
    for other in others:
        between = (delays_ns - other) % period_ns  # equal for two LEDs: one stands for the other
        merit += 2 * min(_closest(between, period_ns), ENOUGH_NS)
    return merit


def _closest(places_ns: NDArray[np.floating], period_ns: float) -> float:
    """Least distance between places on the circle."""
    if places_ns.size < 2:
        return period_ns
    order = np.sort(places_ns)
    return float(min(np.diff(order).min(), order[0] + period_ns - order[-1]))


# -- matching ---------------------------------------------------------------------------------


def _meets(
    schedule: Schedule, band: int, other: int, shifts_ns: NDArray[np.floating], resolution_ns: float
) -> NDArray[np.bool_]:
    """(pulse of the other band, shift) whether it lies on a shifted pulse of the band."""
    pulses = np.array(schedule.delays_ns[band])[:, None] + shifts_ns
    return np.array(
        [
            _near(pulses, np.float64(delay), schedule.period_ns, resolution_ns).any(axis=0)
            for delay in schedule.delays_ns[other]
        ]
    )


def _near(
    one: NDArray[np.floating],
    two: NDArray[np.floating] | np.float64,
    period_ns: float,
    resolution_ns: float,
) -> NDArray[np.bool_]:
    apart = np.abs(np.remainder(one - two + period_ns / 2, period_ns) - period_ns / 2)
    return apart <= resolution_ns / 2


def _check(schedules: tuple[Schedule, ...], resolution_ns: float) -> None:
    if not schedules:
        raise InstrumentError("no schedule: give at least one")
    first = schedules[0]
    for other in schedules[1:]:
        if other.period_ns != first.period_ns or len(other.delays_ns) != len(first.delays_ns):
            raise InstrumentError(
                f"schedules of {len(first.delays_ns)} bands in {first.period_ns} ns and of "
                f"{len(other.delays_ns)} in {other.period_ns} ns can't be interleaved"
            )
    if not (isfinite(resolution_ns) and 0 < resolution_ns < first.period_ns / 4):
        raise InstrumentError(
            f"resolution_ns = {resolution_ns!r}: must be above 0 and below a quarter of the period"
        )
