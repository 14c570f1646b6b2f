# SPDX-License-Identifier: Apache-2.0
"""Preview of an image: depth, and three bands as an RGB picture."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from hueflight.color.display import three_band_rgb
from hueflight.model.instrument import Instrument
from hueflight.report.style import DEPTH_MAP, panels, pixel_aspect, show_plane


def draw_preview(image: xr.Dataset, instrument: Instrument) -> Figure:
    """Draw the depth with a colour bar and, next to it, three bands as an RGB picture.

    Parameters
    ----------
    image : Dataset
        Image with the variables `depth` and `reflectance`.
    instrument : Instrument
        Instrument whose pixel pitch gives the proportions of the picture.

    Returns
    -------
    Figure
        The drawing; without an RGB picture if no pixel has a reflectance.
    """
    aspect = pixel_aspect(instrument)
    depth = image["depth"].values
    figure, ((left, right),) = panels(1, 2, width=10, height=3.4)
    limits = None
    if np.isfinite(depth).any():
        low, high = np.nanpercentile(depth, [1, 99])
        limits = (float(low), float(high) if high > low else float(low) + 0.01)
    shown = show_plane(left, depth, aspect=aspect, limits=limits, colours=DEPTH_MAP, title="depth")
    figure.colorbar(shown, ax=left, label="depth / m", shrink=0.85)
    right.axis("off")
    if np.isfinite(image["reflectance"].values).any():
        right.imshow(three_band_rgb(image), aspect=aspect, interpolation="nearest")
        right.set_title("three bands as RGB")
    return figure
