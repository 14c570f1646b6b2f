# SPDX-License-Identifier: Apache-2.0
"""Abundances of twenty materials in scenes that were simulated and reconstructed."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import msgspec
import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight import simulator
from hueflight.analysis import SpectralLibrary, unmix

ROWS, COLS_EACH, MATERIALS = 12, 2, 20
WITHIN = {1: 0.6827, 2: 0.9545}


@pytest.fixture(scope="module")
def small() -> hf.Instrument:
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=ROWS, cols=COLS_EACH * MATERIALS)
    return paper.replace(sensor=sensor)


@pytest.fixture(scope="module")
def library() -> SpectralLibrary:
    chart = SpectralLibrary.colorchecker()
    return chart.select(chart.names[:MATERIALS])


@pytest.fixture(scope="module")
def calibration_of_small(small: hf.Instrument) -> hf.Calibration:
    reference = simulator.simulate_capture("reference", small, frames=40000, seed=1)
    return hf.calibrate(reference, small, distance=0.4)


def most_different(library: SpectralLibrary, instrument: hf.Instrument, first: int) -> list[int]:
    """A material and the two others from which these bands tell it best."""
    bands = library.in_bands(instrument).values
    shapes = bands / np.linalg.norm(bands, axis=1, keepdims=True)
    others = [number for number in range(MATERIALS) if number != first]
    sets = ([first, *pair] for pair in combinations(others, 2))
    return min(sets, key=lambda chosen: np.linalg.cond(shapes[chosen]))


def pulls(
    image: xr.Dataset, instrument: hf.Instrument, library: SpectralLibrary, sets: list[list[int]]
) -> np.ndarray:
    """Errors of all known abundances, each of which is 1/3 in truth, in stated deviations."""
    found = []
    for number, chosen in enumerate(sets):
        part = image.isel(col=slice(COLS_EACH * number, COLS_EACH * (number + 1)))
        few = library.select([library.names[entry] for entry in chosen])
        mixture = unmix(part.reflectance, part.reflectance_std, few, instrument)
        pull = ((mixture.abundance - 1 / 3) / mixture.abundance_std).values.reshape(-1, 3)
        found.append(pull[np.isfinite(pull).all(axis=1)])
    return np.concatenate(found)


@pytest.mark.parametrize("frames", [1000, 4000, 20000])
def test_intervals_of_twenty_materials_cover_the_truth(
    small: hf.Instrument,
    library: SpectralLibrary,
    calibration_of_small: hf.Calibration,
    frames: int,
) -> None:
    """Light, sensor, noise and fit are simulated; each material is mixed with two others.

    Of some 470 pixels with three dependent entries each, a share has a deviation of 0.022 (68 %)
    and 0.0096 (95 %) at most; 4 of them, false alarm 3e-5 each. Intervals may be too wide, because
    the bound at 0 makes the estimates better than the stated deviations.
    """
    sets = [most_different(library, small, number) for number in range(MATERIALS)]
    spectra = np.array([library.reflectance[chosen].mean(axis=0) for chosen in sets])
    flat = simulator.scene("plane", small, distance=0.4)
    surface = np.broadcast_to(np.repeat(np.arange(MATERIALS), COLS_EACH), flat.shape)
    scene = replace(
        flat, surface=surface.copy(), surfaces=library.names, spectra=spectra, regions={}
    )
    counts = simulator.simulate_histogram(scene, small, frames=frames, seed=frames)
    image = hf.reconstruct(counts, calibration_of_small)
    away = np.abs(pulls(image, small, library, sets))
    assert len(away) > 0.95 * ROWS * COLS_EACH * MATERIALS
    for sigmas, share in WITHIN.items():
        covered = (away <= sigmas).mean()
        slack = 4 * np.sqrt(share * (1 - share) / len(away))
        assert share - slack <= covered <= share + slack + 0.06 * (sigmas == 1) + 0.01
