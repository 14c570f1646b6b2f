# SPDX-License-Identifier: Apache-2.0
"""Draw what was reported before scenes were tested, and what is reported now.

    python3 tools/dev.py bench scenes --pictures

writes `docs/images/scenes-before-after.png`. "Before" is the present fit without its tests: no
second surface, no mixed pixels, every pixel with a depth, the calibration as it was.
"""

from __future__ import annotations

from pathlib import Path
from unittest.mock import patch

import matplotlib as mpl
import numpy as np
from effects_table import SETTINGS, calibration, instrument
from numpy.typing import NDArray

import hueflight as hf
from hueflight import simulator
from hueflight.reconstruction import Skips
from hueflight.simulator import Effects

PICTURE = Path(__file__).parents[3] / "docs" / "images" / "scenes-before-after.png"
PLAIN = Skips(assessment=False)
DRIFT_PS = (-400.0, 150.0, 150.0, 0.0, 300.0, 0.0, 50.0, -400.0, 150.0)
CENTER = np.s_[28:68, 12:52]

Panel = NDArray[np.float64]
Column = tuple[str, tuple[Panel, Panel, Panel], str, tuple[float, float], str]


def draw() -> Path:
    """Draw four scenes in columns: the truth, before and after; return the path of the picture."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    columns = (_two_surfaces(), _edges(), _empty_sky(), _drift())
    figure, axes = plt.subplots(3, len(columns), figsize=(9.2, 9.4), layout="constrained")
    for column, (title, panels, label, (low, high), colors) in enumerate(columns):
        for row, (panel, name) in enumerate(zip(panels, ("true", "before", "after"), strict=True)):
            axis = axes[row, column]
            axis.imshow(panel, vmin=low, vmax=high, cmap=colors, aspect="auto")
            axis.set(xticks=[], yticks=[])
            if column == 0:
                axis.set_ylabel(name, fontsize=12)
            if row == 0:
                axis.set_title(title, fontsize=11)
        scale = axes[0, column].images[0]
        figure.colorbar(
            scale, ax=axes[:, column], location="bottom", label=label, fraction=0.03, pad=0.01
        )
    figure.savefig(PICTURE, dpi=80)
    return PICTURE


def _capture(
    seen: simulator.Scene, frames: int, settings: simulator.SimulationSettings
) -> NDArray[np.unsignedinteger]:
    return simulator.simulate_capture(
        "scene", instrument(), frames=frames, settings=settings, scene=seen, seed=9
    )


def _without_tests(
    counts: NDArray[np.unsignedinteger], region: tuple[slice, slice] | None = None
) -> Panel:
    """Depth of the present fit without its tests."""
    with patch("hueflight.reconstruction.joint.detection_threshold", lambda _range: 0.0):
        image = hf.reconstruct(
            counts, calibration(Effects()), skips=PLAIN, mixed=False, second_returns=False,
            region=region,
        )  # fmt: skip
    return image["depth"].values.astype(float)


def _two_surfaces() -> Column:
    """A dusty pane 30 cm away, and a wall behind it whose depth is wanted."""
    seen = simulator.scene("fig7", instrument(), distance=2.0)
    settings = SETTINGS.replace(effects=Effects(pane_share=0.02, pane_depth=0.3))
    counts = _capture(seen, 40_000, settings)
    before = _without_tests(counts, CENTER)
    image = hf.reconstruct(counts, calibration(Effects()), region=CENTER)
    two = (image["quality"].values & int(hf.Quality.TWO_RETURNS)) != 0
    after = np.where(two, image["second_depth"].values, np.nan)
    panels = (seen.depth[CENTER], before[CENTER], after[CENTER])
    return "wall behind a pane", panels, "depth of the wall, m", (0.3, 2.2), "viridis"


def _edges() -> Column:
    """Pixels at edges, as the distance of their depth from the nearest surface in the pixel."""
    seen = simulator.scene("fig1", instrument(), rays=4)
    counts = _capture(seen, 20_000, SETTINGS)
    depths = simulator.effect_truth(seen, instrument(), SETTINGS).depths
    image = hf.reconstruct(counts, calibration(Effects()), second_returns=False)
    std = image["depth_std"].values

    def off(depth: Panel) -> Panel:
        nearest = np.fmin.reduce(np.abs(depth - depths), axis=0)
        return np.where(std < 0.03, 100 * nearest, np.nan)

    panels = (np.zeros(depths.shape[1:]), off(_without_tests(counts)), off(image["depth"].values))
    return "edges", panels, "distance from surfaces, cm", (0.0, 10.0), "magma"


def _empty_sky() -> Column:
    """Sky of steady light behind towers."""
    seen = simulator.scene("skyline", instrument())
    settings = SETTINGS.replace(effects=Effects(sky=1.0))
    counts = _capture(seen, 6000, settings)
    image = hf.reconstruct(counts, calibration(Effects()))
    panels = (seen.depth, _without_tests(counts), image["depth"].values)
    return "empty sky", panels, "depth, m (white: none)", (0.0, 3.0), "viridis"


def _drift() -> Column:
    """A flat chart, seen with LEDs whose delays drifted."""
    seen = simulator.scene("colorchecker", instrument())
    counts = _capture(seen, 400_000, SETTINGS.replace(effects=Effects(delay_drift_ps=DRIFT_PS)))
    image = hf.reconstruct(counts, calibration(Effects()), second_returns=False)
    correction = hf.correct_drift(counts, calibration(Effects()), image)
    corrected = hf.reconstruct(counts, correction.calibration, second_returns=False)

    def off(depth: Panel) -> Panel:
        error = 1e3 * (depth - seen.depth)
        return error - np.nanmedian(error)

    panels = (
        np.zeros(seen.shape), off(_without_tests(counts)), off(corrected["depth"].values),
    )  # fmt: skip
    return "drift of the LEDs", panels, "error of depth, mm", (-25.0, 25.0), "RdBu"
