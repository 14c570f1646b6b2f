# SPDX-License-Identifier: Apache-2.0
"""Unmixing: its time beside that of the joint fit, and how often intervals hold the truth.

    python3 tools/dev.py bench materials [--write]

Scenes are simulated with all of their light and noise, and reconstructed. In each, twenty
materials of a ColorChecker stand in stripes, each mixed in equal parts with two others, or in
random parts with three neighbors in the chart.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np
import xarray as xr
from _measure import best_of, table
from numpy.typing import NDArray

import hueflight as hf
from hueflight import simulator
from hueflight.analysis import SpectralLibrary, unmix

MATERIALS, FRAMES = 20, (1000, 4000, 20000)
PAGE = Path(__file__).resolve().parents[2] / "docs" / "benchmarks.md"
instrument = hf.Instrument.load("paper")
CHART = SpectralLibrary.colorchecker()


@dataclass(frozen=True)
class Mixtures:
    """Which entries of the chart each stripe consists of, and their abundances."""

    sets: list[list[int]]
    abundances: NDArray[np.float64]  # (stripe, entry)


def distinct() -> Mixtures:
    """Each material with the two others from which the bands tell it best, in equal parts."""
    bands = CHART.in_bands(instrument).values[:MATERIALS]
    shapes = bands / np.linalg.norm(bands, axis=1, keepdims=True)

    def best(first: int) -> list[int]:
        others = [number for number in range(MATERIALS) if number != first]
        sets = ([first, *pair] for pair in combinations(others, 2))
        return min(sets, key=lambda chosen: float(np.linalg.cond(shapes[chosen])))

    return Mixtures([best(n) for n in range(MATERIALS)], np.full((MATERIALS, 3), 1 / 3))


def similar() -> Mixtures:
    """Each material with three others of the chart as they come, in random parts."""
    sets = [[(n + step) % MATERIALS for step in (0, 3, 7, 12)] for n in range(MATERIALS)]
    parts = np.random.default_rng(3).dirichlet(np.ones(4), MATERIALS)
    return Mixtures(sets, parts)


def scene_of(mixtures: Mixtures) -> tuple[simulator.Scene, NDArray[np.intp]]:
    """The stripes side by side, and the number of the stripe of each column."""
    rows, cols = instrument.image_shape
    stripe = np.arange(cols) * MATERIALS // cols
    spectra = [
        parts @ CHART.reflectance[chosen]
        for chosen, parts in zip(mixtures.sets, mixtures.abundances, strict=True)
    ]
    flat = simulator.scene("plane", instrument, distance=0.4)
    surface = np.broadcast_to(stripe, (rows, cols)).copy()
    names = CHART.names[:MATERIALS]
    return replace(
        flat, surface=surface, surfaces=names, spectra=np.array(spectra), regions={}
    ), stripe


def pulls(image: xr.Dataset, mixtures: Mixtures, stripe: NDArray[np.intp]) -> NDArray[np.float64]:
    """Errors of known abundances in stated deviations."""
    found = []
    for number, chosen in enumerate(mixtures.sets):
        part = image.isel(col=stripe == number)
        few = CHART.select([CHART.names[entry] for entry in chosen])
        mixture = unmix(part.reflectance, part.reflectance_std, few, instrument)
        error = mixture.abundance.values - mixtures.abundances[number]
        found.append((error / mixture.abundance_std.values).ravel())
    joined = np.concatenate(found)
    return joined[np.isfinite(joined)]


def coverage(calibration: hf.Calibration) -> str:
    rows = []
    for name, mixtures in (("distinct", distinct()), ("similar", similar())):
        scene, stripe = scene_of(mixtures)
        for frames in FRAMES:
            counts = simulator.simulate_histogram(scene, instrument, frames=frames, seed=frames)
            away = np.abs(pulls(hf.reconstruct(counts, calibration), mixtures, stripe))
            shares = [f"{100 * (away <= limit).mean():.1f} %" for limit in (1, 2)]
            rows.append([name, f"{frames}", f"{len(away)}", *shares])
    head = ["materials", "frames", "abundances", "within 1 σ (68.3 %)", "within 2 σ (95.4 %)"]
    return table(head, rows)


def times(calibration: hf.Calibration) -> str:
    scene, _ = scene_of(similar())
    counts = simulator.simulate_histogram(scene, instrument, frames=1000, seed=1)
    image = hf.reconstruct(counts, calibration)
    libraries = {
        f"unmixing, {len(names)} materials": CHART.select(names)
        for names in (
            ("red", "green", "blue"),
            ("red", "green", "blue", "yellow", "white"),
        )
    }
    contenders: dict[str, Callable[[], object]] = {
        "joint fit": lambda: hf.reconstruct(counts, calibration)
    }
    for name, few in libraries.items():
        contenders[name] = partial(unmix, image.reflectance, image.reflectance_std, few, instrument)
    seconds = best_of(contenders, rounds=7)
    at_bound = {
        name: (unmix(image.reflectance, image.reflectance_std, few, instrument).abundance == 0)
        for name, few in libraries.items()
    }
    rows = [
        [
            name,
            f"{taken / seconds['joint fit']:.2f}",
            f"{100 * at_bound[name].any('entry').mean().item():.0f} %" if name in at_bound else "",
        ]
        for name, taken in seconds.items()
    ]
    return table(["192 × 128 pixels", "× joint fit", "pixels with an abundance of 0"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"fill the block of {PAGE.name}")
    arguments = parser.parse_args()
    reference = simulator.simulate_capture("reference", instrument, frames=40000, seed=1)
    calibration = hf.calibrate(reference, instrument, distance=0.4)
    shown = f"{times(calibration)}\n{coverage(calibration)}"
    print(shown)
    if arguments.write:
        begin, end = "<!-- materials -->\n", "<!-- end of materials -->"
        text = PAGE.read_text("utf-8")
        block = f"{begin}\n{shown.strip()}\n\n{end}"
        PAGE.write_text(re.sub(f"{begin}.*?{end}", lambda _: block, text, flags=re.S), "utf-8")


if __name__ == "__main__":
    main()
