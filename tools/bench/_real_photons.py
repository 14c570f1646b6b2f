# SPDX-License-Identifier: Apache-2.0
"""Real photons, which lie beside the project and are no part of it, and scanners with one laser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import hueflight as hf
from hueflight.calibration import Calibration
from hueflight.model.waveforms import Templates

REAL_DATA = Path(__file__).absolute().parents[3] / "shared" / "data"
PHOTON_DATA = REAL_DATA / "photons"


def laser_calibration(instrument: hf.Instrument, pulse: NDArray[np.float64]) -> Calibration:
    """Return a calibration from the shape of the pulse alone, over one period.

    All pixels are alike and without delays of their own; depth has an offset.
    """
    period_ns = instrument.time_bins().period_ns
    assert period_ns is not None
    shape = instrument.image_shape
    zero, never = np.zeros(shape), np.zeros(shape, bool)
    return Calibration(
        instrument=instrument,
        distance=0.0,
        bins=instrument.time_bins(),
        reference=np.zeros((*shape, 1), np.float32),
        frames=None,
        windows=(),
        pixel_delay_ns=zero,
        pixel_delay_std_ns=zero,
        gain=np.ones(1),
        templates=Templates.normalized(pulse[None], period_ns),
        brightness=np.ones(1),
        flat_field=zero + 1,
        dead=never,
        hot=never,
    )
