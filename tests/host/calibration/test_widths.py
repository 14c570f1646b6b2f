# SPDX-License-Identifier: Apache-2.0
"""Widths of codes from steady light, with all imperfections that the simulator knows."""

import numpy as np
import pytest

import hueflight as hf
from hueflight import simulator


@pytest.mark.parametrize("hot_share", [0.0, 0.05])
def test_widths_are_as_exact_as_the_photons_allow(small, hot_share):
    """Hot pixels fire early in the exposure; they must not bend the widths."""
    instrument = small(rows=32, cols=24)
    settings = simulator.SimulationSettings(hot_share=hot_share)
    captures = {
        kind: simulator.simulate_capture(
            kind, instrument, frames=frames, distance=0.4, settings=settings
        )
        for kind, frames in (("reference", 2000), ("flat", 20_000))
    }
    calibration = hf.calibrate(
        captures["reference"], instrument, distance=0.4, flat=captures["flat"]
    )
    true_ns = simulator.time_bins(instrument, settings).widths_ns
    off_ns = (calibration.bins.widths_ns - true_ns)[1:-1]
    photons = captures["flat"][..., 1:].sum() * (1 - 2 * hot_share)
    noise_ns = true_ns.mean() / np.sqrt(photons / true_ns.size)
    # 497 codes: the scatter is known to 3 %
    assert off_ns.std() == pytest.approx(noise_ns, rel=0.15)
    assert abs(off_ns.mean()) < 4 * noise_ns / np.sqrt(off_ns.size)
