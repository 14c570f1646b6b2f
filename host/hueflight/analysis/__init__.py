"""What people ask of images: regions, cuts, differences, series, transmittance."""

from hueflight.analysis.comparison import compare, spectral_angle
from hueflight.analysis.profiles import profile
from hueflight.analysis.regions import parse_region, region_spectra, reliable
from hueflight.analysis.series import stack, trend
from hueflight.analysis.transmittance import transmittance

__all__ = [
    "compare",
    "parse_region",
    "profile",
    "region_spectra",
    "reliable",
    "spectral_angle",
    "stack",
    "transmittance",
    "trend",
]
