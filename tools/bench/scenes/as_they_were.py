# SPDX-License-Identifier: Apache-2.0
"""Whether data that obey the model are reconstructed as before, and what the tests cost."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path

import accuracy
import numpy as np
from _trials import COLOURS, Cell
from acceptance import Row
from outside_model import amplitudes, calibrated, drawn, expected

import hueflight as hf
from hueflight.reconstruction import Skips

GRID = Path(__file__).parents[3] / "docs" / "results" / "accuracy-grid.inc"
PIXELS = 4096
TAIL_NS = 3.0
REPEATS = 15


def rows(quick: bool) -> Iterator[Row]:
    """Cells of the page on accuracy measured again, and the time of the tests of the fit."""
    yield _cells(quick)
    yield _cost(quick)


def _cells(quick: bool) -> Row:
    """Largest growth of an entry of the page; the largest of four colors is noisy by 2 %."""
    page = _page(TAIL_NS)
    photons = (620.0,) if quick else (50.0, 200.0, 620.0, 10_000.0)
    grid = accuracy._grid(photons, (0.1, 1.0), (TAIL_NS,))
    found = accuracy._run([Cell(*cell, accuracy.WIDTH_NS) for cell in grid], PIXELS)
    growth = {}
    for cell in found:
        place = (cell.photons, cell.background)
        worst = max(found[Cell(color, *place, TAIL_NS, accuracy.WIDTH_NS)].depth_ratio
                    for color in COLOURS)  # fmt: skip
        growth[place] = worst / page[place] - 1
    place = max(growth, key=lambda one: growth[one])
    return Row(
        f"{len(growth)} entries of the page on accuracy measured again: largest growth of RMSE ÷ "
        "bound",
        f"{growth[place]:+.1%} ({place[0]:g} photons, background {place[1]:g}:1)",
        "≤ 5 %", "0", growth[place] <= 0.05,
    )  # fmt: skip


def _page(tail_ns: float) -> dict[tuple[float, float], float]:
    """RMSE ÷ bound of the page by photons and background."""
    text = GRID.read_text().partition(f"Tail {tail_ns:g} ns:")[2].partition("Tail ")[0]
    head, _, *lines = [line for line in text.splitlines() if line.startswith("|")]
    backgrounds = [float(found) for found in re.findall(r"background ([0-9.]+):1", head)]
    entries = {}
    for line in lines:
        photons, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        for background, cell in zip(backgrounds, cells, strict=True):
            entries[float(photons), background] = float(cell.split(" ")[0])
    return entries


def _cost(quick: bool) -> Row:
    size = (64, 64) if quick else (192, 128)
    calibration = calibrated(*size)
    mean = np.ones((*size, 1)) * expected(1.3, amplitudes(np.ones(9), 620), 62)
    counts = drawn(mean, np.random.default_rng(1))
    skips = {"with": Skips(), "without": Skips(assessment=False)}
    seconds = dict.fromkeys(skips, np.inf)
    for _ in range(REPEATS):  # in turn; processor time, as other programs may run
        for name, chosen in skips.items():
            start = time.process_time()
            hf.reconstruct(counts, calibration, skips=chosen)
            seconds[name] = min(seconds[name], time.process_time() - start)
    more = seconds["with"] / seconds["without"] - 1
    return Row(
        "cost of the goodness of fit on a clean scene of 620 photons, of the time of `joint`",
        f"{more:.1%}", "≤ 15 %", "≤ 6 %", more <= 0.15,
    )  # fmt: skip
