"""Calibration: windows, waveforms, gains, delays and defects of one instrument."""

from hueflight.calibration.calibration import Calibration
from hueflight.calibration.procedure import calibrate, measured_widths
from hueflight.calibration.pulse_windows import PulseWindow, find_windows, window_sums
from hueflight.model.waveforms import Templates

__all__ = [
    "Calibration",
    "PulseWindow",
    "Templates",
    "calibrate",
    "find_windows",
    "measured_widths",
    "window_sums",
]
