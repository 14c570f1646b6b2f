"""Analysis of images: regions, profiles, differences, series, libraries, light, transmittance."""

from hueflight.analysis.comparison import compare, spectral_angle
from hueflight.analysis.flat_field import flatten, illumination_pattern
from hueflight.analysis.library import SpectralLibrary, match
from hueflight.analysis.profiles import profile
from hueflight.analysis.regions import parse_region, region_spectra, reliable
from hueflight.analysis.series import stack, trend
from hueflight.analysis.transmittance import transmittance
from hueflight.color.color_difference import delta_e_2000, lab

__all__ = [
    "SpectralLibrary",
    "compare",
    "delta_e_2000",
    "flatten",
    "illumination_pattern",
    "lab",
    "match",
    "parse_region",
    "profile",
    "region_spectra",
    "reliable",
    "spectral_angle",
    "stack",
    "transmittance",
    "trend",
]
