# SPDX-License-Identifier: Apache-2.0
"""Draw edges of the scene of Fig. 1 before and after mixed pixels are separated.

    python3 tools/bench/scenes/edge_picture.py

writes `docs/images/mixed-pixels.png`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import matplotlib as mpl
import numpy as np
from edges import figure_1
from outside_model import drawn

import hueflight as hf

PICTURE = Path(__file__).parents[3] / "docs" / "images" / "mixed-pixels.png"
MEDIAN_PHOTONS = 2500
LARGEST_STD_M = 0.03  #: pixels with less light are not drawn
PART = np.s_[0:96, 0:128]


def main() -> None:
    """Draw how far depth is from the nearest surface in the pixel, and which pixels are mixed."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    calibration, mean, depths, _ = figure_1(MEDIAN_PHOTONS)
    counts = drawn(mean, np.random.default_rng(21))
    before = hf.reconstruct(counts, calibration, mixed=False)
    after = hf.reconstruct(counts, calibration)
    found = (after["quality"].values & int(hf.Quality.MIXED)) != 0
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    shown = None
    for axis, image, title in zip(
        axes, (before, after), ("before: depth of one surface", "after: depth of the near surface"),
        strict=False,
    ):  # fmt: skip
        off = np.abs(image["depth"].values - depths).min(axis=0) * 100
        off[before["depth_std"].values > LARGEST_STD_M] = np.nan
        shown = axis.imshow(off[PART], vmin=0, vmax=12, cmap="magma")
        axis.set_title(title)
    assert shown is not None
    figure.colorbar(shown, ax=axes[:2], label="distance to the nearest surface in the pixel, cm")
    axes[2].imshow(np.where(found, after["near_share"], np.nan)[PART], vmin=0, vmax=1)
    axes[2].set_title("share of the near surface, where mixed")
    for axis in axes:
        axis.set(xticks=[], yticks=[])
    figure.savefig(PICTURE, dpi=80)


if __name__ == "__main__":
    main()
