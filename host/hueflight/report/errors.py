# SPDX-License-Identifier: Apache-2.0
"""Errors of an image against the truth of its scene, for the table of the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.report.experiments import Capture


@dataclass(frozen=True)
class ImageErrors:
    """How far an image is from the truth, over the pixels that light reaches.

    Attributes
    ----------
    reflectance : float
        Root mean square error of reflectance over all bands, 1 for white.
    depth : float
        Median absolute error of depth, m.
    wrong : float
        Share of the depths that are more than 10 cm off.
    known : float
        Share of the pixels that have a depth without a flag.
    """

    reflectance: float
    depth: float
    wrong: float
    known: float


WRONG_M = 0.1  #: error from which a depth is called wrong


def image_errors(capture: Capture, image: xr.Dataset) -> ImageErrors:
    """Compare an image with the truth of its scene.

    Parameters
    ----------
    capture : Capture
        Capture of a simulated scene.
    image : Dataset
        One of its images, with reflectance that is corrected for range.

    Returns
    -------
    ImageErrors
        Errors of the pixels that are lit and have no flag in this image.
    """
    truth = capture.truth
    good = truth.lit & (image["quality"].values == 0) & np.isfinite(image["depth"].values)
    depth = np.abs(image["depth"].values - truth.depth)[good]
    reflectance = (image["reflectance"].values - np.moveaxis(truth.reflectance, 0, -1))[good]
    return ImageErrors(
        reflectance=float(np.sqrt(np.nanmean(np.square(reflectance)))),
        depth=float(np.median(depth)),
        wrong=float(np.mean(depth > WRONG_M)),
        known=float(good.sum() / truth.lit.sum()),
    )


def stated_deviations_hold(capture: Capture, image: xr.Dataset) -> float:
    """Share of the depths that lie within their stated deviation of the truth; 0.68 is right.

    Parameters
    ----------
    capture : Capture
        Capture of a simulated scene.
    image : Dataset
        One of its images.

    Returns
    -------
    float
        The share, of the pixels that are lit and have no flag.
    """
    good = capture.truth.lit & (image["quality"].values == 0)
    distance: NDArray[np.float64] = np.abs(image["depth"].values - capture.truth.depth)[good]
    return float(np.mean(distance < image["depth_std"].values[good]))
