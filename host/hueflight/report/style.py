# SPDX-License-Identifier: Apache-2.0
"""Common style of all figures of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from hueflight.color.colormap import table

#: color map of depth: perceptually uniform, and readable without colour vision
DEPTH_MAP = ListedColormap(table() / 255, name="hueflight")
TRUTH = {"color": "0.15", "linewidth": 1.2, "linestyle": "--"}
MEASURED = {"color": "#c2410c", "linewidth": 1.1}
PAPER = {"color": "#1d4ed8", "linewidth": 0.9}  #: results of the paper's method
JOINT = MEASURED  #: results of the joint fit, or of pooling
INK = "#1f2937"

SETTINGS: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": "0.6",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "figure.dpi": 110,
    "savefig.bbox": "tight",
    "savefig.pad_inches": 0.08,
}


def panels(
    rows: int = 1, cols: int = 1, *, width: float = 9.0, height: float = 3.2, **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """Make a figure with a grid of axes in the style of the report.

    Parameters
    ----------
    rows, cols : int
        Number of rows and columns of the grid.
    width, height : float
        Size of the figure, inches.
    **options : Any
        Further arguments of `matplotlib.figure.Figure.subplots`.

    Returns
    -------
    figure : Figure
        The figure.
    axes : ndarray of Axes, shape (rows, cols)
        Its axes.
    """
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.subplots(rows, cols, squeeze=False, **options)
    return figure, axes


def show_plane(
    axes: Axes,
    plane: NDArray[np.floating],
    *,
    aspect: float,
    title: str = "",
    limits: tuple[float, float] | None = None,
    colours: str | Colormap = "gray",
) -> AxesImage:
    """Show a plane of an image in true proportions, with missing pixels in pale pink.

    Parameters
    ----------
    axes : Axes
        Axes to draw into.
    plane : ndarray of float, shape (row, col)
        Values to show; NaN where a pixel is missing.
    aspect : float
        Height of a pixel divided by its width.
    title : str
        Title of the axes.
    limits : tuple of float or None
        Values at the ends of the color map; None for the range of the plane.
    colours : str or Colormap
        Color map.

    Returns
    -------
    AxesImage
        The picture, to which a colour bar can refer.
    """
    colour_map = mpl.colormaps.get_cmap(colours).with_extremes(bad="#d8b4b4")
    low, high = limits if limits else (None, None)
    shown = axes.imshow(
        np.ma.masked_invalid(plane),
        cmap=colour_map,
        vmin=low,
        vmax=high,
        aspect=aspect,
        interpolation="nearest",
    )
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_title(title)
    return shown


def pixel_aspect(instrument: Any) -> float:
    """Height of a pixel divided by its width; 1 if the pitch is unknown."""
    sensor = instrument.sensor
    if sensor.pixel_width_um and sensor.pixel_height_um:
        return sensor.pixel_height_um / sensor.pixel_width_um
    return 1.0


def label_lines(axes: Axes, x: str, y: str, *, legend: bool | Sequence[str] = True) -> None:
    """Label both axes, and add a legend unless `legend` is False."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if legend:
        axes.legend(fontsize=8)
