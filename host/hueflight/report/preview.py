"""A picture of one image: depth beside the three-band colours."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from hueflight.color.display import three_band_rgb
from hueflight.model.instrument import Instrument
from hueflight.report.style import DEPTH_MAP, panels, pixel_aspect, show_plane


def draw_preview(image: xr.Dataset, instrument: Instrument) -> Figure:
    """Depth with a colour bar and, where the image has light, the RGB picture."""
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
