# SPDX-License-Identifier: Apache-2.0
"""The scenes of the paper: a brick wall with a window and a horse in front of a board with logos.

They appear in the paper's Figs. 1, 4, 5, 6 and 7. The paper gives distances and colours but no
drawings; sizes are chosen so that, seen by preset `paper`, row 139 contains only plain board and
row 56 the window, the wall and the horse, with shadows to the left of the window's edge and of the
horse, as in Fig. 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.simulator.scene import NOTHING, Layer
from hueflight.simulator.scene_layout import Layout, SurfaceTable
from hueflight.simulator.shapes import Array, Mask, disc, lettering, limb, rectangle

_BRICK_WIDTH, _BRICK_HEIGHT, _STUD_PITCH = 0.032, 0.0096, 0.008

_WALL_COLORS = {"R": "red brick", "G": "green brick", "B": "blue brick", "P": "purple brick"}
# courses from the top, bricks from the right edge; the pattern repeats in both directions
_WALL_PATTERN = ("RGBP", "RBGR", "RPPG", "RGRB", "RPGP", "RBBG", "RGPR", "RBGP", "RPBG", "RGPB")

_INKS = (
    "ink red", "ink orange", "ink amber", "ink yellow", "ink green",
    "ink cyan", "ink blue", "ink violet", "ink navy",
)  # fmt: skip


def shelf_scene(
    *, background: float = 1.0, wall: float = 0.8, horse: float = 0.7, glare: float = 0.0
) -> Layout:
    """Fig. 1: board with logos, brick wall with a window, horse with a saddle on a shelf.

    Parameters
    ----------
    background, wall, horse : float
        Distances of the board, the wall and the horse, m.
    glare : float
        Specular reflection from the board's print at its brightest point, as a reflectance; the
        paper reports some.
    """
    palette = SurfaceTable()
    layers = (
        _board(palette, background),
        _wall(
            palette,
            wall,
            right=-0.050,
            top=-0.070,
            bottom=0.030 * wall / 0.8,
            window=(-0.106, -0.0508, -0.082, -0.0124),
        ),
        _horse(palette, horse, x=0.038, ground=0.024),
        _shelf(palette, horse - 0.005, top=0.024, bottom=0.029),
    )
    return Layout(layers, palette, _regions(palette), dict.fromkeys(_INKS, glare))


def wall_scene(*, distance: float = 1.0) -> Layout:
    """Fig. 7: a brick wall with a window 10 cm in front of a distance, a board 10 cm behind it.

    Parameters
    ----------
    distance : float
        Distance of the middle between wall and board, m (paper: 0.5, 1.0 and 1.5).
    """
    palette = SurfaceTable()
    layers = (
        _board(palette, distance + 0.1),
        _wall(
            palette,
            distance - 0.1,
            right=0.024,
            top=-0.0576,
            bottom=np.inf,
            window=(-0.032, -0.0192, 0.0, 0.0192),
        ),
    )
    return Layout(layers, palette, _regions(palette))


def _regions(palette: SurfaceTable) -> dict[str, tuple[str, ...]]:
    """Surfaces of each named region, as far as the scene contains them."""
    wanted = {
        "red brick": ("red brick",),
        "green brick": ("green brick",),
        "blue brick": ("blue brick",),
        "purple brick": ("purple brick",),
        "horse": ("horse",),
        "saddle": ("saddle",),
        "background": ("board",),
        "logos": _INKS,
    }
    return {
        name: tuple(surface for surface in surfaces if surface in palette.spectra)
        for name, surfaces in wanted.items()
        if any(surface in palette.spectra for surface in surfaces)
    }


def _board(palette: SurfaceTable, depth_m: float) -> Layer:
    """White board with lettering, a line of small print, a crest and bars."""
    plain = palette["board"]
    inks = np.array([palette[ink] for ink in _INKS])
    navy, red, green, yellow, cyan = (
        palette[f"ink {color}"] for color in ("navy", "red", "green", "yellow", "cyan")
    )

    def paint(x: Array, y: Array) -> NDArray[np.intp]:
        surface = np.full(np.shape(x), plain, dtype=np.intp)
        letter = lettering(
            x, y, "HUEFLIGHT", left=-0.126, top=0.063, dot_width=0.0048, dot_height=0.0038
        )
        surface = np.where(letter >= 0, inks[letter], surface)
        # a line of small print, too fine to read
        print_line = rectangle(x, y, -0.125, 0.0965, 0.12, 0.1015)
        surface[print_line & (np.sin(x * 700) + np.sin(x * 1130 + 1) > -0.35)] = navy
        # a crest: ring, and a disc in quarters
        crest = (0.098, -0.074)
        ring = disc(x, y, crest, 0.028) & ~disc(x, y, crest, 0.0225)
        surface[ring] = navy
        left, upper = x < crest[0], y < crest[1]
        inner = disc(x, y, crest, 0.018)
        for mask, ink in (
            (left & upper, red), (~left & upper, yellow),
            (left & ~upper, green), (~left & ~upper, cyan),
        ):  # fmt: skip
            surface[inner & mask] = ink
        # three bars
        for bar, ink in enumerate((red, green, navy)):
            top = -0.1 + 0.013 * bar
            surface[rectangle(x, y, -0.035, top, 0.028 - 0.014 * bar, top + 0.0085)] = ink
        return surface

    return Layer(depth_m, paint)


def _wall(
    palette: SurfaceTable,
    depth_m: float,
    *,
    right: float,
    top: float,
    bottom: float,
    window: tuple[float, float, float, float],
) -> Layer:
    """Brick wall in running bond that extends beyond the left edge of the picture.

    Positions are metres right and down of the axis; `window` is (left, top, right, bottom).
    """
    colors = np.array([[palette[_WALL_COLORS[c]] for c in course] for course in _WALL_PATTERN])
    courses, bricks = colors.shape
    red, seam = palette["red brick"], palette["seam"]

    def paint(x: Array, y: Array) -> NDArray[np.intp]:
        course = np.floor((y - top) / _BRICK_HEIGHT).astype(np.intp)
        half_brick = (course % 2) * _BRICK_WIDTH / 2
        brick = np.floor((right - x + half_brick) / _BRICK_WIDTH).astype(np.intp)
        surface = colors[course % courses, brick % bricks]
        from_left = np.mod(right - x + half_brick, _BRICK_WIDTH)
        from_top = np.mod(y - top, _BRICK_HEIGHT)
        surface = np.where((from_left < 0.0011) | (from_top < 0.0009), seam, surface)
        studs = rectangle(x, y, -np.inf, top - 0.0018, right, top)
        studs &= np.abs(np.mod(right - x, _STUD_PITCH) - _STUD_PITCH / 2) < 0.0024
        wall = rectangle(x, y, -np.inf, top, right, bottom) & ~rectangle(x, y, *window)
        return np.where(wall, surface, np.where(studs, red, NOTHING))

    return Layer(depth_m, paint)


def _shelf(palette: SurfaceTable, depth_m: float, *, top: float, bottom: float) -> Layer:
    """Front edge of a shelf across the whole picture, from `top` to `bottom`, m."""
    shelf = palette["shelf"]

    def paint(x: Array, y: Array) -> NDArray[np.intp]:
        return np.where((y >= top) & (y < bottom), shelf, NOTHING)

    return Layer(depth_m, paint)


# The horse: chains of (x, y, radius) in centimetres, right and up from the ground below its middle.
_BODY = (
    [(-1.6, 3.35, 1.10), (0.2, 3.25, 1.05), (1.9, 3.45, 1.18)],
    [(-1.9, 3.7, 0.95), (-2.75, 5.5, 0.58)],
    [(-2.6, 5.75, 0.62), (-3.95, 4.95, 0.40)],
    [(-2.35, 6.2, 0.24), (-2.2, 6.75, 0.05)],
    [(-1.9, 3.0, 0.50), (-2.15, 1.6, 0.34), (-2.05, 0.25, 0.26)],
    [(-1.2, 3.0, 0.50), (-1.0, 1.6, 0.34), (-1.15, 0.25, 0.26)],
    [(1.5, 3.0, 0.60), (1.35, 1.7, 0.36), (1.15, 0.25, 0.26)],
    [(2.35, 3.2, 0.80), (2.75, 1.8, 0.38), (2.4, 0.25, 0.26)],
)
_TAIL = [(2.95, 4.0, 0.26), (3.55, 3.0, 0.34), (3.6, 1.6, 0.20)]
_MANE = [(-2.15, 6.3, 0.22), (-1.75, 5.5, 0.30), (-0.95, 4.45, 0.24)]
_SEAT = [(-0.65, 4.62, 0.20), (0.2, 4.36, 0.26), (1.15, 4.66, 0.22)]
_SIZE = 1.2  # scale of the whole horse


def _horse(palette: SurfaceTable, depth_m: float, *, x: float, ground: float) -> Layer:
    """Horse with a saddle, rounded in relief, standing at (`x`, `ground`), m."""
    coat, dark, saddle = palette["horse"], palette["hoof"], palette["saddle"]
    origin_x, origin_y = x, ground

    def units(x: Array, y: Array) -> tuple[Array, Array]:
        return (x - origin_x) * 100 / _SIZE, (origin_y - y) * 100 / _SIZE

    def inside(u: Array, v: Array) -> Array:
        depths = [limb(u, v, chain) for chain in (*_BODY, _TAIL, _MANE, _SEAT)]
        return np.max(depths, axis=0)

    def saddled(u: Array, v: Array) -> Mask:
        cloth = limb(u, v, _BODY[0]) > 0
        cloth &= (np.abs(u - 0.25) < 0.85) & (v > 3.0)
        return cloth | (limb(u, v, _SEAT) > 0)

    def paint(x: Array, y: Array) -> NDArray[np.intp]:
        u, v = units(x, y)
        surface = np.where(inside(u, v) > 0, coat, NOTHING)
        surface[limb(u, v, _TAIL) > 0] = dark
        surface[limb(u, v, _MANE) > 0] = dark
        surface[(surface == coat) & (v < 0.42)] = dark
        surface[saddled(u, v)] = saddle
        return surface

    def relief(x: Array, y: Array) -> Array:
        # rises from the outline of each limb towards its middle, and is level beyond 6 mm
        round_m = 0.006  # a height of 0.35 times that tilts the edges enough to be visible
        rim = np.clip(inside(*units(x, y)) * _SIZE / 100 / round_m, 0, 1)
        return 0.35 * round_m * (1 - (1 - rim) ** 2)

    return Layer(depth_m, paint, relief)
