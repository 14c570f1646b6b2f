# SPDX-License-Identifier: Apache-2.0
"""What makes results of fits, the same for all pixels of a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.fit.tables import detection_threshold
from hueflight.reconstruction.quality import Quality

BLIND = 0.7  #: of a uniform guess's deviation: who knows no better than this knows nothing
LIMIT_NS = 1e-3  #: a delay so near the end of the searched range was cut off there
#: flags of pixels whose depth is not told
UNTOLD = Quality.LOW_SIGNAL | Quality.NO_RETURN | Quality.OUT_OF_RANGE


@dataclass(frozen=True)
class Conversion:
    """How fits become results.

    Attributes
    ----------
    calibration : Calibration
        Calibration of the same instrument.
    search_ns : tuple of float
        Delays that were searched.
    range_correction : bool
        Multiply reflectance by (distance / reference distance)².
    pileup_correction : bool
        Undo the loss of photons after the first one of an exposure.
    """

    calibration: Calibration
    search_ns: tuple[float, float]
    range_correction: bool
    pileup_correction: bool

    @property
    def blind_ns(self) -> float:
        """Deviation of a delay from which nothing is known of it, ns."""
        return float(BLIND * (self.search_ns[1] - self.search_ns[0]) / np.sqrt(12))

    @property
    def limits_ns(self) -> tuple[float, float]:
        """Delays at or beyond which one was cut off, ns."""
        return self.search_ns[0] + LIMIT_NS, self.search_ns[1] - LIMIT_NS

    @property
    def least_detection(self) -> float:
        """Detection ratio from which a pixel counts as a surface."""
        return detection_threshold(self.search_ns)


def base_flags(calibration: Calibration, /) -> NDArray[np.uint16]:
    """Return the flags of pixels that are not usable.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    ndarray of uint16, shape (row, col)
        Bits of `Quality`; 0 where a pixel is usable.
    """
    flags = np.zeros(calibration.dead.shape, np.uint16)
    flags[calibration.dead] |= int(Quality.DEAD)
    flags[calibration.hot] |= int(Quality.HOT)
    return flags
