# SPDX-License-Identifier: Apache-2.0
"""A small scene for the synthetic sensor.

The scene consists of two tables. One gives the distance and material of each block of pixels. The
other holds for each material 256 equally likely outcomes of an exposure: no photon, or the code of
a photon of some band, or of the background, at distance 0. A
random byte, the distance and a little jitter make a code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..frame_format import FormatError, FrameFormat

BLOCK = 8
"""Side of a block of pixels that share distance and material."""
MATERIALS = 8
OUTCOMES = 256
DEPTH_BITS = 6
JITTER_BITS = 3
"""A pulse is the sum of two such numbers, a triangle of 15 codes: 9.4 ns at 0.625 ns a code."""

_PHOTON_SHARE = 0.55  # of exposures in which a white pixel sees a photon
_BACKGROUND_SHARE = 0.05
_SPACING = 30 / 320  # from band to band, in periods: the paper's Table 1
_BANDS = 9


@dataclass(frozen=True)
class Scene:
    """Tables of the synthetic sensor's scene.

    Parameters
    ----------
    material : array of uint8, (block rows, block cols)
        0 to 7.
    depth : array of uint8, (block rows, block cols)
        In codes, 0 to 63.
    outcomes : array of uint16, (8, 256)
        Code at distance 0, or 0 for no photon.

    Raises
    ------
    FormatError
        If a table has another shape or a value does not fit.
    """

    material: NDArray[np.uint8]
    depth: NDArray[np.uint8]
    outcomes: NDArray[np.uint16]

    def __post_init__(self) -> None:
        if self.material.shape != self.depth.shape or self.material.ndim != 2:
            raise FormatError(
                f"scene: material is {self.material.shape}, depth {self.depth.shape}: must be "
                "equal, (block rows, block cols)"
            )
        if self.outcomes.shape != (MATERIALS, OUTCOMES):
            raise FormatError(
                f"scene: outcomes is {self.outcomes.shape}: must be {(MATERIALS, OUTCOMES)}"
            )
        for name, table, limit in (
            ("material", self.material, MATERIALS),
            ("depth", self.depth, 1 << DEPTH_BITS),
        ):
            if table.max(initial=0) >= limit:
                raise FormatError(f"scene: {name} {table.max()}: must be below {limit}")

    def check(self, form: FrameFormat, /) -> None:
        """Check that the scene fits a sensor.

        Raises
        ------
        FormatError
            If it does not.
        """
        wanted = blocks(form)
        if self.material.shape != wanted:
            raise FormatError(f"scene has {self.material.shape} blocks: must be {wanted}")
        if self.outcomes.max(initial=0) >= 1 << form.code_bits:
            raise FormatError(
                f"scene: code {self.outcomes.max()} does not fit {form.code_bits} bits"
            )


def blocks(form: FrameFormat, /) -> tuple[int, int]:
    """Return the rows and columns of blocks that a sensor has."""
    return -(-form.rows // BLOCK), -(-form.cols // BLOCK)


def default_scene(form: FrameFormat, /) -> Scene:
    """Return a scene: a wall, steps on the left, a ball in the middle, colours below."""
    rows, cols = blocks(form)
    row, col = np.indices((rows, cols))
    depth = np.full((rows, cols), 40)
    material = np.zeros((rows, cols), np.uint8)

    steps = col < max(1, cols // 4)
    depth[steps] = (8 + 8 * (3 * row // max(1, rows)))[steps]

    radius = max(1.0, min(rows, cols) / 4)
    distance = np.hypot(row - (rows - 1) / 2, col - (cols - 1) / 2) / radius
    ball = distance < 1
    depth[ball] = (34 - 12 * np.sqrt(1 - distance[ball] ** 2)).astype(int)
    material[ball] = 1

    colours = row == rows - 1
    material[colours] = (col * MATERIALS // max(1, cols))[colours]
    return Scene(material, depth.astype(np.uint8), default_outcomes(form))


def default_outcomes(form: FrameFormat, /) -> NDArray[np.uint16]:
    """Return the outcomes of eight materials: white, grey, and six colours."""
    codes = 1 << form.code_bits
    band = np.arange(_BANDS)
    colours = [np.exp(-(((band - 1.5 * k - 0.5) / 1.5) ** 2)) for k in range(MATERIALS - 2)]
    reflectance = np.stack([np.ones(_BANDS), np.full(_BANDS, 0.5), *colours])
    # the latest photon has the smallest code
    pulse = (codes - 1 - np.round(band * _SPACING * codes)).astype(int) % codes
    outcomes = np.zeros((MATERIALS, OUTCOMES), np.uint16)
    for number in range(MATERIALS):
        counts = np.round(OUTCOMES * _PHOTON_SHARE / _BANDS * reflectance[number]).astype(int)
        photons = np.repeat(pulse, counts)
        background = np.linspace(1, codes - 1, round(OUTCOMES * _BACKGROUND_SHARE)).astype(int)
        drawn = np.concatenate([photons, background])[:OUTCOMES]
        outcomes[number, : drawn.size] = np.maximum(drawn, 1)
    return outcomes
