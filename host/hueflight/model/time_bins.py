# SPDX-License-Identifier: Apache-2.0
"""Codes in order of photon arrival time, on the circle of the period."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TimeBins:
    """Which code covers which interval of time.

    A converter in reverse mode measures from the photon to the clock's next edge. Its first code
    therefore ends the period, and the *partial* bin, which exists where the period is not a whole
    number of bins, is the first in time; in forward mode it is the last. All later processing works
    on these bins and need not know the direction.

    Attributes
    ----------
    codes : ndarray of int, shape (bin,)
        Raw code of each bin, in order of arrival time.
    edges_ns : ndarray of float, shape (bin + 1,)
        Edges of the bins in ascending order, ns; from 0 to the period where there is one.
    period_ns : float or None
        Period of the pulse train, ns; None for a single shot.
    """

    codes: NDArray[np.intp]
    edges_ns: NDArray[np.float64]
    period_ns: float | None

    @staticmethod
    def codes_needed(period_ns: float, bin_width_ns: float) -> int:
        """Compute the number of bins that cover a period, including a partial one.

        Parameters
        ----------
        period_ns : float
            Period of the pulse train, ns.
        bin_width_ns : float
            Nominal width of a bin, ns.

        Returns
        -------
        int
            Number of bins.
        """
        # a period of a whole number of bins must not gain a sliver by rounding
        return ceil(period_ns / bin_width_ns - 1e-9)

    @classmethod
    def nominal(
        cls,
        *,
        codes: int,
        first_code: int,
        bin_width_ns: float,
        period_ns: float | None,
        reverse: bool,
    ) -> TimeBins:
        """Make equal bins: as many as the period needs, or all codes where there is no period.

        Parameters
        ----------
        codes : int
            Number of codes of the converter.
        first_code : int
            First code that stands for a time: 1 where code 0 reports an empty exposure.
        bin_width_ns : float
            Nominal width of a bin, ns.
        period_ns : float or None
            Period of the pulse train, ns; None for a single shot.
        reverse : bool
            True where later photons have smaller codes.

        Returns
        -------
        TimeBins
            The bins in order of arrival time.
        """
        count = codes - first_code
        if period_ns is not None:
            count = min(count, cls.codes_needed(period_ns, bin_width_ns))
        # time that the converter itself counts, from its start
        counted_ns = np.arange(count + 1, dtype=np.float64) * np.float64(bin_width_ns)
        if period_ns is not None:
            counted_ns[-1] = min(counted_ns[-1], period_ns)
        ordered = np.arange(first_code, first_code + count)
        if not reverse:
            return cls(ordered, counted_ns, period_ns)
        end_ns = counted_ns[-1] if period_ns is None else period_ns
        return cls(ordered[::-1].copy(), (end_ns - counted_ns)[::-1].copy(), period_ns)

    def with_widths(self, widths_ns: NDArray[np.floating]) -> TimeBins:
        """Copy the bins with measured widths, as a code-density test gives them.

        Parameters
        ----------
        widths_ns : ndarray of float, shape (bin,)
            Widths in order of arrival time, ns. Where there is a period, they are scaled so
            that they sum to it.

        Returns
        -------
        TimeBins
            The same codes with new edges.
        """
        edges_ns = np.concatenate([[0.0], np.cumsum(widths_ns)])
        if self.period_ns is not None:  # the circle closes whatever the measurement's scale
            edges_ns *= self.period_ns / edges_ns[-1]
        return TimeBins(self.codes, edges_ns, self.period_ns)

    @property
    def count(self) -> int:
        """Number of bins."""
        return self.codes.size

    @property
    def widths_ns(self) -> NDArray[np.float64]:
        """Width of each bin, shape (bin,), ns."""
        return np.diff(self.edges_ns)

    @property
    def centers_ns(self) -> NDArray[np.float64]:
        """Middle of each bin, shape (bin,), ns."""
        return (self.edges_ns[1:] + self.edges_ns[:-1]) / 2

    @property
    def span_ns(self) -> float:
        """Duration that all bins cover together, ns."""
        return float(self.edges_ns[-1] - self.edges_ns[0])

    def in_time_order(self, histogram: NDArray[np.generic]) -> NDArray[np.generic]:
        """Reorder counts from codes to bins.

        Parameters
        ----------
        histogram : ndarray, shape (..., code)
            Counts by raw code.

        Returns
        -------
        ndarray, shape (..., bin)
            A view of the counts in order of arrival time.
        """
        first, last = int(self.codes[0]), int(self.codes[-1])
        if last >= first:
            return histogram[..., first : last + 1]
        return histogram[..., last : first + 1][..., ::-1]
