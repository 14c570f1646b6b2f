# SPDX-License-Identifier: Apache-2.0
"""Shapes of the objects in a scene, as functions of positions in metres right and down."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def rectangle(x: Array, y: Array, left: float, top: float, right: float, bottom: float) -> Mask:
    """Points inside a rectangle, which includes its left and top edges but not the other two."""
    return (x >= left) & (x < right) & (y >= top) & (y < bottom)


def disc(x: Array, y: Array, center: tuple[float, float], radius: float) -> Mask:
    """Points inside a circle."""
    return (x - center[0]) ** 2 + (y - center[1]) ** 2 < radius**2


def limb(
    x: Array,
    y: Array,
    joints: Sequence[tuple[float, float, float]],
) -> Array:
    """Depth of points inside a chain of tapering limbs with round ends.

    Parameters
    ----------
    x, y : ndarray of float
        Positions of the points.
    joints : sequence of tuple of float
        Position and radius (x, y, radius) of each joint along the chain, in the unit of `x`.

    Returns
    -------
    ndarray of float
        Distance of each point from the outline, in the unit of `x`; negative outside.
    """
    inside = np.full(np.shape(x), -np.inf)
    for (x0, y0, r0), (x1, y1, r1) in pairwise(joints):
        along_x, along_y = x1 - x0, y1 - y0
        t = ((x - x0) * along_x + (y - y0) * along_y) / (along_x**2 + along_y**2)
        t = np.clip(t, 0, 1)
        distance = np.hypot(x - x0 - t * along_x, y - y0 - t * along_y)
        inside = np.maximum(inside, r0 + (r1 - r0) * t - distance)
    return inside


# letters of 5 × 7 dots, rows from the top; `#` is ink
_LETTERS = {
    "E": "##### #.... #.... ####. #.... #.... #####",
    "F": "##### #.... #.... ####. #.... #.... #....",
    "G": ".###. #...# #.... #.### #...# #...# .###.",
    "H": "#...# #...# #...# ##### #...# #...# #...#",
    "I": ".###. ..#.. ..#.. ..#.. ..#.. ..#.. .###.",
    "L": "#.... #.... #.... #.... #.... #.... #####",
    "T": "##### ..#.. ..#.. ..#.. ..#.. ..#.. ..#..",
    "U": "#...# #...# #...# #...# #...# #...# .###.",
}


def lettering(
    x: Array, y: Array, text: str, *, left: float, top: float, dot_width: float, dot_height: float
) -> NDArray[np.intp]:
    """Find the letter of a text that has ink at each point.

    Letters have 5 × 7 dots and follow one another every six dots.

    Parameters
    ----------
    x, y : ndarray of float
        Positions of the points, metres right and down.
    text : str
        Text to write, of the letters in `_LETTERS`.
    left, top : float
        Position of the top left corner of the first letter, m.
    dot_width, dot_height : float
        Size of one dot, m.

    Returns
    -------
    ndarray of int
        Index of the letter in the text for each point; −1 where there is no ink.
    """
    glyphs = np.array([
        [[dot == "#" for dot in row] for row in _LETTERS[letter].split()] for letter in text
    ])  # fmt: skip
    column = np.floor((x - left) / dot_width).astype(np.intp)
    row = np.floor((y - top) / dot_height).astype(np.intp)
    letter, column = np.divmod(column, 6)
    inside = (letter >= 0) & (letter < len(text)) & (row >= 0) & (row < 7) & (column < 5)
    ink = glyphs[np.where(inside, letter, 0), np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.where(inside & ink, letter, -1)
