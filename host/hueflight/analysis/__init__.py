# SPDX-License-Identifier: Apache-2.0
"""Analysis of images: regions, profiles, differences, series, libraries, light, transmittance."""

from hueflight.analysis.comparison import compare, spectral_angle
from hueflight.analysis.flat_field import flatten, illumination_pattern
from hueflight.analysis.indices import INDICES, SpectralIndex, normalized_difference, spectral_index
from hueflight.analysis.library import SpectralLibrary, match
from hueflight.analysis.materials import add_materials
from hueflight.analysis.profiles import profile
from hueflight.analysis.regions import parse_region, region_spectra, reliable
from hueflight.analysis.series import stack, trend
from hueflight.analysis.transmittance import transmittance
from hueflight.analysis.unmixing import unmix
from hueflight.analysis.upright import upright
from hueflight.color.color_difference import delta_e_2000, lab

__all__ = [
    "INDICES",
    "SpectralIndex",
    "SpectralLibrary",
    "add_materials",
    "compare",
    "delta_e_2000",
    "flatten",
    "illumination_pattern",
    "lab",
    "match",
    "normalized_difference",
    "parse_region",
    "profile",
    "region_spectra",
    "reliable",
    "spectral_angle",
    "spectral_index",
    "stack",
    "transmittance",
    "trend",
    "unmix",
    "upright",
]
