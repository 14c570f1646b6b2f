# SPDX-License-Identifier: Apache-2.0
"""Probabilities of codes of a first-photon sensor, exact for a periodic light signal.

Within a period, the first photon falls into bin i with probability
exp(−Λ_i)·(1 − exp(−λ_i)), where λ_i is the expected number of photons in the bin and Λ_i that in
all bins before it in the period. An exposure of M periods keeps the first photon of the first
period that contains one. Periods are independent of one another, so

    p_i = exp(−Λ_i)·(1 − exp(−λ_i)) · (1 − exp(−MΛ)) / (1 − exp(−Λ)),    p_0 = exp(−MΛ).

The exposure begins with a period.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import Instrument
from hueflight.model.pulses import Pulse
from hueflight.model.time_bins import TimeBins
from hueflight.simulator.effects.secondary_avalanches import SecondaryAvalanches
from hueflight.simulator.light import Rates

# Cubic interpolation of a bin's share between delays h apart has an error of at most
# (9/16)·h⁴/24·max|share''''|, and the fourth derivative of a bin's share of a pulse with Gaussian
# part σ is at most 2·0.551/σ⁴ (an exponential tail only smooths). With h = σ/24: 7.8e-8.
STEPS_PER_SIGMA = 24

_TILE_BYTES = 1 << 20  # fits into the processor's cache


@dataclass(frozen=True)
class PulseTable:
    """Fraction of every band's light that falls into each bin, tabulated over delay.

    Attributes
    ----------
    start_ns, step_ns : float
        Delay of the first entry and step from one entry to the next, ns.
    shares : ndarray of float, shape (delay, band, bin)
        Fraction of a band's photons that fall into the bin; the sum over bins is 1 where the
        bins cover the whole period.
    """

    start_ns: float
    step_ns: float
    shares: NDArray[np.float64]

    @classmethod
    def build(
        cls,
        instrument: Instrument,
        bins: TimeBins,
        delay_ns: NDArray[np.floating],
        trains: Sequence[Sequence[Pulse]] | None = None,
    ) -> PulseTable:
        """Tabulate pulses, by default the instrument's, over a range that covers all delays, ns."""
        if trains is None:
            trains = [instrument.pulses(band) for band in range(len(instrument.bands))]
        step_ns = min(pulse.sigma_ns for train in trains for pulse in train) / STEPS_PER_SIGMA
        first = floor(float(delay_ns.min()) / step_ns) - 1
        last = ceil(float(delay_ns.max()) / step_ns) + 2
        shares = np.empty((last - first + 1, len(trains), bins.count))
        for entry in range(last - first + 1):
            delay = (first + entry) * step_ns
            for band, train in enumerate(trains):
                shares[entry, band] = sum(
                    replace(pulse, center_ns=pulse.center_ns + delay).share(
                        bins.edges_ns, bins.period_ns
                    )
                    for pulse in train
                )
        return cls(first * step_ns, step_ns, shares)

    def expected(
        self, photons: NDArray[np.float64], delay_ns: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Interpolate the expected photons per bin of each pixel.

        Parameters
        ----------
        photons : ndarray of float, shape (band, pixel)
            Photons per period.
        delay_ns : ndarray of float, shape (pixel,)
            Delay of the light, within the range of the table, ns.

        Returns
        -------
        ndarray of float, shape (pixel, bin)
            Photons per period in each bin.
        """
        position = (delay_ns - self.start_ns) / self.step_ns
        cell = position.astype(np.intp)
        f = position - cell
        lagrange = np.stack([
            -f * (f - 1) * (f - 2) / 6,
            (f + 1) * (f - 1) * (f - 2) / 2,
            -(f + 1) * f * (f - 2) / 2,
            (f + 1) * f * (f - 1) / 6,
        ], axis=1)  # fmt: skip
        # one small matrix product for all pixels of a cell
        weights = (lagrange[:, :, None] * photons.T[:, None, :]).reshape(cell.size, -1)
        order = np.argsort(cell, kind="stable")
        starts = np.flatnonzero(np.diff(cell[order], prepend=-1))
        result = np.empty((cell.size, self.shares.shape[2]))
        for members in np.split(order, starts[1:]):
            at = cell[members[0]]
            neighbours = self.shares[at - 1 : at + 3].reshape(-1, self.shares.shape[2])
            result[members] = weights[members] @ neighbours
        return np.maximum(result, 0, out=result)  # the interpolation error may make it negative


def code_probabilities(rates: Rates, rows: slice = slice(None)) -> NDArray[np.float64]:
    """Compute the probability of every code in one exposure.

    Parameters
    ----------
    rates : Rates
        Expected photons of every pixel, from `expected_rates`.
    rows : slice
        Rows of the image to compute; all by default.

    Returns
    -------
    ndarray of float, shape (row, col, code)
        Probability of each code. If the sensor reports empty exposures, they have code 0 and the
        probabilities of a pixel sum to 1; otherwise they sum to its occupancy.
    """
    chosen = range(*rows.indices(rates.shape[0]))
    given = rates.secondary.surroundings(chosen) if rates.secondary else chosen
    table = _pulse_table(rates.rows(slice(given.start, given.stop)))
    return _tile_probabilities(rates, table, chosen)


def probability_tiles(rates: Rates) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Compute `code_probabilities` in tiles of a few rows, so that memory stays bounded.

    Parameters
    ----------
    rates : Rates
        Expected photons of every pixel, from `expected_rates`.

    Yields
    ------
    rows : slice
        Rows of the tile.
    probabilities : ndarray of float, shape (row, col, code)
        Probability of each code in these rows.
    """
    table = _pulse_table(rates)
    rows, cols = rates.shape
    step = max(1, _TILE_BYTES // (8 * cols * rates.instrument.sensor.codes))
    for start in range(0, rows, step):
        tile = range(start, min(rows, start + step))
        yield slice(tile.start, tile.stop), _tile_probabilities(rates, table, tile)


def _pulse_table(rates: Rates) -> PulseTable:
    delays = [rates.delay_ns, *(part.delay_ns for part in rates.further)]
    extremes = np.array([limit for delay in delays for limit in (delay.min(), delay.max())])
    return PulseTable.build(rates.instrument, rates.bins, extremes, rates.trains)


def _tile_probabilities(rates: Rates, table: PulseTable, rows: range) -> NDArray[np.float64]:
    """Probability of every code of some rows; the table must cover their delays."""
    secondary = rates.secondary
    if secondary is None:
        in_bins, empty = _first_event(_expected_light(rates, table, rows), rates)
    else:
        in_bins, empty = _with_secondary(rates, table, rows, secondary)
    sensor = rates.instrument.sensor
    result = np.zeros((*empty.shape, sensor.codes))
    result[..., rates.bins.codes] = in_bins
    if sensor.reports_empty:
        result[..., 0] = empty
    return result


def _expected_light(rates: Rates, table: PulseTable, rows: range) -> NDArray[np.float64]:
    """Expected photons per period of some rows, (row, col, bin)."""
    part = rates.rows(slice(rows.start, rows.stop))
    bins, bands = part.bins, part.photons.shape[0]
    expected = table.expected(part.photons.reshape(bands, -1), part.delay_ns.ravel())
    for other in part.further:
        expected += table.expected(other.photons.reshape(bands, -1), other.delay_ns.ravel())
    expected += part.background.reshape(-1, 1) * (bins.widths_ns / bins.span_ns)
    if part.uneven is not None:
        expected += part.uneven.photons.reshape(-1, 1) * part.uneven.shares
    return expected.reshape(*part.shape, bins.count)


def _first_event(
    expected: NDArray[np.float64], rates: Rates, *, pile_up: bool | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probability of each bin, (..., bin), and of an empty exposure, (...)."""
    pile_up = rates.pile_up if pile_up is None else pile_up
    in_bins = first_photon_probabilities(expected, rates.periods, pile_up=pile_up)
    return in_bins, np.exp(-rates.periods * expected.sum(axis=-1))


def _with_secondary(
    rates: Rates, table: PulseTable, rows: range, secondary: SecondaryAvalanches
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities like those of `_first_event`, with crosstalk and afterpulses."""
    given = secondary.surroundings(rows)
    parts = secondary.mixture(_expected_light(rates, table, given), given, rows)

    def mean(
        rate: float, *, pile_up: bool | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        further = rate * rates.bins.widths_ns
        in_bins, empty = np.zeros(parts[0][1].shape), np.zeros(parts[0][1].shape[:-1])
        for share, light in parts:
            bins, none = _first_event(light + further, rates, pile_up=pile_up)
            in_bins, empty = in_bins + share * bins, empty + share[..., 0] * none
        return in_bins, empty

    in_bins, empty = mean(0.0, pile_up=None)
    if secondary.afterpulse_share:
        # the decay over the period is the pile-up of a constant rate, so that it can't be off
        alive = secondary.alive[rows.start : rows.stop]
        late_bins, late_empty = mean(1 / secondary.afterpulse_ns, pile_up=True)
        counted = secondary.counted(1 - empty, 1 - late_empty)
        begins = np.where(alive, secondary.afterpulse_share * counted, 0.0)
        in_bins = in_bins + begins[..., None] * (late_bins - in_bins)
        empty = empty + begins * (late_empty - empty)
    return in_bins, empty


def first_photon_probabilities(
    expected: NDArray[np.float64], periods: int, *, pile_up: bool
) -> NDArray[np.float64]:
    """Probability that the photon that an exposure keeps is in each bin.

    The module's docstring derives the equation.

    Parameters
    ----------
    expected : ndarray of float, shape (..., bin)
        Expected photons per period in each bin, in time order.
    periods : int
        Number of periods in one exposure.
    pile_up : bool
        Whether an early photon hides later ones of its period.

    Returns
    -------
    ndarray of float, shape (..., bin)
        Probability of each bin; they sum to the probability of an exposure that is not empty.
    """
    total = expected.sum(axis=-1, keepdims=True)
    occupancy = -np.expm1(-periods * total)
    if pile_up:
        # the differences of 1 − exp(−Λ) from edge to edge are exp(−Λ_i)·(1 − exp(−λ_i))
        seen = np.cumsum(expected, axis=-1)
        np.expm1(np.negative(seen, out=seen), out=seen)
        in_period = -np.diff(seen, axis=-1, prepend=0)
        per_period = -np.expm1(-total)
    else:
        in_period, per_period = expected, total
    scale = np.divide(occupancy, per_period, out=np.zeros_like(total), where=per_period > 0)
    return in_period * scale
