"""Mixed pixels: those at an edge whose depth lies between two surfaces, where nothing is.

A pixel that sees the edge of a near surface in front of a far one collects light of both. Where
they are too close to be told apart within the pixel, its fit gives one depth between them with a
small standard deviation. The neighbors tell: on either side of the edge lie pixels that see one
surface only. In the window about each pixel, the depths of a near and of a far surface are
estimated; a pixel whose depth differs significantly from both and lies between them is mixed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, radians, tan

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import ImageError
from hueflight.files.image_schema import SERIES_DIM, require_image
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.quality import Quality, flag_attributes
from hueflight.reconstruction.range_correction import relative_signal

WINDOW = 5  #: rows and columns of the window about a pixel
RANK = 3  #: the extremes start from the depth of this rank, which one outlier does not change
SHIFTS = 3  #: steps of the mean shift
REACH = 2.5  #: standard deviations within which a pixel belongs to a surface
LEAST_PIXELS = 2  #: in the window that each surface needs
STEEPEST_DEGREES = 80.0  #: a single surface is tilted by no more than this
EDGE_DEVIATIONS = 4.0  #: by which a step exceeds what a tilted surface changes
OWN_DEVIATIONS = 2.0  #: of the pixel itself, than which a smaller step is not looked at
SIGNIFICANT = 2.2  #: standard deviations by which a mixed pixel differs from either surface
LARGEST_SHARE_STD = 0.15  #: a share that is known less well is not stated
STRIP_ROWS = 32  #: rows taken at once: their windows stay in the cache


@dataclass(frozen=True)
class MixedPixels:
    """Pixels whose depth lies between two surfaces beside them.

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
    rows, cols = depth.shape
    mixed = np.zeros((rows, cols), bool)
    surfaces = np.full((4, rows, cols), np.nan)
    known = np.isfinite(depth) & (depth_std > 0)
    planes = np.where(known, np.stack([depth, depth_std]), np.nan)
    windows = _windows(planes)
    center = WINDOW * WINDOW // 2
    for first in range(0, rows, STRIP_ROWS):
        strip = slice(first, first + STRIP_ROWS)
        part = windows[:, strip]
        others = np.delete(part.reshape(*part.shape[:3], -1), center, axis=-1)
        mixed[strip], surfaces[:, strip] = _between_neighbors(planes[:, strip], others, pixel_angle)
    return MixedPixels(mixed, *surfaces)


def near_share(
    found: MixedPixels,
    depth: NDArray[np.floating],
    depth_std: NDArray[np.floating],
    reflectance: NDArray[np.floating],
    reflectance_std: NDArray[np.floating],
    weights: NDArray[np.floating],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return which share of each mixed pixel the near surface covers.

    Two measurements are averaged by their variances: where the depth lies between those of the two
    surfaces, and where the reflectance lies between those of the neighbors on either surface.

    Parameters
    ----------
    found : MixedPixels
        Mixed pixels, and the surfaces beside them.
    depth, depth_std : ndarray of float, shape (row, col)
        Depth and its standard deviation, m.
    reflectance, reflectance_std : ndarray of float, shape (band, row, col)
        Reflectance and its standard deviation.
    weights : ndarray of float, shape (band,)
        How much a band of reflectance 1 contributes to the pixel's depth.

    Returns
    -------
    share : ndarray of float, shape (row, col)
        Share of the pixel's area; NaN where a pixel is not mixed.
    share_std : ndarray of float, shape (row, col)
        Its standard deviation.
    """
    share, share_std = np.full((2, *depth.shape), np.nan)
    row, col = np.nonzero(found.mixed)
    if not row.size:
        return share, share_std
    near, far = found.near[row, col], found.far[row, col]
    depths, deviations = _windows(np.stack([depth, depth_std]))[:, row, col]
    colors, color_stds = (
        _windows(values)[:, row, col] for values in (reflectance, reflectance_std)
    )
    means = []
    for surface in (near, far):
        # a mixed pixel is no member: it differs from both surfaces
        members = np.abs(depths - surface[:, None, None]) < REACH * deviations
        members &= np.isfinite(colors).all(axis=0)
        count = np.maximum(members.sum(axis=(-2, -1)), 1)
        mean = np.where(members, colors, 0).sum(axis=(-2, -1)) / count
        variance = np.where(members, color_stds**2, 0).sum(axis=(-2, -1)) / count**2
        means.append((mean, variance))
    (of_near, near_variance), (of_far, far_variance) = means

    # a surface that returns more light draws the depth towards itself
    light_near = np.maximum(weights @ of_near, np.finfo(float).tiny)
    light_far = np.maximum(weights @ of_far, np.finfo(float).tiny)
    step = far - near
    light = (far - depth[row, col]) / step
    light_variance = (
        depth_std[row, col] ** 2
        + (light * found.near_std[row, col]) ** 2
        + ((1 - light) * found.far_std[row, col]) ** 2
    ) / step**2
    mixture = light * light_far + (1 - light) * light_near
    by_depth = light * light_far / mixture
    depth_information = (mixture**2 / (light_near * light_far)) ** 2 / light_variance

    contrast = of_near - of_far
    variance = reflectance_std[:, row, col] ** 2 + (near_variance + far_variance) / 4
    # noise alone looks like a contrast of this size
    squared = (contrast**2 - near_variance - far_variance) / variance
    color_information = np.maximum(squared.sum(axis=0), 0.0)
    projected = ((reflectance[:, row, col] - of_far) * contrast / variance).sum(axis=0)
    usable = color_information > 0
    by_color = np.where(usable, projected / np.where(usable, color_information, 1.0), 0.0)
    information = depth_information + color_information
    combined = (depth_information * by_depth + color_information * by_color) / information
    share[row, col] = np.clip(combined, 0, 1)
    share_std[row, col] = information**-0.5
    return share, share_std


def flag_mixed(
    image: xr.Dataset, calibration: Calibration, /, *, pixel_angle: float | None = None
) -> xr.Dataset:
    """Flag the mixed pixels of an image, and add the depths of the two surfaces beside them.

    Parameters
    ----------
    image : Dataset
        Image from ``method="joint"`` or ``"paper"``, whose errors are independent from pixel to
        pixel.
    calibration : Calibration
        Calibration with which it was reconstructed.
    pixel_angle : float, optional
        Angle between neighboring pixels, rad; by default that of the instrument's lens. It tells
        how much the depth of a tilted surface changes from pixel to pixel.

    Returns
    -------
    Dataset
        The image with `Quality.MIXED` in `quality`, and the variables `mixed_near_depth` and
        `mixed_far_depth`, m, and `mixed_share`, the share of the pixel that the near surface
        covers. They are NaN where a pixel is not mixed, and the share also where its standard
        deviation exceeds 0.15. `depth` is left as it is.

    Raises
    ------
    ImageError
        If it is not a single image with the standard deviation of depth, if its pixels share their
        photons, or if the angle is invalid, or not given for an instrument without a lens.
    """
    require_image(image)
    if SERIES_DIM in image.dims:
        raise ImageError(
            f"this is a series of {image.sizes[SERIES_DIM]} images: select one, as with "
            f"image.isel({SERIES_DIM}=0)"
        )
    for name in ("depth_std", "reflectance_std", "band_name"):
        if name not in image.variables:
            raise ImageError(f"the image has no {name}, which is needed to find mixed pixels")
    if "resolution" in image:
        raise ImageError(
            "the pixels of this image share their photons, so that neighbors do not tell whether "
            "a pixel is mixed: reconstruct with method='joint'"
        )
    angle = _pixel_angle(calibration.instrument) if pixel_angle is None else pixel_angle
    if not (isfinite(angle) and angle > 0):
        raise ImageError(f"pixel_angle = {angle!r}: give the angle between pixels in radians")
    planes = image.transpose("band", "row", "col")
    values = {name: planes[name].values.astype(np.float64) for name in ("depth", "depth_std")}
    # the light of two surfaces adds up as it arrives, so that a correction for range is undone
    values["reflectance"], values["reflectance_std"] = relative_signal(image, calibration)
    quality = planes["quality"].values
    values["depth"][(quality & int(Quality.AMBIGUOUS)) != 0] = np.nan
    found = find_mixed(values["depth"], values["depth_std"], angle)
    share, share_std = near_share(found, **values, weights=_depth_weights(image, calibration))
    share[share_std > LARGEST_SHARE_STD] = np.nan
    flags = quality & ~np.uint16(Quality.MIXED)
    flags[found.mixed] |= np.uint16(Quality.MIXED)
    plane = ("row", "col")
    added = {
        name: (plane, of_all.astype(np.float32), {"units": unit, "long_name": long_name})
        for name, of_all, unit, long_name in (
            ("mixed_near_depth", found.near, "m", "depth of the near surface at a mixed pixel"),
            ("mixed_far_depth", found.far, "m", "depth of the far surface at a mixed pixel"),
            ("mixed_share", share, "1", "share of a mixed pixel that the near surface covers"),
        )
    }
    attributes = {**image["quality"].attrs, **flag_attributes()}
    return image.assign({"quality": (plane, flags, attributes), **added})


def _depth_weights(image: xr.Dataset, calibration: Calibration) -> NDArray[np.float64]:
    """Return how much each of the image's bands contributes to depth at reflectance 1."""
    instrument = calibration.instrument
    names = [band.name for band in instrument.bands]
    widths_ns = np.array([band.pulse_fwhm_ns for band in instrument.bands])
    of_all = calibration.brightness / widths_ns**2
    return of_all[[names.index(name) for name in image["band_name"].values.tolist()]]


def _windows(planes: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the window about each pixel, (plane, row, col, WINDOW, WINDOW), NaN outside."""
    margin = WINDOW // 2
    padding = ((0, 0), (margin, margin), (margin, margin))
    padded = np.pad(planes.astype(np.float64), padding, constant_values=np.nan)
    return sliding_window_view(padded, (WINDOW, WINDOW), axis=(1, 2))


def _pixel_angle(instrument: Instrument) -> float:
    """Return the largest angle between neighboring pixels, rad."""
    if instrument.lens is None:
        raise ImageError(
            f"the instrument {instrument.name!r} has no lens, which would tell the angle between "
            "pixels: give pixel_angle in radians"
        )
    right, down = instrument.ray_slopes()
    steps = (np.abs(np.diff(right, axis=1)), np.abs(np.diff(down, axis=0)))
    return max((float(step.max()) for step in steps if step.size), default=0.0)


def _between_neighbors(
    own: NDArray[np.float64], others: NDArray[np.float64], pixel_angle: float
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return which pixels are mixed, and (near, far, near_std, far_std) of their surfaces.

    `own` holds depth and deviation of the pixels, (2, row, col), and `others` those of the pixels
    about each, (2, row, col, neighbor); NaN where not known.
    """
    shape = own.shape[1:]
    known = np.isfinite(others[0]).sum(axis=-1)
    pixels = np.flatnonzero(np.isfinite(own[0]).ravel() & (known.ravel() >= 2 * LEAST_PIXELS))
    own = own.reshape(2, -1)[:, pixels]
    others = others.reshape(2, -1, others.shape[-1])[:, pixels]
    # a plane's steepest change from one end of the window to the other
    limit = tan(radians(STEEPEST_DEGREES)) * (WINDOW - 1) * pixel_angle
    ordered = np.sort(others[0], axis=-1)  # NaN last
    last = known.ravel()[pixels] - 1
    rank = np.minimum(RANK - 1, last)
    line = np.arange(len(pixels))
    starts = ordered[line, rank], ordered[line, last - rank]
    # most pixels lie on one surface: no need to look closer
    stepped = starts[1] - starts[0] > limit * starts[0] / 2
    pixels, own, others = pixels[stepped], own[:, stepped], others[:, stepped]
    near, near_std, near_pixels = _surface(others, starts[0][stepped])
    far, far_std, far_pixels = _surface(others, starts[1][stepped])
    depth, std = own
    step = far - near
    edge = (
        (step > limit * near + EDGE_DEVIATIONS * np.hypot(near_std, far_std))
        & (step > OWN_DEVIATIONS * std)
        & (np.minimum(near_pixels, far_pixels) >= LEAST_PIXELS)
    )
    between = (depth - near > SIGNIFICANT * np.hypot(std, near_std)) & (
        far - depth > SIGNIFICANT * np.hypot(std, far_std)
    )
    chosen = edge & between
    mixed = np.zeros(shape, bool)
    surfaces = np.full((4, *shape), np.nan)
    mixed.ravel()[pixels[chosen]] = True
    found = np.stack([near, far, near_std, far_std])
    surfaces.reshape(4, -1)[:, pixels[chosen]] = found[:, chosen]
    return mixed, surfaces


def _surface(
    others: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]]:
    """Return depth, deviation and number of pixels of the surface at `start`, by mean shift.

    Extremes of several depths are biased outwards; the mean of the pixels about them is not.
    """
    depths, deviations = others
    weights = np.where(np.isfinite(depths), 1 / deviations**2, 0.0)
    values = np.where(np.isfinite(depths), depths, 0.0)
    center, total, members = start, np.ones_like(start), np.zeros(depths.shape, bool)
    for _ in range(SHIFTS):
        members = np.abs(depths - center[:, None]) < REACH * deviations
        share = weights * members
        total = share.sum(axis=-1)
        found = (share * values).sum(axis=-1) / np.where(total > 0, total, 1.0)
        center = np.where(total > 0, found, center)
    return center, np.where(total > 0, total, np.inf) ** -0.5, members.sum(axis=-1)
