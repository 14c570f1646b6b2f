# SPDX-License-Identifier: Apache-2.0
"""The scenes that can be chosen by name, and their layout for an instrument."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.color.color_chart import PATCHES, patch_reflectances
from hueflight.errors import SceneError
from hueflight.model.instrument import Instrument
from hueflight.model.spectra import reflectance
from hueflight.simulator.effects.footprint import Rays, footprint_rays
from hueflight.simulator.open_scenes import skyline
from hueflight.simulator.paper_scenes import shelf_scene, wall_scene
from hueflight.simulator.scene import NOTHING, Layer, Scene, illuminator_positions, moved, trace
from hueflight.simulator.scene_layout import Layout, SurfaceTable
from hueflight.simulator.shapes import Array

MOMENTS = 16  #: positions of a scene that moves during a capture
BALL_RADIUS_M = 0.012


def plane(*, distance: float = 1.0, surface: str | float = "white") -> Layout:
    """One wall that faces the camera and fills the picture.

    Parameters
    ----------
    distance : float
        Distance of the wall along the optical axis, m.
    surface : str or float
        Name of a surface, or the reflectance of a grey one, 0 to 1.
    """
    palette = SurfaceTable()
    name = surface if isinstance(surface, str) else f"grey {surface:g}"
    index = palette.add(name, reflectance(surface))
    layer = Layer(distance, lambda x, _y: np.full(np.shape(x), index, dtype=np.intp))
    return Layout((layer,), palette, {"plane": (name,)})


def color_checker(*, distance: float = 1.0) -> Layout:
    """A ColorChecker of 24 patches, 28 × 19 cm, in front of a grey wall 2 cm behind it.

    Parameters
    ----------
    distance : float
        Distance of the chart along the optical axis, m.
    """
    patch, pitch, rim = 0.040, 0.0455, 0.004
    palette = SurfaceTable()
    colors = np.array([
        palette.add(name, spectrum)
        for name, spectrum in zip(PATCHES, patch_reflectances(), strict=True)
    ])  # fmt: skip
    frame, wall = palette.add("frame", reflectance("black")), palette["grey"]
    left, top = -3 * pitch, -2 * pitch

    def chart(x: Array, y: Array) -> NDArray[np.intp]:
        col, row = np.floor((x - left) / pitch), np.floor((y - top) / pitch)
        in_grid = (col >= 0) & (col < 6) & (row >= 0) & (row < 4)
        off_x, off_y = np.mod(x - left, pitch) - pitch / 2, np.mod(y - top, pitch) - pitch / 2
        on_patch = in_grid & (np.maximum(np.abs(off_x), np.abs(off_y)) < patch / 2)
        color = colors[np.where(in_grid, row * 6 + col, 0).astype(np.intp)]
        board = (np.abs(x) < -left + rim) & (np.abs(y) < -top + rim)
        return np.where(on_patch, color, np.where(board, frame, NOTHING))

    layers = (
        Layer(distance, chart),
        Layer(distance + 0.02, lambda x, _y: np.full(np.shape(x), wall, dtype=np.intp)),
    )
    return Layout(layers, palette, {name: (name,) for name in PATCHES})


def staircase(*, near: float = 0.6, far: float = 1.3, steps: int = 8) -> Layout:
    """Vertical strips, each further away than the one to its left.

    Parameters
    ----------
    near, far : float
        Distances of the first and of the last strip, m.
    steps : int
        Number of strips, divided evenly over the 294 mrad that preset `paper` sees.

    Raises
    ------
    SceneError
        If there is not at least one strip, or `far` is not beyond `near`.
    """
    if steps < 1:
        raise SceneError(f"staircase: steps = {steps}: must be at least 1")
    if far <= near:
        raise SceneError(f"staircase: far = {far}: must be greater than near = {near}")
    palette = SurfaceTable()
    ends = np.linspace(-0.147, 0.147, steps + 1)
    ends[0], ends[-1] = -np.inf, np.inf
    layers, regions = [], {}
    for step, depth in enumerate(np.linspace(near, far, steps)):
        name = f"step {step + 1}"
        index = palette.add(name, reflectance(0.8))
        layers.append(
            Layer(float(depth), _strip(index, ends[step] * depth, ends[step + 1] * depth))
        )
        regions[name] = (name,)
    return Layout(tuple(layers), palette, regions)


def _strip(index: int, left: float, right: float) -> Callable[[Array, Array], NDArray[np.intp]]:
    """Paint of a vertical strip from `left` to `right`, m."""
    return lambda x, _y: np.where((x >= left) & (x < right), index, NOTHING)


def empty() -> Layout:
    """Nothing within range: no light returns."""
    return Layout((), SurfaceTable(), {})


def with_ball(layout: Layout, place_m: tuple[float, float, float]) -> Layout:
    """Add a white ball to a layout.

    Parameters
    ----------
    layout : Layout
        Contents of the scene, whose table of surfaces gets the ball's.
    place_m : tuple of float
        Middle of the ball: metres to the right, down and away from the camera.

    Returns
    -------
    Layout
        The layout with the ball as a layer and a region.
    """
    right, down, away = place_m
    index = layout.surfaces.add("ball", reflectance("white"))

    def squared_height(x: Array, y: Array) -> Array:
        return BALL_RADIUS_M**2 - (x - right) ** 2 - (y - down) ** 2

    layer = Layer(
        away,
        lambda x, y: np.where(squared_height(x, y) > 0, index, NOTHING),
        lambda x, y: np.sqrt(np.maximum(squared_height(x, y), 0)),
    )
    regions = layout.regions | {"ball": ("ball",)}
    return replace(layout, layers=(*layout.layers, layer), regions=regions)


@dataclass(frozen=True)
class NamedScene:
    """A scene that can be chosen by name.

    Attributes
    ----------
    build : callable
        Function that lays out the scene; its keyword arguments are the options of the scene.
    description : str
        What the scene contains, in a few words.
    """

    build: Callable[..., Layout]
    description: str

    @property
    def options(self) -> dict[str, Any]:
        """Options of the scene and their defaults."""
        parameters = inspect.signature(self.build).parameters.values()
        return {parameter.name: parameter.default for parameter in parameters}


SCENES: dict[str, NamedScene] = {
    "fig1": NamedScene(
        shelf_scene, "the paper's Fig. 1: board with logos, brick wall, horse on a shelf"
    ),
    "fig7": NamedScene(
        wall_scene, "the paper's Fig. 7: brick wall with a window in front of a board"
    ),
    "colorchecker": NamedScene(color_checker, "24 patches of known colour on a grey wall"),
    "plane": NamedScene(plane, "a wall of one surface at one distance"),
    "staircase": NamedScene(staircase, "vertical strips at increasing distance"),
    "skyline": NamedScene(skyline, "towers and an absorber in front of an empty sky"),
    "empty": NamedScene(empty, "nothing: dark counts only"),
}


def scenes() -> dict[str, str]:
    """List the scenes.

    Returns
    -------
    dict of str to str
        Name and description of each scene.
    """
    return {name: entry.description for name, entry in SCENES.items()}


def scene(
    name: str,
    instrument: Instrument,
    *,
    illuminator_m: tuple[float, float] = (0.065, 0.0),
    ring_m: float = 0.01,
    indirect: float = 0.03,
    rays: int = 1,
    motion: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ball: tuple[float, float, float] | None = None,
    **options: Any,
) -> Scene:
    """Lay out a named scene for an instrument.

    Parameters
    ----------
    name : str
        Name of the scene, one of `scenes()`.
    instrument : Instrument
        Instrument that looks at the scene; its geometry and bands determine the result.
    illuminator_m : tuple of float
        Center of the LED ring, metres right and down of the lens as the picture shows it. In
        the paper, shadows lie to the left of the objects that cast them (its Fig. 6), so the LEDs
        are to the right of the lens.
    ring_m : float
        Diameter of the LED ring, m (paper: 1 cm). The LEDs are numbered clockwise, starting at
        the right.
    indirect : float
        Fraction of the light that reaches a shadow by way of other surfaces, 0 to 1.
    rays : int, default 1
        Number of rays along each side of a pixel. With more than 1, `Scene.footprint` holds the
        scene along each ray, and the light of a pixel is their mean.
    motion : tuple of float, default (0, 0, 0)
        How far the scene moves during a capture: metres to the right, down and away from the
        camera. `Scene.moments` then holds the scene at 16 moments, and the scene itself is that at
        the middle of the capture.
    ball : tuple of float, optional
        Where the middle of a white ball is that is added to the scene: metres to the right, down
        and away from the camera. Its radius is `BALL_RADIUS_M`.
    **options : float, int or str
        Options of the scene: the keyword arguments of its `SCENES` entry's `build`.

    Returns
    -------
    Scene
        Depth, surfaces and illumination of every pixel.

    Raises
    ------
    SceneError
        If there is no such scene or option, `indirect` is not in 0 to 1, a distance is not
        positive at all moments, or the motion is not finite.
    """
    if name not in SCENES:
        raise SceneError(f"no scene {name!r}: there are {', '.join(SCENES)}")
    entry = SCENES[name]
    if unknown := set(options) - set(entry.options):
        known = ", ".join(entry.options) or "none"
        raise SceneError(f"scene {name!r} has no option {min(unknown)!r}; it has: {known}")
    if not 0 <= indirect <= 1:
        raise SceneError(f"indirect = {indirect!r}: must be from 0 to 1")
    layout = entry.build(**options)
    if ball is not None:
        layout = with_ball(layout, ball)
    if not all(isfinite(part) for part in motion):
        raise SceneError(f"motion = {motion!r}: must be three finite numbers, in metres")
    for layer in layout.layers:
        nearest = layer.depth_m - abs(motion[2]) / 2
        if not (isfinite(nearest) and nearest > 0):
            raise SceneError(
                f"scene {name!r} with {options}: an object is at {nearest:g} m; "
                "distances must be positive and finite"
            )

    def along(rays: Rays | None, moment: float) -> Scene:
        right, down, away = (moment * part for part in motion)
        return trace(
            name,
            [moved(layer, (right, down, away)) for layer in layout.layers],
            instrument,
            surfaces=tuple(layout.surfaces.spectra),
            spectra=layout.surfaces.table(),
            regions=layout.regions,
            gloss=layout.gloss,
            leds_m=illuminator_positions(instrument, illuminator_m, ring_m),
            indirect=indirect,
            rays=rays,
        )

    def at(moment: float) -> Scene:
        center = along(None, moment)
        if rays == 1:
            return center
        footprint = tuple(along(ray, moment) for ray in footprint_rays(instrument, rays))
        return replace(center, footprint=footprint)

    if not any(motion):
        return at(0.0)
    times = (np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5
    return replace(at(0.0), moments=tuple(at(float(moment)) for moment in times))
