"""From a pixel's photons to reflectance, except for each band's gain: the same for every method."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.model.pileup import lost_photons_factor

TINY = 1e-30  #: exposures; fewer are none


def reflectance_scale(
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    calibration: Calibration,
    *,
    pileup_correction: bool,
) -> NDArray[np.float64]:
    """Return the factor from a pixel's photons to photons per frame of an average pixel.

    Parameters
    ----------
    photons : ndarray of float, shape (row, col)
        Counts of each pixel.
    frames : ndarray of float, shape (row, col), or None
        Exposures behind them; None to assume as many as the reference had.
    calibration : Calibration
        Calibration of the same instrument.
    pileup_correction : bool
        Undo the loss of photons after the first one of an exposure.

    Returns
    -------
    ndarray of float, shape (row, col)
        The factor.
    """
    if frames is None or calibration.frames is None:
        return 1 / calibration.flat_field
    # so few exposures (weighted counts may come near 0) tell nothing
    exposures = np.where(frames > TINY, frames, np.nan)
    scale = 1 / (calibration.flat_field * exposures)
    if pileup_correction:
        return scale * lost_photons_factor(photons, frames)
    # the calibration is in photons that arrived: take the loss back
    reference = calibration.reference.sum(axis=-1, dtype=np.float64)
    return scale * lost_photons_factor(reference, calibration.frames)
