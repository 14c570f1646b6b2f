# SPDX-License-Identifier: Apache-2.0
"""Give mixed pixels the depths of both surfaces that they see, in estimates and in images."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.arguments import NUMBER, takes
from hueflight.calibration import Calibration
from hueflight.errors import ImageError
from hueflight.files.image_schema import SERIES_DIM, require_image
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.edge_fit import sees_both, waveforms
from hueflight.reconstruction.edges import Edges, find_edges
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.fitted_counts import FittedCounts, arrival_ns
from hueflight.reconstruction.image import LONG_NAMES, UNITS
from hueflight.reconstruction.mixed_pixels import (
    Plateaus,
    depth_weights,
    near_share,
    plateaus_of,
    spread_out,
    stated_share,
)
from hueflight.reconstruction.quality import Quality, flag_attributes
from hueflight.reconstruction.range_correction import (
    relative_range,
    relative_signal,
    uncorrected,
    widened,
)

ASKED = (
    2.0  #: standard deviations by which a share differs from 0 and 1 before counts are looked at
)
LEAST_BACKGROUND = 0.02  #: share of a pixel's counts in the fit that both surfaces must match

_Floats = NDArray[np.float64]


def with_both_depths(
    estimates: Estimates, fitted: FittedCounts, calibration: Calibration
) -> Estimates:
    """Find the mixed pixels of estimates, and give them the depths of both surfaces.

    Parameters
    ----------
    estimates : Estimates
        Result of the joint fit.
    fitted : FittedCounts
        Counts that it was made from.
    calibration : Calibration
        Calibration of an instrument with a lens.

    Returns
    -------
    Estimates
        The same with `Quality.MIXED`. `depth` of a mixed pixel is that of the near surface, and
        `second_depth` that of the far one.
    """
    depth, depth_std = estimates.depth.copy(), estimates.depth_std
    depth[(estimates.quality & int(Quality.AMBIGUOUS_LAG)) != 0] = np.nan
    edges = find_edges(depth, depth_std, lens_angle(calibration.instrument))
    if not edges.row.size:
        return _without_mixed(estimates)
    signal, signal_std = estimates.reflectance, estimates.reflectance_std
    if fitted.range_correction:
        signal, signal_std = uncorrected(
            signal, signal_std, estimates.depth, depth_std, calibration
        )
    plateaus = plateaus_of(edges, depth, depth_std, signal, signal_std)
    mixed = edges.between.copy()
    values = (depth, depth_std, signal, signal_std)
    share, share_std = near_share(edges, plateaus, *values, depth_weights(calibration))
    # the likelihood takes time, and the share tells most pixels that see one surface only
    asked = ~mixed & (np.minimum(share, 1 - share) > ASKED * share_std)
    if fitted.tables.resolved and asked.any():
        mixed[asked] = _by_counts(
            edges.take(asked), plateaus.take(asked), estimates, signal, fitted, calibration
        )
    edges, plateaus = edges.take(mixed), plateaus.take(mixed)
    share, share_std = share[mixed], share_std[mixed]
    found = spread_out(edges, depth.shape)
    share, share_std = stated_share(share, share_std, edges, depth.shape)
    quality = estimates.quality.copy()
    quality[found.mixed] |= np.uint16(Quality.MIXED)
    new_depth = np.where(found.mixed, found.near, estimates.depth)
    new_std = np.where(found.mixed, found.near_std, depth_std)
    reflectance, reflectance_std = estimates.reflectance, estimates.reflectance_std
    white = estimates.white_photons
    if white is not None and fitted.range_correction and edges.row.size:
        here = np.s_[:, edges.row, edges.col]
        white = np.where(
            found.mixed, fitted.white / relative_range(found.near, calibration) ** 2, white
        )
        factor = relative_range(found.near, calibration)[found.mixed] ** 2
        reflectance, reflectance_std = reflectance.copy(), reflectance_std.copy()
        reflectance[here] = factor * signal[here]
        reflectance_std[here] = widened(
            factor * signal_std[here], reflectance[here], edges.near, edges.near_std
        )
    surfaces = _surface_light(edges, plateaus, fitted, calibration, reflectance.shape)
    return replace(
        estimates,
        depth=new_depth,
        depth_std=new_std,
        reflectance=reflectance,
        reflectance_std=reflectance_std,
        white_photons=white,
        quality=quality,
        second_depth=found.far,
        second_depth_std=found.far_std,
        near_share=share,
        near_share_std=share_std,
        **surfaces,
    )


def _without_mixed(estimates: Estimates) -> Estimates:
    """Estimates of an image without edges: what is said of mixed pixels is NaN."""
    planes = ("second_depth", "second_depth_std", "near_share", "near_share_std")
    cubes = ("near_reflectance", "second_reflectance")
    nothing: dict[str, Any] = {name: np.full(estimates.depth.shape, np.nan) for name in planes}
    for name in (*cubes, *(f"{cube}_std" for cube in cubes)):
        nothing[name] = np.full(estimates.reflectance.shape, np.nan, np.float32)
    return replace(estimates, **nothing)


def _surface_light(
    edges: Edges,
    plateaus: Plateaus,
    fitted: FittedCounts,
    calibration: Calibration,
    shape: tuple[int, ...],
) -> dict[str, NDArray[np.float32]]:
    """Reflectances of the surfaces beside mixed pixels as cubes, NaN in all other pixels."""
    cubes = {}
    for surface, depth, depth_std, light, variance in (
        ("near", edges.near, edges.near_std, plateaus.near, plateaus.near_spread),
        ("second", edges.far, edges.far_std, plateaus.far, plateaus.far_spread),
    ):
        deviation = np.sqrt(variance)
        if fitted.range_correction:
            factor = relative_range(depth, calibration) ** 2
            light = factor * light
            deviation = widened(factor * deviation, light, depth, depth_std)
        for name, values in (("reflectance", light), ("reflectance_std", deviation)):
            cube = np.full(shape, np.nan, np.float32)
            cube[:, edges.row, edges.col] = values
            cubes[f"{surface}_{name}"] = cube
    return cubes


def _by_counts(
    edges: Edges,
    plateaus: Plateaus,
    estimates: Estimates,
    signal: NDArray[np.floating],
    fitted: FittedCounts,
    calibration: Calibration,
) -> NDArray[np.bool_]:
    """Tell the pixels whose counts need both surfaces."""
    here = edges.row, edges.col
    numbers = np.ravel_multi_index(here, estimates.depth.shape)
    level = fitted.tables.wide
    light = fitted.of(numbers, estimates.photons, calibration)
    counts = fitted.tables.wide_counts(light)
    photons = fitted.white_photons(numbers, calibration)

    def expected(depth: _Floats, light: NDArray[np.floating]) -> _Floats:
        return waveforms(level, arrival_ns(depth, numbers, calibration), light.T * photons)

    background = estimates.background[here] * calibration.bins.span_ns / calibration.bin_width_ns
    background = np.maximum(background, LEAST_BACKGROUND * counts.sum(axis=-1))
    widths = level.widths.astype(np.float64)
    own = expected(estimates.depth[here], signal[:, *here]) + background[:, None] * widths
    near, far = expected(edges.near, plateaus.near), expected(edges.far, plateaus.far)
    return sees_both(counts, near, far, own, widths)


@takes(image=xr.Dataset, calibration=Calibration, pixel_angle=NUMBER)
def flag_mixed(
    image: xr.Dataset, calibration: Calibration, /, *, pixel_angle: float | None = None
) -> xr.Dataset:
    """Find the mixed pixels of an image that was made without, by the neighbors alone.

    `reconstruct` does it with the counts as well, wherever the instrument has a lens.

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
        The image with `Quality.MIXED` in `quality`. `depth` of a mixed pixel is that of the near
        surface; the variables `second_depth`, m, and `near_share`, the share of the pixel that the
        near surface covers, and their standard deviations are NaN where a pixel is not mixed. The
        share is NaN also where its standard deviation exceeds 0.15.

    Raises
    ------
    ImageError
        If it is not a single image with the standard deviation of depth, if its mixed pixels were
        found before, if its pixels share their photons, or if the angle is invalid, or not given
        for an instrument without a lens.
    """
    angle = _checked_angle(image, calibration, pixel_angle)
    planes = image.transpose("band", "row", "col")
    depth, depth_std = (planes[name].values.astype(np.float64) for name in ("depth", "depth_std"))
    # the light of two surfaces adds up as it arrives, so that a correction for range is undone
    signal, signal_std = relative_signal(image, calibration)
    flags = planes["quality"].values.copy()
    fitted_depth = depth.copy()
    depth[(flags & int(Quality.AMBIGUOUS_LAG)) != 0] = np.nan
    edges = find_edges(depth, depth_std, angle)
    edges = edges.take(edges.between)
    values = (depth, depth_std, signal, signal_std)
    names = [band.name for band in calibration.instrument.bands]
    numbers = [names.index(name) for name in image["band_name"].values.tolist()]
    weights = depth_weights(calibration)[numbers]
    share, share_std = near_share(edges, plateaus_of(edges, *values), *values, weights)
    share, share_std = stated_share(share, share_std, edges, depth.shape)
    found = spread_out(edges, depth.shape)
    flags[found.mixed] |= np.uint16(Quality.MIXED)
    changed = {
        "depth": np.where(found.mixed, found.near, fitted_depth),
        "depth_std": np.where(found.mixed, found.near_std, depth_std),
        "second_depth": found.far,
        "second_depth_std": found.far_std,
        "near_share": share,
        "near_share_std": share_std,
    }
    for name in ("second_depth", "second_depth_std"):
        if name in image:  # of second returns
            changed[name] = np.where(found.mixed, changed[name], planes[name].values)
    variables: dict[str, Any] = {
        name: (
            ("row", "col"),
            plane.astype(np.float32),
            {"units": UNITS[name], "long_name": LONG_NAMES[name]},
        )
        for name, plane in changed.items()
    }
    attributes = {**image["quality"].attrs, **flag_attributes()}
    variables["quality"] = (("row", "col"), flags, attributes)
    if image["reflectance"].attrs.get("range_correction") == "inverse square":
        nearer = np.where(found.mixed, found.near / np.where(found.mixed, fitted_depth, 1), 1.0)
        factor = xr.DataArray(nearer.astype(np.float32) ** 2, dims=("row", "col"))
        for name in ("reflectance", "reflectance_std"):
            scaled = (image[name] * factor).transpose(*image[name].dims)
            variables[name] = image[name].copy(data=scaled.values)
    return image.assign(variables)


def lens_angle(instrument: Instrument) -> float:
    """Return the largest angle between neighboring pixels.

    Parameters
    ----------
    instrument : Instrument
        An instrument with a lens.

    Returns
    -------
    float
        The angle, rad.

    Raises
    ------
    ImageError
        If it has no lens.
    """
    if instrument.lens is None:
        raise ImageError(
            f"the instrument {instrument.name!r} has no lens, which would tell the angle between "
            "pixels: reconstruct with mixed=False, or add the lens to its description"
        )
    right, down = instrument.ray_slopes()
    steps = (np.abs(np.diff(right, axis=1)), np.abs(np.diff(down, axis=0)))
    return max((float(step.max()) for step in steps if step.size), default=0.0)


def _checked_angle(image: xr.Dataset, calibration: Calibration, pixel_angle: float | None) -> float:
    """Check that mixed pixels of an image can be found, and return the angle between pixels."""
    require_image(image)
    if SERIES_DIM in image.dims:
        raise ImageError(
            f"this is a series of {image.sizes[SERIES_DIM]} images: select one, as with "
            f"image.isel({SERIES_DIM}=0)"
        )
    for name in ("depth_std", "reflectance_std", "band_name"):
        if name not in image.variables:
            raise ImageError(f"the image has no {name}, which is needed to find mixed pixels")
    if "near_share" in image:
        raise ImageError(
            "the mixed pixels of this image have been found already: see its second_depth"
        )
    if "resolution" in image:
        raise ImageError(
            "the pixels of this image share their photons, so that neighbors do not tell whether "
            "a pixel is mixed: reconstruct with method='joint'"
        )
    if pixel_angle is None:
        instrument = calibration.instrument
        if instrument.lens is None:
            raise ImageError(
                f"the instrument {instrument.name!r} has no lens, which would tell the angle "
                "between pixels: give pixel_angle in radians"
            )
        return lens_angle(instrument)
    if not (isfinite(pixel_angle) and pixel_angle > 0):
        raise ImageError(f"pixel_angle = {pixel_angle!r}: give the angle between pixels in radians")
    return pixel_angle
