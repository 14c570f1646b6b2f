"""Calibration: windows, gains, delays and defects of one instrument, from known targets."""

from hueflight.calibration.calibration import Calibration, calibrate, measured_widths
from hueflight.calibration.windows import PulseWindow, find_windows, window_sums

__all__ = [
    "Calibration",
    "PulseWindow",
    "calibrate",
    "find_windows",
    "measured_widths",
    "window_sums",
]
