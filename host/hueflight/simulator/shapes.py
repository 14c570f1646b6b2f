"""Shapes to paint layers with: boolean masks and inside distances over metres right and down."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def rectangle(x: Array, y: Array, left: float, top: float, right: float, bottom: float) -> Mask:
    """Points inside a rectangle; its right and bottom edges belong to the neighbour."""
    return (x >= left) & (x < right) & (y >= top) & (y < bottom)


def disc(x: Array, y: Array, center: tuple[float, float], radius: float) -> Mask:
    """Points inside a circle."""
    return (x - center[0]) ** 2 + (y - center[1]) ** 2 < radius**2


def limb(
    x: Array,
    y: Array,
    joints: Sequence[tuple[float, float, float]],
) -> Array:
    """How deep inside a chain of tapering, round-ended limbs points lie; negative outside.

    Parameters
    ----------
    joints : (x, y, radius) along the chain.
    """
    inside = np.full(np.shape(x), -np.inf)
    for (x0, y0, r0), (x1, y1, r1) in pairwise(joints):
        along_x, along_y = x1 - x0, y1 - y0
        t = ((x - x0) * along_x + (y - y0) * along_y) / (along_x**2 + along_y**2)
        t = np.clip(t, 0, 1)
        distance = np.hypot(x - x0 - t * along_x, y - y0 - t * along_y)
        inside = np.maximum(inside, r0 + (r1 - r0) * t - distance)
    return inside


# 5 × 7 letters, rows from the top, `#` is ink
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
    """Which letter of a text has ink at each point, −1 for none.

    Parameters
    ----------
    left, top : of the first letter; dot_width, dot_height : of one of its 5 × 7 dots; letters
        follow each other every six dots.
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
