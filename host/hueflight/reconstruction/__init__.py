# SPDX-License-Identifier: Apache-2.0
"""From histograms to images: depth, reflectance, uncertainty and the limits of all three.

The names below are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from hueflight.lazy import lazy_names

if TYPE_CHECKING:  # for type checkers and editors; `_HOME` says the same at run time
    from hueflight.reconstruction.bounds import (
        depth_bound,
        expected_shares,
        fisher_information,
        information,
        reflectance_bound,
    )
    from hueflight.reconstruction.departures import Correction, correct_drift, with_floor
    from hueflight.reconstruction.entry_point import reconstruct, reconstruct_packets
    from hueflight.reconstruction.estimates import Estimates
    from hueflight.reconstruction.image_check import ImageCheck, Suspect, check_image
    from hueflight.reconstruction.inputs import PreparedHistogram
    from hueflight.reconstruction.interleaved import reconstruct_interleaved
    from hueflight.reconstruction.methods import METHODS, Estimator, find_method, register
    from hueflight.reconstruction.mixed_pixels import (
        MixedPixels,
        find_mixed,
    )
    from hueflight.reconstruction.options import (
        BINDING_OPTIONS,
        DEFAULT_SKIPS,
        NO_SKIPS,
        EstimatorOptions,
        Region,
        Skips,
    )
    from hueflight.reconstruction.quality import Quality
    from hueflight.reconstruction.separation import flag_mixed
    from hueflight.reconstruction.stopping import StopRule, frames_needed, seen_enough, share_known
    from hueflight.reconstruction.uncertainty import reflectance_interval
    from hueflight.reconstruction.video import Video

#: module of each public name
_HOME = {
    "BINDING_OPTIONS": "hueflight.reconstruction.options",
    "Correction": "hueflight.reconstruction.departures",
    "DEFAULT_SKIPS": "hueflight.reconstruction.options",
    "Estimates": "hueflight.reconstruction.estimates",
    "Estimator": "hueflight.reconstruction.methods",
    "EstimatorOptions": "hueflight.reconstruction.options",
    "ImageCheck": "hueflight.reconstruction.image_check",
    "METHODS": "hueflight.reconstruction.methods",
    "MixedPixels": "hueflight.reconstruction.mixed_pixels",
    "NO_SKIPS": "hueflight.reconstruction.options",
    "PreparedHistogram": "hueflight.reconstruction.inputs",
    "Quality": "hueflight.reconstruction.quality",
    "Region": "hueflight.reconstruction.options",
    "Skips": "hueflight.reconstruction.options",
    "StopRule": "hueflight.reconstruction.stopping",
    "Suspect": "hueflight.reconstruction.image_check",
    "Video": "hueflight.reconstruction.video",
    "check_image": "hueflight.reconstruction.image_check",
    "correct_drift": "hueflight.reconstruction.departures",
    "depth_bound": "hueflight.reconstruction.bounds",
    "expected_shares": "hueflight.reconstruction.bounds",
    "find_method": "hueflight.reconstruction.methods",
    "find_mixed": "hueflight.reconstruction.mixed_pixels",
    "fisher_information": "hueflight.reconstruction.bounds",
    "flag_mixed": "hueflight.reconstruction.separation",
    "frames_needed": "hueflight.reconstruction.stopping",
    "information": "hueflight.reconstruction.bounds",
    "reconstruct": "hueflight.reconstruction.entry_point",
    "reconstruct_interleaved": "hueflight.reconstruction.interleaved",
    "reconstruct_packets": "hueflight.reconstruction.entry_point",
    "reflectance_bound": "hueflight.reconstruction.bounds",
    "reflectance_interval": "hueflight.reconstruction.uncertainty",
    "register": "hueflight.reconstruction.methods",
    "seen_enough": "hueflight.reconstruction.stopping",
    "share_known": "hueflight.reconstruction.stopping",
    "with_floor": "hueflight.reconstruction.departures",
}

__all__ = [
    "BINDING_OPTIONS",
    "DEFAULT_SKIPS",
    "METHODS",
    "NO_SKIPS",
    "Correction",
    "Estimates",
    "Estimator",
    "EstimatorOptions",
    "ImageCheck",
    "MixedPixels",
    "PreparedHistogram",
    "Quality",
    "Region",
    "Skips",
    "StopRule",
    "Suspect",
    "Video",
    "check_image",
    "correct_drift",
    "depth_bound",
    "expected_shares",
    "find_method",
    "find_mixed",
    "fisher_information",
    "flag_mixed",
    "frames_needed",
    "information",
    "reconstruct",
    "reconstruct_interleaved",
    "reconstruct_packets",
    "reflectance_bound",
    "reflectance_interval",
    "register",
    "seen_enough",
    "share_known",
    "with_floor",
]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
