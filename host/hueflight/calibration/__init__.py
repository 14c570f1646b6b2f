# SPDX-License-Identifier: Apache-2.0
"""Calibration: what an instrument's description can't state, measured from a known target.

`calibrate` turns captures of a flat target into a `Calibration`: pulse windows, waveforms, gains,
the delay of each pixel and its defects.
"""

from hueflight.calibration.calibration import Calibration
from hueflight.calibration.check import CalibrationCheck, check_calibration
from hueflight.calibration.procedure import calibrate, measured_widths
from hueflight.calibration.pulse_windows import find_windows
from hueflight.calibration.windows import PulseWindow, window_sums
from hueflight.model.waveforms import Templates

__all__ = [
    "Calibration",
    "CalibrationCheck",
    "PulseWindow",
    "Templates",
    "calibrate",
    "check_calibration",
    "find_windows",
    "measured_widths",
    "window_sums",
]
