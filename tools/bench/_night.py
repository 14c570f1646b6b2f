# SPDX-License-Identifier: Apache-2.0
"""Real photons of a building 21 km away at night: 256 × 256 pixels, most of the sky empty.

The data state arrival times in ps within a gate (Li et al., arXiv 1904.10341), but not the pulse,
for which a Gaussian stands.
"""

from __future__ import annotations

import numpy as np
from _real_photons import PHOTON_DATA, laser_calibration
from numpy.typing import NDArray

import hueflight as hf
from hueflight.calibration import Calibration

NIGHT = PHOTON_DATA / "k11_night.mat"
NIGHT_GATE_PS, NIGHT_CODES, NIGHT_FWHM_NS, NIGHT_PULSE_NS = 200_000, 512, 0.98, 5.0
NIGHT_DEPTH_RANGE = (0.0, 28.5)  #: within the gate, m


def night_counts(cells: NDArray[np.object_]) -> NDArray[np.uint16]:
    """Return histograms (row, col, code) of arrival times in ps after the start of the gate."""
    counts = np.zeros((cells.size, NIGHT_CODES), np.uint16)
    for pixel, times in enumerate(cells.ravel()):
        code = (times.ravel().astype(np.int64) % NIGHT_GATE_PS) * NIGHT_CODES // NIGHT_GATE_PS
        np.add.at(counts[pixel], code, 1)
    return counts.reshape(*cells.shape, NIGHT_CODES)


def night_calibration(shape: tuple[int, ...]) -> Calibration:
    """Return a calibration with a Gaussian pulse; depth has an offset."""
    period_ns = NIGHT_GATE_PS / 1000
    instrument = hf.Instrument.from_toml(f"""
        name = "night"
        [sensor]
        rows = {shape[0]}
        cols = {shape[1]}
        code_bits = 9
        bin_width_ns = {period_ns / NIGHT_CODES}
        [timing]
        period_ns = {period_ns}
        latency_ns = {NIGHT_PULSE_NS}
        [[bands]]
        name = "laser"
        wavelength_nm = 640
        pulse_fwhm_ns = {NIGHT_FWHM_NS}
    """)
    times_ns = np.arange(4 * NIGHT_CODES) * period_ns / (4 * NIGHT_CODES)
    pulse = np.exp(-4 * np.log(2) * ((times_ns - NIGHT_PULSE_NS) / NIGHT_FWHM_NS) ** 2)
    return laser_calibration(instrument, pulse)
