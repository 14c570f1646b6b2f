# SPDX-License-Identifier: Apache-2.0
"""How exact the live picture becomes while photons add up, and how it follows what moves.

    python tools/bench/gathering.py [--write]

The pictures are made as in the daemon, from simulated histograms with photons of their own. The
first part shows the scene of the paper's Fig. 1, still, at 480 frames per second; deviations are
from the scene's true depth. In the second part, a square of 24 × 24 pixels at 0.8 m moves across a
wall at 1 m by 12 pixels after every ten pictures.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hueflight as hf
from hueflight import simulator
from hueflight.acquisition.snapshot import LiveBlock
from hueflight.daemon.gathered_window import GatheredWindow
from hueflight.daemon.incremental_fitter import IncrementalFitter

RATE_HZ, BLOCK = 480, 48  # frames per second, and per picture
REFERENCE_FRAMES = 65_000  #: as the simulated camera of the daemon
RESULT = Path(__file__).resolve().parents[2] / "docs" / "results" / "gathering.inc"


def probabilities(instrument: hf.Instrument, name: str, **options: Any) -> NDArray[np.float64]:
    """Probability of each code in each pixel, (row, col, code)."""
    scene = simulator.scene(name, instrument, **options)
    rates = simulator.expected_rates(scene, instrument, simulator.SimulationSettings())
    return np.asarray(simulator.code_probabilities(rates), np.float64)


class LivePictures:
    """Pictures of histograms that are drawn from probabilities, made as the daemon makes them."""

    def __init__(self, calibration: Any, seed: int) -> None:
        self._window = GatheredWindow(calibration.instrument, np.inf, RATE_HZ)
        self._fitter = IncrementalFitter(threads=2)
        self._calibration = calibration
        self._rng = np.random.default_rng(seed)

    def next(self, chances: NDArray[np.float64], frames: int = BLOCK) -> Any:
        """Return the next picture."""
        counts = self._rng.poisson(chances * frames).astype(np.uint16)
        counts[..., 0] = frames - np.minimum(counts[..., 1:].sum(axis=-1), frames)
        block: Any = SimpleNamespace(counts={0: counts}, frames=frames)
        instrument = self._calibration.instrument
        self._window.add(LiveBlock(block, 0.0, "scene", 1, instrument, lambda: None))
        return self._fitter.fit(
            self._window.histogram(), self._calibration, self._window.frames_by_pixel
        )


def still(calibration: Any, chances: NDArray[np.float64], depth: NDArray[np.float64]) -> list[str]:
    """Deviation of depth after some times."""
    pictures, rows, at_s, image = LivePictures(calibration, 1), [], 0.0, None
    for until_s, blocks in ((1, 10), (10, 90), (60, 50)):
        for _ in range(blocks):
            image = pictures.next(chances, round((until_s - at_s) * RATE_HZ / blocks))
        at_s = until_s
        assert image is not None
        found, std = image["depth"].values, image["depth_std"].values
        known = np.isfinite(found) & np.isfinite(depth)
        flags = image["quality"].values
        plain = known & ((flags | int(hf.Quality.SKIPPED)) == int(hf.Quality.SKIPPED))
        ratio = np.diff(np.percentile((found - depth)[plain] / std[plain], [15.87, 84.13]))[0] / 2
        median = 100 * np.median(np.abs(found - depth)[known])
        stated = 100 * np.median(std[known])
        rows.append(
            f"| {until_s} s | {known.mean():.2f} | {median:.2f} cm | {stated:.2f} cm "
            f"| {ratio:.2f} |"
        )
    return [
        "| photons add up for | pixels with depth | median deviation | stated | real / stated |",
        "| --- | --- | --- | --- | --- |",
        *rows,
    ]


def moving(calibration: Any, wall: NDArray[np.float64], near: NDArray[np.float64]) -> list[str]:
    """Median depth where the square is, picture by picture after it has moved."""
    pictures = LivePictures(calibration, 2)
    found: list[list[tuple[float, float]]] = []
    for step in range(6):
        place = (slice(84, 108), slice(10 + 12 * step, 34 + 12 * step))
        left = (slice(84, 108), slice(10 + 12 * (step - 1), 10 + 12 * step))
        chances = wall.copy()
        chances[place] = near[place]
        depths = [pictures.next(chances)["depth"].values for _ in range(10)]
        if step:
            found.append([(np.nanmedian(d[place]), np.nanmedian(d[left])) for d in depths])
    medians = np.median(found, axis=0)
    return [
        "| picture after the move | depth where the square is | where it was |",
        "| --- | --- | --- |",
        *(f"| {n + 1} | {medians[n, 0]:.2f} m | {medians[n, 1]:.2f} m |" for n in (0, 1, 2, 9)),
    ]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--write", action="store_true", help=f"also write {RESULT.name}")
    wanted = parser.parse_args()
    instrument = hf.Instrument.load("paper")
    reference = simulator.simulate_capture("reference", instrument, frames=REFERENCE_FRAMES, seed=5)
    calibration = hf.calibrate(reference, instrument, distance=0.4)
    depth = simulator.scene("fig1", instrument).depth
    lines = still(calibration, probabilities(instrument, "fig1"), depth)
    lines.append("")
    wall = probabilities(instrument, "plane", distance=1.0)
    lines += moving(calibration, wall, probabilities(instrument, "plane", distance=0.8))
    text = "\n".join(["`python tools/bench/gathering.py`", "", *lines]) + "\n"
    print(text)
    if wanted.write:
        RESULT.write_text(text)


if __name__ == "__main__":
    main()
