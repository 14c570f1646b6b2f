# SPDX-License-Identifier: Apache-2.0
"""The footprint of a pixel: several rays spread evenly over its area instead of one at its centre.

Pixels at the edge of an object then see two surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError
from hueflight.model.instrument import Instrument

MAX_RAYS = 16  #: rays along each side of a pixel; 256 rays take as long as 256 scenes


@dataclass(frozen=True)
class Rays:
    """Directions in which the pixels look.

    Attributes
    ----------
    right : ndarray of float, shape (row, col)
        Metres to the right per metre of depth.
    down : ndarray of float, shape (row, col)
        Metres down per metre of depth.
    """

    right: NDArray[np.float64]
    down: NDArray[np.float64]

    @property
    def cosine(self) -> NDArray[np.float64]:
        """Cosine of the angle to the optical axis, (row, col)."""
        return 1 / np.sqrt(1 + self.right**2 + self.down**2)


def footprint_rays(instrument: Instrument, rays: int) -> tuple[Rays, ...]:
    """Return the rays of a square grid over each pixel's area.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose pixels are divided; the whole pitch is taken as sensitive.
    rays : int
        Number of rays along each side of a pixel.

    Returns
    -------
    tuple of Rays
        One entry for each of the ``rays ** 2`` positions within a pixel, row by row.

    Raises
    ------
    SceneError
        If the number is not 1 to 16, or if the instrument has no lens, so that all rays of all
        pixels are the same.
    """
    if not 1 <= rays <= MAX_RAYS:
        raise SceneError(f"rays = {rays!r}: must be a whole number from 1 to {MAX_RAYS}")
    lens, sensor = instrument.lens, instrument.sensor
    if lens is None or sensor.pixel_width_um is None or sensor.pixel_height_um is None:
        raise SceneError(
            f"instrument {instrument.name!r} has no lens, so that a pixel has no footprint: "
            "describe its lens or leave rays = 1"
        )
    width = sensor.pixel_width_um * 1e-3 / lens.focal_length_mm
    height = sensor.pixel_height_um * 1e-3 / lens.focal_length_mm
    right, down = instrument.ray_slopes()
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    return tuple(Rays(right + x * width, down + y * height) for y in offsets for x in offsets)
