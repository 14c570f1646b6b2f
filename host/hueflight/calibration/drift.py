# SPDX-License-Identifier: Apache-2.0
"""A calibration whose LEDs have drifted since it was made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hueflight.calibration.calibration import Calibration
from hueflight.errors import CalibrationError
from hueflight.model.waveform_changes import changed
from hueflight.model.waveforms import Templates


def with_drift(
    calibration: Calibration, *, delay_ps: ArrayLike = 0.0, width_factor: ArrayLike = 1.0
) -> Calibration:
    """Return a calibration for LEDs that fire later or longer than when it was made.

    The waveforms change; `reference` stays as it was measured, so that method ``"paper"``, which
    correlates with it, does not profit.

    Parameters
    ----------
    calibration : Calibration
        Calibration as it was measured, or corrected before.
    delay_ps : array_like, shape (band,) or number
        How much later each band arrives, ps.
    width_factor : array_like, shape (band,) or number
        Factor on the duration of each band's pulse about its centroid.

    Returns
    -------
    Calibration
        The corrected calibration. The entry ``drift`` of its provenance holds the delays (ps) and
        width factors since the calibration was measured.

    Raises
    ------
    CalibrationError
        If a delay is not finite, or a factor is not near 1.
    """
    bands = calibration.templates.bands
    delays = np.broadcast_to(np.asarray(delay_ps, np.float64), (bands,))
    factors = np.broadcast_to(np.asarray(width_factor, np.float64), (bands,))
    if not np.isfinite(delays).all():
        raise CalibrationError(f"delay_ps = {delays.tolist()}: must be finite numbers")
    if not (np.isfinite(factors) & (factors > 0.5) & (factors < 2)).all():
        raise CalibrationError(
            f"width_factor = {factors.tolist()}: must lie between 0.5 and 2; for larger changes "
            "calibrate again"
        )
    moved = changed(calibration.templates, delay_ns=1e-3 * delays, width_factor=factors)
    before = calibration.provenance.get("drift", {})
    drift = {
        "delay_ps": (np.array(before.get("delay_ps", np.zeros(bands))) + delays).tolist(),
        "width_factor": (np.array(before.get("width_factor", np.ones(bands))) * factors).tolist(),
    }
    return replace(
        calibration,
        templates=Templates.normalized(moved.coefficients, moved.circle_ns),
        provenance={**calibration.provenance, "drift": drift},
    )
