# SPDX-License-Identifier: Apache-2.0
"""Light that comes back to a pixel with a delay of its own: one entry for each path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Return:
    """LED light of all pixels that arrives by one path.

    Attributes
    ----------
    name : str
        Path of the light: ``"surface"``, ``"pane"``, ``"leaf"``, ``"flare"``, ``"reflection"``,
        ``"bounce"`` or ``"fog"``.
    photons : ndarray of float, shape (band, row, col)
        Detectable LED photons per period.
    delay_ns : ndarray of float, shape (row, col)
        Sum of the time of flight and the delay of the pixel, ns.
    depth : ndarray of float, shape (row, col)
        Depth along the optical axis of what returns the light, m; NaN where nothing does and for
        light that does not come from the scene.
    """

    name: str
    photons: NDArray[np.float64]
    delay_ns: NDArray[np.float64]
    depth: NDArray[np.float64]

    def rows(self, rows: slice) -> Return:
        """Return the same light for some rows of the picture."""
        return Return(self.name, self.photons[:, rows], self.delay_ns[rows], self.depth[rows])


def lens_flare(returns: Sequence[Return], share: float, delay_ns: float) -> Return:
    """Return the light that the lens scatters evenly over the picture.

    Parameters
    ----------
    returns : sequence of Return
        All direct light, with delays that contain the time of flight only.
    share : float
        Fraction of the picture's mean LED light.
    delay_ns : float
        Delay after the mean arrival time of the picture's LED light, ns.

    Returns
    -------
    Return
        Equal light in all pixels.
    """
    shape = returns[0].delay_ns.shape
    mean = sum(part.photons.mean(axis=(1, 2)) for part in returns)
    weights = [part.photons.sum(axis=0) for part in returns]
    total = sum(float(weight.sum()) for weight in weights)
    arrival = sum(
        float((weight * part.delay_ns).sum()) for weight, part in zip(weights, returns, strict=True)
    )
    mean_ns = arrival / total if total else 0.0
    return Return(
        "flare",
        np.broadcast_to(np.reshape(share * mean, (-1, 1, 1)), returns[0].photons.shape),
        np.full(shape, mean_ns + delay_ns),
        np.full(shape, np.nan),
    )


def fixed_reflection(
    photons: NDArray[np.float64], delay_ns: float, shape: tuple[int, int]
) -> Return:
    """Return the light of a reflection inside the instrument, equal in all pixels.

    Parameters
    ----------
    photons : ndarray of float, shape (band,)
        Detectable photons per period.
    delay_ns : float
        Delay after the arrival time from distance 0, ns.
    shape : tuple of int
        Numbers of rows and columns.

    Returns
    -------
    Return
        Equal light in all pixels.
    """
    return Return(
        "reflection",
        np.broadcast_to(photons[:, None, None], (photons.size, *shape)),
        np.full(shape, delay_ns),
        np.full(shape, np.nan),
    )


def bounced(direct: Return, color: NDArray[np.float64], late_ns: float) -> Return:
    """Return the light that reaches surfaces by way of other ones.

    Parameters
    ----------
    direct : Return
        Light of the surfaces without it.
    color : ndarray of float, shape (band,)
        Fraction of the direct light in each band.
    late_ns : float
        Additional time of flight, ns.

    Returns
    -------
    Return
        Light with the color of both surfaces.
    """
    return Return(
        "bounce",
        direct.photons * color[:, None, None],
        direct.delay_ns + late_ns,
        np.full(direct.depth.shape, np.nan),
    )
