"""Host software of Hueflight: from photon codes to depth and reflectance in every band."""

from hueflight.errors import HueflightError
from hueflight.instrument import Instrument

__all__ = ["HueflightError", "Instrument"]
