# SPDX-License-Identifier: Apache-2.0
"""Deviations that are stated for a real sensor: an ams TMF8820 before a plane that a robot moves.

Depth is compared with the line of each zone over the robot's distances; the page on the real sensor
describes the data.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from _tmf8820 import FILE, captures, off_line
from acceptance import NO_DATA, Row

import hueflight as hf


def rows(quick: bool) -> Iterator[Row]:
    """Return how often stated intervals hold, and what else is stated of the fit."""
    what = "TMF8820 before a plane, `joint`: 68 % interval covers"
    if not FILE.exists():
        yield Row(what, NO_DATA)
        return
    seen = captures(step=4 if quick else 1)
    images = [hf.reconstruct(capture.counts, capture.calibration) for capture in seen]
    depth, stated, goodness, flags = (
        np.array([image[name].values.ravel() for image in images])
        for name in ("depth", "depth_std", "fit_chi_square", "quality")
    )
    error, _ = off_line(np.array([capture.distance_m for capture in seen]), depth)
    covered = float((np.abs(error) < stated).mean())
    yield Row(
        what,
        f"{covered:.1%} (95 % interval {(np.abs(error) < 1.96 * stated).mean():.1%}); off by "
        f"{100 * np.sqrt((error**2).mean()):.3f} cm rms, stated {100 * np.median(stated):.3f} cm; "
        f"flagged {(flags != 0).mean():.1%}; χ² per degree of freedom {np.median(goodness):.0f}",
        "60-82 %", "64-74 %", 0.60 <= covered <= 0.82,
    )  # fmt: skip
