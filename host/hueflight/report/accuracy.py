# SPDX-License-Identifier: Apache-2.0
"""How near an image is to the truth of its scene, for the table of the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from hueflight.report.experiments import Capture


@dataclass(frozen=True)
class Accuracy:
    """Errors of the pixels that light reaches and that have a depth without a flag.

    Attributes
    ----------
    reflectance : float
        Root mean square error of reflectance over all bands, 1 for white.
    depth : float
        Median absolute error of depth, m.
    within : float
        Share of the depths that lie within their stated deviation of the truth; 0.68 is right.
    known : float
        Share that these pixels are of those that light reaches.
    """

    reflectance: float
    depth: float
    within: float
    known: float


def accuracy(capture: Capture, image: xr.Dataset) -> Accuracy:
    """Compare an image with the truth of its scene.

    Parameters
    ----------
    capture : Capture
        Capture of a simulated scene.
    image : Dataset
        One of its images. Its reflectance means something only if it is corrected for range.

    Returns
    -------
    Accuracy
        The comparison.
    """
    truth, depth = capture.truth, image["depth"].values
    good = truth.lit & (image["quality"].values == 0) & np.isfinite(depth)
    error = np.abs(depth - truth.depth)[good]
    reflectance = (image["reflectance"].values - np.moveaxis(truth.reflectance, 0, -1))[good]
    return Accuracy(
        reflectance=float(np.sqrt(np.nanmean(np.square(reflectance)))),
        depth=float(np.median(error)),
        within=float(np.mean(error < image["depth_std"].values[good])),
        known=float(good.sum() / truth.lit.sum()),
    )
