# SPDX-License-Identifier: Apache-2.0
"""Simulated instrument: scenes with a known truth, and captures of them with photon noise.

The probability of every code is computed exactly from the light budget, and codes, packets or
histograms are drawn from it. `docs/simulator.md` describes the model.

>>> import hueflight as hf
>>> paper = hf.Instrument.load("paper")
>>> counts = simulate_histogram(scene("fig1", paper), paper, frames=100, seed=1)
>>> counts.shape, int(counts[0, 0].sum())  # every exposure gives one code, empty ones code 0
((192, 128, 512), 100)
"""

from hueflight.simulator.effects import EFFECTS, Effects, NamedEffect
from hueflight.simulator.ground_truth import EffectTruth, effect_truth, write_truth
from hueflight.simulator.light import Rates, expected_rates
from hueflight.simulator.light_budget import radiometric_detections, white_photons
from hueflight.simulator.named_scenes import SCENES, NamedScene, scene, scenes
from hueflight.simulator.probabilities import code_probabilities, probability_tiles
from hueflight.simulator.sampling import simulate_codes, simulate_histogram
from hueflight.simulator.scene import NOTHING, Scene, Truth
from hueflight.simulator.settings import Pixels, SimulationSettings, pixels, time_bins
from hueflight.simulator.simulated_captures import (
    CAPTURES,
    CaptureKind,
    Exposure,
    exposures,
    simulate_capture,
    simulate_packets,
)

__all__ = [
    "CAPTURES",
    "EFFECTS",
    "NOTHING",
    "SCENES",
    "CaptureKind",
    "EffectTruth",
    "Effects",
    "Exposure",
    "NamedEffect",
    "NamedScene",
    "Pixels",
    "Rates",
    "Scene",
    "SimulationSettings",
    "Truth",
    "code_probabilities",
    "effect_truth",
    "expected_rates",
    "exposures",
    "pixels",
    "probability_tiles",
    "radiometric_detections",
    "scene",
    "scenes",
    "simulate_capture",
    "simulate_codes",
    "simulate_histogram",
    "simulate_packets",
    "time_bins",
    "white_photons",
    "write_truth",
]
