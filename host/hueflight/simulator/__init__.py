"""The instrument, simulated: scenes, light budget, exact code probabilities, two samplers."""

from hueflight.simulator.captures import (
    CAPTURES,
    Exposure,
    exposures,
    simulate_capture,
    simulate_packets,
)
from hueflight.simulator.catalog import SCENES, scene, scenes
from hueflight.simulator.light import Rates, expected_rates, radiometric_detections, white_photons
from hueflight.simulator.probabilities import code_probabilities, probability_tiles
from hueflight.simulator.sampling import simulate_codes, simulate_histogram
from hueflight.simulator.scene import NOTHING, Scene, Truth
from hueflight.simulator.settings import Pixels, SimulationSettings, pixels, time_bins

__all__ = [
    "CAPTURES",
    "NOTHING",
    "SCENES",
    "Exposure",
    "Pixels",
    "Rates",
    "Scene",
    "SimulationSettings",
    "Truth",
    "code_probabilities",
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
]
