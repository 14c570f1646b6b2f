# SPDX-License-Identifier: Apache-2.0
"""Edges: pixels about which the image shows a near and a far surface.

In the window about each pixel, the depths of a near and of a far surface are estimated. Where they
differ by more than a tilted plane would explain, the pixel lies at an edge, and may see both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians, tan

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit_results import PICTURE_SIZE, SURFACE_STARTS, WINDOW
from hueflight.fit.solver import compiled_kernel

SHIFTS = 2  #: steps of the mean shift after the first
REACH = 2.5  #: standard deviations within which a pixel belongs to a surface
LEAST_PIXELS = 2  #: in the window that each surface needs
STEEPEST_DEGREES = 80.0  #: a single surface is tilted by no more than this
EDGE_DEVIATIONS = 4.0  #: by which a step exceeds what a tilted surface changes
OWN_DEVIATIONS = 2.0  #: of the pixel itself, than which a smaller step is not looked at
LOOKED_AT = 0.8  #: share of the smallest step, from which the surfaces are estimated
BESIDE = 0.2  #: share of the step within which a pixel next to a mixed one is on a surface
SIGNIFICANT = 2.0  #: standard deviations by which a mixed pixel differs from either surface


@dataclass(frozen=True)
class Edges:
    """Pixels at edges, and the surfaces beside them.

    Attributes
    ----------
    row, col : ndarray of int, shape (pixel,)
        The pixels.
    near, far : ndarray of float, shape (pixel,)
        Depth of the near and of the far surface, m.
    near_std, far_std : ndarray of float, shape (pixel,)
        Standard deviations of these depths, m.
    between : ndarray of bool, shape (pixel,)
        Whether the pixel's own depth lies between both and differs significantly from either, and
        both are next to it.
    """

    row: NDArray[np.intp]
    col: NDArray[np.intp]
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    near_std: NDArray[np.float64]
    far_std: NDArray[np.float64]
    between: NDArray[np.bool_]

    def take(self, chosen: NDArray[np.bool_]) -> Edges:
        """Return some of the pixels.

        Parameters
        ----------
        chosen : ndarray of bool, shape (pixel,)
            Pixels to keep.

        Returns
        -------
        Edges
            The same of these pixels.
        """
        return Edges(*(getattr(self, name)[chosen] for name in Edges.__dataclass_fields__))


def find_edges(
    depth: NDArray[np.floating], depth_std: NDArray[np.floating], pixel_angle: float
) -> Edges:
    """Find the pixels about which there is a near and a far surface.

    Parameters
    ----------
    depth : ndarray of float, shape (row, col)
        Depth, m; NaN where it is not known.
    depth_std : ndarray of float, shape (row, col)
        Standard deviation of depth, m, whose errors are independent from pixel to pixel.
    pixel_angle : float
        Angle between neighboring pixels, rad.

    Returns
    -------
    Edges
        Pixels whose own depth is known and that lie at an edge, in the order of the image.
    """
    known = np.isfinite(depth) & (depth_std > 0)
    planes = np.where(known, np.stack([depth, depth_std]), np.nan)
    # a plane's steepest change from one end of the window to the other
    limit = tan(radians(STEEPEST_DEGREES)) * (WINDOW - 1) * pixel_angle
    starts = _starts(planes)
    # most pixels lie on one surface: no need to look closer
    with np.errstate(invalid="ignore"):  # without neighbors: inf - inf
        step = starts[1] - starts[0]
        stepped = known & (step > LOOKED_AT * limit * starts[0])
        stepped &= step > LOOKED_AT * OWN_DEVIATIONS * planes[1]
    row, col = np.nonzero(stepped)
    depths, deviations = np.moveaxis(neighbors(np.moveaxis(planes, 0, -1), row, col), -1, 0)
    near, near_std, near_pixels = _surface(depths, deviations, starts[0][row, col])
    far, far_std, far_pixels = _surface(depths, deviations, starts[1][row, col])
    own, std = planes[:, row, col]
    step = far - near
    edge = (
        (step > limit * near + EDGE_DEVIATIONS * np.hypot(near_std, far_std))
        & (step > OWN_DEVIATIONS * std)
        & (np.minimum(near_pixels, far_pixels) >= LEAST_PIXELS)
    )
    between = (own - near > SIGNIFICANT * np.hypot(std, near_std)) & (
        far - own > SIGNIFICANT * np.hypot(std, far_std)
    )
    margin = BESIDE * step
    between &= _beside_both(planes[0], row, col, near + margin, far - margin)
    return Edges(row, col, near, far, near_std, far_std, between).take(edge)


def neighbors(
    planes: NDArray[np.floating], row: NDArray[np.intp], col: NDArray[np.intp]
) -> NDArray[np.floating]:
    """Return the values in the windows about some pixels, without their own.

    At the border of the image, the window is moved inwards, so that it has as many pixels.

    Parameters
    ----------
    planes : ndarray of float, shape (row, col, plane)
        Values of all pixels.
    row, col : ndarray of int, shape (pixel,)
        The pixels.

    Returns
    -------
    ndarray of float, shape (pixel, neighbor, plane)
        Values of the neighbors; NaN where the image is smaller than the window.
    """
    whole = _at_least_a_window(planes, (0, 1))
    width = whole.shape[1]
    top, left = _window_corner(row, whole.shape[0]), _window_corner(col, width)
    down, right = np.divmod(np.arange(WINDOW**2), WINDOW)
    places = (top * width + left)[:, None] + (down * width + right)
    others = places[places != (row * width + col)[:, None]].reshape(len(row), WINDOW**2 - 1)
    return whole.reshape(-1, planes.shape[-1])[others]


def _beside_both(
    depth: NDArray[np.float64],
    row: NDArray[np.intp],
    col: NDArray[np.intp],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Whether of the eight pixels about each, one is nearer than `near` and one beyond `far`.

    Pixels whose window reaches beyond an edge at a distance do not see it. A pixel that is not
    known may be either.
    """
    padded = np.pad(depth, 1, constant_values=np.nan)
    down, right = np.divmod(np.delete(np.arange(9), 4), 3)
    beside = padded[row[:, None] + down, col[:, None] + right]
    behind, before = (beside >= near[:, None]).all(axis=-1), (beside <= far[:, None]).all(axis=-1)
    return np.logical_not(behind | before)


def _window_corner(place: NDArray[np.intp], size: int) -> NDArray[np.intp]:
    """First row or column of the windows about some places."""
    return np.clip(place - WINDOW // 2, 0, size - WINDOW)


def _at_least_a_window(planes: NDArray[np.floating], axes: tuple[int, int]) -> NDArray[np.floating]:
    """Values of an image, with NaN appended where it is smaller than a window."""
    missing = [(0, 0)] * planes.ndim
    for axis in axes:
        missing[axis] = (0, max(WINDOW - planes.shape[axis], 0))
    return np.pad(planes, missing, constant_values=np.nan)


def _starts(planes: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the surfaces about each pixel are looked for: after one step of mean shift.

    It starts from the third smallest and the third largest depth, which one outlier does not
    change. Where fewer are known, the last of them is taken; inf and -inf where none is.
    """
    depth, deviation = _at_least_a_window(planes.astype(np.float32), (1, 2))
    rows, cols = planes.shape[1:]
    # pixels at the border look at the nearest whole window
    row = _window_corner(np.arange(rows), len(depth))
    col = _window_corner(np.arange(cols), depth.shape[1])
    near, far = (
        start.take(row, axis=0).take(col, axis=1).astype(np.float64)
        for start in inner_starts(depth, deviation)
    )
    return near, far


def inner_starts(
    depth: NDArray[np.float32], deviation: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return where surfaces are looked for about the pixels that have a whole window.

    Parameters
    ----------
    depth : ndarray of float32, shape (row, col)
        Depth, m; NaN where it is not known.
    deviation : ndarray of float32, shape (row, col)
        Its standard deviation, m.

    Returns
    -------
    near : ndarray of float32, shape (row - WINDOW + 1, col - WINDOW + 1)
        Depth of the near surface, m.
    far : ndarray of float32, shape (row - WINDOW + 1, col - WINDOW + 1)
        Depth of the far surface, m.
    """
    kernel = compiled_kernel()
    rows, cols = depth.shape
    if kernel is not None:
        near, far = np.empty((2, rows - WINDOW + 1, cols - WINDOW + 1), np.float32)
        kernel.surface_starts(
            *SURFACE_STARTS.arguments(
                depth=np.ascontiguousarray(depth),
                deviation=np.ascontiguousarray(deviation),
                size=PICTURE_SIZE.pack(rows=rows, cols=cols, reach=REACH),
                near=near,
                far=far,
            )
        )
        return near, far
    unknown = np.isnan(depth)
    values = np.where(unknown, np.float32(np.inf), depth)
    reach = np.where(unknown, np.float32(0), REACH * deviation)
    weights = np.where(unknown, np.float32(0), 1 / (deviation * deviation))
    moments = weights * np.where(unknown, np.float32(0), depth)
    low, high = _third_smallest(values), -_third_smallest(np.where(unknown, np.inf, -depth))
    light = reach, weights, moments
    return _shifted(values, *light, low), _shifted(values, *light, high)


def _views(values: NDArray[np.float32]) -> Iterator[NDArray[np.float32]]:
    """Yield the neighbors of all pixels with a whole window, in one direction after another."""
    rows, cols = (size - WINDOW + 1 for size in values.shape)
    for place in range(WINDOW**2):
        if place != WINDOW**2 // 2:
            down, right = divmod(place, WINDOW)
            yield values[down : down + rows, right : right + cols]


def _third_smallest(values: NDArray[np.float32]) -> NDArray[np.float32]:
    shape = tuple(size - WINDOW + 1 for size in values.shape)
    first = np.full(shape, np.inf, np.float32)
    second, third = first.copy(), first.copy()
    larger = np.empty(shape, np.float32)
    for value in _views(values):
        np.minimum(third, np.maximum(second, value, out=larger), out=third)
        np.minimum(second, np.maximum(first, value, out=larger), out=second)
        np.minimum(first, value, out=first)
    last = np.where(np.isfinite(second), second, first)
    return np.where(np.isfinite(third), third, last)


def _shifted(
    values: NDArray[np.float32],
    reach: NDArray[np.float32],
    weights: NDArray[np.float32],
    moments: NDArray[np.float32],
    start: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return the mean of the neighbors within reach of a start, else the start."""
    total, moment = np.zeros((2, *start.shape), np.float32)
    off, inside = np.empty_like(start), np.empty(start.shape, bool)
    with np.errstate(invalid="ignore"):  # inf - inf
        for value, within, weight, part in zip(
            _views(values), _views(reach), _views(weights), _views(moments), strict=True
        ):
            np.abs(np.subtract(value, start, out=off), out=off)
            np.less(off, within, out=inside)
            total += np.multiply(weight, inside, out=off)
            moment += np.multiply(part, inside, out=off)
    found = moment / np.where(total > 0, total, np.float32(1))
    return np.where(total > 0, found, start)


def _surface(
    depths: NDArray[np.float64], deviations: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]]:
    """Return depth, deviation and number of pixels of the surface at `start`, by mean shift.

    Extremes of several depths are biased outwards; the mean of the pixels about them is not.
    """
    known = np.isfinite(depths)
    weights = np.where(known, 1 / deviations**2, 0.0)
    values = np.where(known, depths, np.inf)
    moments = weights * np.where(known, depths, 0.0)
    reach = REACH * np.where(known, deviations, 0.0)
    center, total, members = start, np.ones_like(start), np.zeros(depths.shape, bool)
    for _ in range(SHIFTS):
        members = np.abs(values - center[:, None]) < reach
        total = np.einsum("pn,pn->p", weights, members)
        found = np.einsum("pn,pn->p", moments, members) / np.where(total > 0, total, 1.0)
        center = np.where(total > 0, found, center)
    return center, np.where(total > 0, total, np.inf) ** -0.5, members.sum(axis=-1)
