"""From a pixel's photons to reflectance, but for each band's gain: the same for every method."""

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
    """Factor (row, col) from a pixel's photons to photons per frame of an average pixel.

    Parameters
    ----------
    photons, frames : (row, col) counts and the exposures behind them; without exposures as many
        are assumed as the reference had.
    pileup_correction : undo what exposures that keep only their first photon have lost.
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
