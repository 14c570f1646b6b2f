# SPDX-License-Identifier: Apache-2.0
"""Avalanches that other avalanches set off: crosstalk between pixels, and afterpulses.

Both compete with a pixel's own photons for the one count of an exposure. The earliest event of two
independent Poisson processes is the first event of their sum, so that both have exact
distributions with the same equation as the photons (`probabilities.first_photon_probabilities`):

- With probability c, the first avalanche of a neighbor sets off one here at the same time. The
  pixel's count is then the first event of both pixels' light together.
- With probability p, the count of an exposure leaves a trapped carrier that is released in a later
  one. The exponential distribution has no memory: at the start of the exposure, the carrier has
  the same mean lifetime ahead, a constant rate of 1/lifetime. The pixel's count is then the first
  event of its light and that rate. With the occupancies o and o' of an exposure without and with a
  trapped carrier, the fraction of exposures with a count is o / (1 - p (o' - o)).

Left out: crosstalk of two neighbors in one exposure, of a neighbor's own crosstalk and of its
afterpulses, which are of second order in these probabilities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

_NEIGHBORS = ((-1, 0), (1, 0), (0, -1), (0, 1))


@dataclass(frozen=True)
class SecondaryAvalanches:
    """Crosstalk and afterpulsing of a sensor.

    Attributes
    ----------
    crosstalk_share : float
        Probability that an avalanche sets off one in each of four neighbors.
    afterpulse_share : float
        Probability that an exposure with a count leaves a trapped carrier for the next one.
    afterpulse_ns : float
        Mean lifetime of trapped carriers, ns.
    alive : ndarray of bool, shape (row, col)
        Pixels that can fire.
    sensor_rows : int
        Rows of the sensor; rows of different positions of a scan are not neighbors.
    """

    crosstalk_share: float
    afterpulse_share: float
    afterpulse_ns: float
    alive: NDArray[np.bool_]
    sensor_rows: int

    def rows(self, rows: slice) -> SecondaryAvalanches:
        """Return the same for some rows of the picture, which begin at a position of the scan."""
        return replace(self, alive=self.alive[rows])

    def surroundings(self, rows: range) -> range:
        """Return the rows on which the counts of some rows depend.

        Parameters
        ----------
        rows : range
            Rows of the picture.

        Returns
        -------
        range
            The same rows and, with crosstalk, those above and below.
        """
        if self.crosstalk_share == 0:
            return rows
        return range(max(rows.start - 1, 0), min(rows.stop + 1, len(self.alive)))

    def mixture(
        self, values: NDArray[np.float64], given: range, rows: range
    ) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Return the light of which a pixel's count is the first event, and how often it is.

        Parameters
        ----------
        values : ndarray of float, shape (row, col, bin)
            Expected photons per period of the rows in `given`.
        given : range
            Rows of the picture that `surroundings` names.
        rows : range
            Rows of the picture to return.

        Returns
        -------
        list of tuple of ndarray of float
            Probability, (row, col, 1), and light, (row, col, bin): of the pixel alone and of the
            pixel together with each neighbor. Dead pixels have no light.
        """
        inside = slice(rows.start - given.start, rows.stop - given.start)
        alive = self.alive[rows.start : rows.stop, :, None]
        own = values[inside] * alive
        others = self.neighbors(values, given, rows)
        left = 1 - sum((share for share, _ in others), np.zeros(alive.shape))
        return [(left, own), *((share, own + near * alive) for share, near in others)]

    def neighbors(
        self, values: NDArray[np.float64], given: range, rows: range
    ) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Return the probability that each neighbor sets off an avalanche, and its values.

        Parameters
        ----------
        values : ndarray of float, shape (row, col, bin)
            Values of the rows in `given`.
        given : range
            Rows of the picture that `surroundings` names.
        rows : range
            Rows of the picture to return.

        Returns
        -------
        list of tuple of ndarray of float
            Probability if the neighbor fires, (row, col, 1), and its values, (row, col, bin); both
            0 where there is no neighbor or a dead one. Empty without crosstalk.
        """
        if self.crosstalk_share == 0:
            return []
        inside = np.asarray(rows)
        alive = self.alive[given.start : given.stop, :, None]
        parts = []
        for down, right in _NEIGHBORS:
            exists = (inside + down) // self.sensor_rows == inside // self.sensor_rows
            at = np.where(exists, inside + down, inside) - given.start
            working = _moved(alive[at] & exists[:, None, None], right)
            parts.append((self.crosstalk_share * working, _moved(values[at], right) * working))
        return parts

    def counted(
        self, without: NDArray[np.float64], with_carrier: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the fraction of exposures with a count.

        Parameters
        ----------
        without, with_carrier : ndarray of float
            Occupancy of an exposure that starts without and with a trapped carrier.

        Returns
        -------
        ndarray of float, same shape
            Fraction in the long run.
        """
        return without / (1 - self.afterpulse_share * (with_carrier - without))


def _moved(values: NDArray[np.generic], right: int) -> NDArray[np.float64]:
    """Value of each pixel's neighbor that is `right` columns away; 0 where there is none."""
    result = np.zeros(values.shape)
    if right == 0:
        result[...] = values
    elif right > 0:
        result[:, :-right] = values[:, right:]
    else:
        result[:, -right:] = values[:, :right]
    return result
