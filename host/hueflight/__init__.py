"""Host software of Hueflight: from photon codes to depth and reflectance in every band."""

from hueflight.calibration import Calibration, calibrate
from hueflight.errors import HueflightError
from hueflight.instrument import Instrument
from hueflight.reconstruction.alternated import reconstruct_alternated
from hueflight.reconstruction.bounds import depth_bound, reflectance_bound
from hueflight.reconstruction.reconstruct import reconstruct

__all__ = [
    "Calibration",
    "HueflightError",
    "Instrument",
    "calibrate",
    "depth_bound",
    "reconstruct",
    "reconstruct_alternated",
    "reflectance_bound",
]
