# SPDX-License-Identifier: Apache-2.0
"""From bands to spectra and colours, with the smoothing by the LEDs' spectral widths undone."""

from hueflight.color.observer import srgb_of, tristimulus
from hueflight.color.picture import color_picture, in_color
from hueflight.color.recovery import SpectralModel

__all__ = ["SpectralModel", "color_picture", "in_color", "srgb_of", "tristimulus"]
