# SPDX-License-Identifier: Apache-2.0
"""Scenes with empty regions: directions from which no LED light returns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError
from hueflight.model.spectra import reflectance
from hueflight.simulator.scene import NOTHING, Layer
from hueflight.simulator.scene_layout import Layout, SurfaceTable
from hueflight.simulator.shapes import Array, rectangle


def skyline(*, distance: float = 1.0, depth: float = 0.5) -> Layout:
    """Lay out towers and an absorber in front of an empty sky, as large as the distance demands.

    Parameters
    ----------
    distance : float, default 1.0
        Distance of the near tower, the absorber and the ground, m.
    depth : float, default 0.5
        Distance of the far tower behind the near one, m.

    Returns
    -------
    Layout
        The layers. Seen by preset `paper`, half of the picture is sky. The absorber has a depth
        and reflects nothing.
    """
    if depth <= 0:
        raise SceneError(f"skyline: depth = {depth:g}: must be above 0")
    palette = SurfaceTable()
    tower, ground = palette["red brick"], palette["grey"]
    absorber = palette.add("absorber", reflectance(0.0))
    far_tower = palette["board"]
    far = distance + depth

    def near(x: Array, y: Array) -> NDArray[np.intp]:
        u, v = x / distance, y / distance
        surface = np.where(rectangle(u, v, -np.inf, 0.075, np.inf, np.inf), ground, NOTHING)
        surface[rectangle(u, v, -0.1, -0.05, -0.04, 0.075)] = tower
        surface[rectangle(u, v, -0.08, -0.085, -0.06, -0.05)] = tower
        surface[rectangle(u, v, 0.08, -0.02, 0.12, 0.075)] = absorber
        return surface

    def behind(x: Array, y: Array) -> NDArray[np.intp]:
        inside = rectangle(x / far, y / far, -0.05, -0.06, 0.05, 0.085)
        return np.where(inside, far_tower, NOTHING)

    regions = {
        "near tower": ("red brick",),
        "far tower": ("board",),
        "ground": ("grey",),
        "absorber": ("absorber",),
    }
    return Layout((Layer(distance, near), Layer(far, behind)), palette, regions)
