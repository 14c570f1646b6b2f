# SPDX-License-Identifier: Apache-2.0
"""Pile-up within a period, where an exposure is a single period: correction against simulation."""

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.batch import summarize
from hueflight.model.pileup import coates_correction, photons_per_period
from hueflight.reconstruction.video import Video
from hueflight.simulator import (
    SimulationSettings,
    code_probabilities,
    expected_rates,
    scene,
    simulate_histogram,
)

FRAMES = 50_000
DEPTH_M = 0.8
OCCUPANCY = 0.9


@pytest.fixture(scope="module")
def single_period(small):
    """Instrument whose description states a period but no exposure time."""
    instrument = small(rows=12, cols=12)
    return instrument.replace(sensor=msgspec.structs.replace(instrument.sensor, exposure_ms=None))


@pytest.fixture(scope="module")
def calibration(single_period):
    """Calibration in light so dim that pile-up plays no part, of 45 000 photons per pixel."""
    target = scene("plane", single_period, distance=0.4)
    dim = SimulationSettings.ideal(white_detections=0.4**2 * 0.01)
    counts = simulate_histogram(target, single_period, frames=4_500_000, settings=dim, seed=1)
    return hf.calibrate(counts, single_period, distance=0.4)


@pytest.fixture(scope="module")
def bright(single_period):
    """Scene and settings in which nine of ten exposures hold a photon."""
    settings = SimulationSettings.ideal(white_detections=-np.log(1 - OCCUPANCY) * DEPTH_M**2)
    return scene("plane", single_period, distance=DEPTH_M), settings


@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_single_period_is_corrected(
    request, single_period, calibration, bright, monkeypatch, backend
):
    if backend == "c":
        request.getfixturevalue("compiled_fit")
    monkeypatch.setenv("HUEFLIGHT_KERNELS", backend)
    counts = simulate_histogram(bright[0], single_period, frames=FRAMES, settings=bright[1], seed=2)
    assert 1 - counts[..., 0].mean() / FRAMES == pytest.approx(OCCUPANCY, abs=0.01)

    def bias(**options):
        image = hf.reconstruct(counts, calibration, **options)
        bands = image["reflectance"].values.mean(axis=(0, 1))
        return abs(image["depth"].values.mean() - DEPTH_M), np.abs(bands / bands.mean() - 1).max()

    depth_m, ratio = bias()
    assert depth_m < 1e-3
    assert ratio < 0.01
    depth_m, ratio = bias(pileup_correction=False)
    assert depth_m > 2e-3  # it is needed
    assert ratio > 0.1


def test_published_method_is_corrected_too(single_period, calibration, bright):
    counts = simulate_histogram(bright[0], single_period, frames=FRAMES, settings=bright[1], seed=2)
    image = hf.reconstruct(counts, calibration, method="paper")
    bands = image["reflectance"].values.mean(axis=(0, 1))
    # without it, depth is off by 8 cm and the bands by more than a factor of 2
    assert abs(image["depth"].values.mean() - DEPTH_M) < 2e-3
    assert np.abs(bands / bands.mean() - 1).max() < 0.01


@pytest.mark.parametrize("occupancy", [0.1, 0.9, 0.999])
def test_correction_restores_the_shape_of_the_light(single_period, occupancy):
    layout = scene("plane", single_period, distance=DEPTH_M)
    white = -np.log(1 - occupancy) * DEPTH_M**2
    light = {}
    for pile_up in (True, False):
        settings = SimulationSettings.ideal(white_detections=white, pile_up=pile_up)
        probabilities = code_probabilities(expected_rates(layout, single_period, settings))
        light[pile_up] = single_period.time_bins().in_time_order(probabilities.astype(np.float64))
    hits = light[True].sum(axis=-1) * 1e6
    rates = photons_per_period(hits, np.full(hits.shape, 1e6), single_period)
    corrected = coates_correction(light[True], rates)
    peak = light[False].max()
    np.testing.assert_allclose(corrected, light[False], atol=2e-3 * peak)
    assert np.abs(light[True] - light[False]).max() > 0.02 * peak  # it is needed


def of_video(counts, calibration, frames):
    return Video(calibration).next(counts, frames=frames)


@pytest.mark.parametrize("made_by", [hf.reconstruct, of_video])
def test_an_unknown_number_of_exposures_is_stated(small, made_by):
    scanner = small(rows=4, cols=4, code_zero="bin", exposure_ms=None)
    settings = SimulationSettings.ideal(white_detections=1.0)  # at 1 m
    target = scene("plane", scanner, distance=0.8)
    reference, counts = (
        simulate_histogram(target, scanner, frames=frames, settings=settings, seed=frames)
        for frames in (20_000, 10_000)
    )
    assert counts.sum(axis=-1).mean() > 0.7 * 10_000  # pile-up matters
    plain = hf.calibrate(reference, scanner, distance=0.8)
    stated = hf.calibrate(reference, scanner, distance=0.8, frames=20_000)

    def bands(calibration, frames, text):
        image = made_by(counts, calibration, frames=frames)
        exposures = image.attrs["exposures"]
        assert exposures.startswith(text)
        assert summarize(image).get("exposures", "known") == exposures
        return image["reflectance"].mean(("row", "col")).values

    np.testing.assert_allclose(bands(stated, 10_000, "known"), 1, atol=0.04)
    assumed = bands(stated, None, "unknown: taken to be as many")
    np.testing.assert_allclose(assumed, bands(stated, 20_000, "known"))
    np.testing.assert_allclose(bands(plain, None, "unknown for the reference"), 0.5, atol=0.02)
    bands(plain, 10_000, "unknown for the reference")
