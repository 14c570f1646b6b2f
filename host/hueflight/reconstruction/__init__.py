# SPDX-License-Identifier: Apache-2.0
"""From histograms to images: depth, reflectance, uncertainty and the limits of all three.

The names below are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from hueflight.lazy import lazy_names

if TYPE_CHECKING:  # for type checkers and editors; `_HOME` says the same at run time
    from hueflight.calibration.suspects import Suspect
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
    from hueflight.reconstruction.image_check import ImageCheck, check_image
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
    from hueflight.reconstruction.sums.delay_tables import code_offsets
    from hueflight.reconstruction.sums.design import SumsDesign, design_sums, information_kept
    from hueflight.reconstruction.sums.method import reconstruct_sums
    from hueflight.reconstruction.sums.recorded import describe_sums, reconstruct_recorded_sums
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
    "SumsDesign": "hueflight.reconstruction.sums.design",
    "Suspect": "hueflight.calibration.suspects",
    "Video": "hueflight.reconstruction.video",
    "check_image": "hueflight.reconstruction.image_check",
    "code_offsets": "hueflight.reconstruction.sums.delay_tables",
    "correct_drift": "hueflight.reconstruction.departures",
    "depth_bound": "hueflight.reconstruction.bounds",
    "describe_sums": "hueflight.reconstruction.sums.recorded",
    "design_sums": "hueflight.reconstruction.sums.design",
    "expected_shares": "hueflight.reconstruction.bounds",
    "find_method": "hueflight.reconstruction.methods",
    "find_mixed": "hueflight.reconstruction.mixed_pixels",
    "fisher_information": "hueflight.reconstruction.bounds",
    "flag_mixed": "hueflight.reconstruction.separation",
    "frames_needed": "hueflight.reconstruction.stopping",
    "information": "hueflight.reconstruction.bounds",
    "information_kept": "hueflight.reconstruction.sums.design",
    "reconstruct": "hueflight.reconstruction.entry_point",
    "reconstruct_interleaved": "hueflight.reconstruction.interleaved",
    "reconstruct_packets": "hueflight.reconstruction.entry_point",
    "reconstruct_recorded_sums": "hueflight.reconstruction.sums.recorded",
    "reconstruct_sums": "hueflight.reconstruction.sums.method",
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
    "SumsDesign",
    "Suspect",
    "Video",
    "check_image",
    "code_offsets",
    "correct_drift",
    "depth_bound",
    "describe_sums",
    "design_sums",
    "expected_shares",
    "find_method",
    "find_mixed",
    "fisher_information",
    "flag_mixed",
    "frames_needed",
    "information",
    "information_kept",
    "reconstruct",
    "reconstruct_interleaved",
    "reconstruct_packets",
    "reconstruct_recorded_sums",
    "reconstruct_sums",
    "reflectance_bound",
    "reflectance_interval",
    "register",
    "seen_enough",
    "share_known",
    "with_floor",
]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
