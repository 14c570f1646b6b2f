"""Host software of Hueflight: from photon codes to depth and reflectance in every band."""

from hueflight.calibration import Calibration, calibrate
from hueflight.color import color_picture
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.bounds import depth_bound, reflectance_bound
from hueflight.reconstruction.interleaved import reconstruct_interleaved
from hueflight.reconstruction.reconstruct import reconstruct
from hueflight.reconstruction.uncertainty import reflectance_interval

__all__ = [
    "Calibration",
    "HueflightError",
    "Instrument",
    "calibrate",
    "color_picture",
    "depth_bound",
    "reconstruct",
    "reconstruct_interleaved",
    "reflectance_bound",
    "reflectance_interval",
]
