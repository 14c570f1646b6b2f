"""The joint fit, compiled where it can be: one function, checked here, the same either way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.reconstruction import fit as definition
from hueflight.reconstruction.fit import DEFAULT, Fit, Switches
from hueflight.reconstruction.plan import Plan

TILE_PIXELS = 8192  #: pixels at once: bounds the memory that the definition takes


def fit_pixels(
    light: NDArray[np.floating],
    offsets_ns: NDArray[np.float64],
    plan: Plan,
    switches: Switches = DEFAULT,
) -> Fit:
    """Fit pixels side by side; see `fit.fit`."""
    tiles = [
        definition.fit(
            light[start : start + TILE_PIXELS],
            offsets_ns[start : start + TILE_PIXELS],
            plan,
            switches,
        )
        for start in range(0, len(light), TILE_PIXELS)
    ]
    return Fit(
        **{
            name: np.concatenate([getattr(tile, name) for tile in tiles])
            for name in Fit.__dataclass_fields__
        }
    )
