# SPDX-License-Identifier: Apache-2.0
"""Mixed pixels: those at an edge that see two surfaces, whose depth may lie where nothing is.

A pixel that sees the edge of a near surface in front of a far one collects light of both. Where
they are too close to be told apart within the pixel, its fit gives one depth between them with a
small standard deviation. The neighbors tell: on either side of the edge lie pixels that see one
surface only (`edges`). A pixel at an edge is mixed if its depth differs significantly from both
surfaces and lies between them, or if its counts need both (`edge_fit`). It is then given the
depths of both, and the share of its area that the near one covers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.reconstruction.edges import REACH, Edges, find_edges, neighbors

LARGEST_SHARE_STD = 0.15  #: a share that is known less well is not stated


@dataclass(frozen=True)
class MixedPixels:
    """Pixels that see two surfaces, and the depths of these beside them.

    Attributes
    ----------
    mixed : ndarray of bool, shape (row, col)
        True for mixed pixels.
    near, far : ndarray of float, shape (row, col)
        Depth of the near and of the far surface, m; NaN where a pixel is not mixed.
    near_std, far_std : ndarray of float, shape (row, col)
        Standard deviations of these depths, m.
    """

    mixed: NDArray[np.bool_]
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    near_std: NDArray[np.float64]
    far_std: NDArray[np.float64]


@dataclass(frozen=True)
class Plateaus:
    """Light of the surfaces beside pixels at edges.

    Attributes
    ----------
    near, far : ndarray of float, shape (band, pixel)
        Signal relative to the reference, not corrected for the distance.
    near_variance, far_variance : ndarray of float, shape (band, pixel)
        Their variances.
    near_spread, far_spread : ndarray of float, shape (band, pixel)
        Variances with which they tell the light of another pixel of the surface: what the
        neighbors differ by besides their noise is added.
    """

    near: NDArray[np.float64]
    far: NDArray[np.float64]
    near_variance: NDArray[np.float64]
    far_variance: NDArray[np.float64]
    near_spread: NDArray[np.float64]
    far_spread: NDArray[np.float64]

    def take(self, chosen: NDArray[np.bool_]) -> Plateaus:
        """Return some of the pixels.

        Parameters
        ----------
        chosen : ndarray of bool, shape (pixel,)
            Pixels to keep.

        Returns
        -------
        Plateaus
            The same of these pixels.
        """
        return Plateaus(*(getattr(self, name)[:, chosen] for name in self.__dataclass_fields__))


def find_mixed(
    depth: NDArray[np.floating],
    depth_std: NDArray[np.floating],
    pixel_angle: float,
) -> MixedPixels:
    """Find the pixels whose depth lies between two surfaces beside them.

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
    MixedPixels
        Mixed pixels, and the surfaces beside them.
    """
    edges = find_edges(depth, depth_std, pixel_angle)
    return spread_out(edges.take(edges.between), depth.shape)


def spread_out(edges: Edges, shape: tuple[int, ...]) -> MixedPixels:
    """Return mixed pixels as planes.

    Parameters
    ----------
    edges : Edges
        The mixed pixels.
    shape : tuple of int
        Rows and columns of the image.

    Returns
    -------
    MixedPixels
        The same as planes, NaN elsewhere.
    """
    mixed = np.zeros(shape, bool)
    mixed[edges.row, edges.col] = True
    surfaces = np.full((4, *shape), np.nan)
    surfaces[:, edges.row, edges.col] = edges.near, edges.far, edges.near_std, edges.far_std
    return MixedPixels(mixed, *surfaces)


def plateaus_of(
    edges: Edges,
    depth: NDArray[np.floating],
    depth_std: NDArray[np.floating],
    signal: NDArray[np.floating],
    signal_std: NDArray[np.floating],
) -> Plateaus:
    """Return the light of the surfaces beside pixels, as the mean over the neighbors on each.

    Parameters
    ----------
    edges : Edges
        Pixels at edges.
    depth, depth_std : ndarray of float, shape (row, col)
        Depth and its standard deviation, m.
    signal, signal_std : ndarray of float, shape (band, row, col)
        Reflectance without range correction, and its standard deviation.

    Returns
    -------
    Plateaus
        Light of either surface.
    """
    bands = len(signal)
    planes = np.empty((*depth.shape, 2 + 2 * bands), np.float32)
    planes[..., 0], planes[..., 1] = depth, depth_std
    planes[..., 2 : 2 + bands] = np.moveaxis(signal, 0, -1)
    planes[..., 2 + bands :] = np.moveaxis(signal_std, 0, -1)
    about = neighbors(planes, edges.row, edges.col)  # pixel, neighbor, plane
    light = about[..., 2:]
    known = np.asarray(np.isfinite(light).all(axis=-1))
    light[~known] = 0.0
    light[..., bands:] **= 2
    # a mixed pixel is no member: it differs from both surfaces
    surfaces = np.stack([edges.near, edges.far], axis=1).astype(np.float32)
    off = np.abs(about[:, None, :, 0] - surfaces[..., None])
    members = known[:, None] & (off < REACH * about[:, None, :, 1])
    count = members.sum(axis=-1, keepdims=True, dtype=np.float32).clip(1)
    sums = members.astype(np.float32) @ light / count  # pixel, surface, plane
    means = sums.transpose(1, 2, 0).astype(np.float64)  # surface, plane, pixel
    many = count.transpose(1, 2, 0).astype(np.float64)
    variances = means[:, bands:] / many
    squares = (members.astype(np.float32) @ light[..., :bands] ** 2 / count).transpose(1, 2, 0)
    scatter = (squares - means[:, :bands] ** 2) * many / np.maximum(many - 1, 1)
    spread = variances + np.maximum(scatter - means[:, bands:], 0.0)
    return Plateaus(*means[:, :bands], *variances, *spread)


def near_share(
    edges: Edges,
    plateaus: Plateaus,
    depth: NDArray[np.floating],
    depth_std: NDArray[np.floating],
    signal: NDArray[np.floating],
    signal_std: NDArray[np.floating],
    weights: NDArray[np.floating],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return which share of each mixed pixel the near surface covers.

    Two measurements are averaged by their variances: where the depth lies between those of the two
    surfaces, and where the light lies between that of the neighbors on either surface.

    Parameters
    ----------
    edges : Edges
        Mixed pixels, and the surfaces beside them.
    plateaus : Plateaus
        Light of these surfaces.
    depth, depth_std : ndarray of float, shape (row, col)
        Depth and its standard deviation, m.
    signal, signal_std : ndarray of float, shape (band, row, col)
        Reflectance without range correction, and its standard deviation.
    weights : ndarray of float, shape (band,)
        How much a band of reflectance 1 contributes to the pixel's depth.

    Returns
    -------
    share : ndarray of float, shape (pixel,)
        Share of the pixel's area.
    share_std : ndarray of float, shape (pixel,)
        Its standard deviation.
    """
    row, col = edges.row, edges.col
    of_near, of_far = plateaus.near, plateaus.far
    # a surface that returns more light draws the depth towards itself
    light_near = np.maximum(weights @ of_near, np.finfo(float).tiny)
    light_far = np.maximum(weights @ of_far, np.finfo(float).tiny)
    step = edges.far - edges.near
    light = (edges.far - depth[row, col]) / step
    light_variance = (
        depth_std[row, col] ** 2
        + (light * edges.near_std) ** 2
        + ((1 - light) * edges.far_std) ** 2
    ) / step**2
    mixture = light * light_far + (1 - light) * light_near
    by_depth = light * light_far / mixture
    depth_information = (mixture**2 / (light_near * light_far)) ** 2 / light_variance

    contrast = of_near - of_far
    noise = plateaus.near_variance + plateaus.far_variance
    variance = signal_std[:, row, col] ** 2 + noise / 4
    # noise alone looks like a contrast of this size
    squared = (contrast**2 - noise) / variance
    color_information = np.maximum(squared.sum(axis=0), 0.0)
    projected = ((signal[:, row, col] - of_far) * contrast / variance).sum(axis=0)
    usable = color_information > 0
    by_color = np.where(usable, projected / np.where(usable, color_information, 1.0), 0.0)
    information = depth_information + color_information
    combined = (depth_information * by_depth + color_information * by_color) / information
    return np.clip(combined, 0, 1), information**-0.5


def stated_share(
    share: NDArray[np.float64], share_std: NDArray[np.float64], edges: Edges, shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return shares as planes, NaN where they are known too badly to be stated.

    Parameters
    ----------
    share, share_std : ndarray of float, shape (pixel,)
        Shares of mixed pixels, and their standard deviations.
    edges : Edges
        These pixels.
    shape : tuple of int
        Rows and columns of the image.

    Returns
    -------
    share : ndarray of float, shape (row, col)
        Plane of shares.
    share_std : ndarray of float, shape (row, col)
        Plane of their standard deviations.
    """
    planes = np.full((2, *shape), np.nan)
    told = share_std <= LARGEST_SHARE_STD
    planes[:, edges.row[told], edges.col[told]] = share[told], share_std[told]
    return planes[0], planes[1]


def depth_weights(calibration: Calibration) -> NDArray[np.float64]:
    """Return how much each band contributes to depth at reflectance 1.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    ndarray of float, shape (band,)
        Weights, on any scale.
    """
    widths_ns = np.array([band.pulse_fwhm_ns for band in calibration.instrument.bands])
    return calibration.brightness / widths_ns**2
