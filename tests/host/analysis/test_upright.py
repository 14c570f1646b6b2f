# SPDX-License-Identifier: Apache-2.0
"""Row 0 of an image is at the top of a plot, column 0 at its left."""

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.analysis import upright
from hueflight.errors import ImageError
from hueflight.testing.exporter import example_image

plt = pytest.importorskip("matplotlib.pyplot", reason="matplotlib is not installed")


def center_on_screen(mesh, row: int, col: int) -> tuple[float, float]:
    """Where the cell with the values of a pixel is drawn, from the left and from the bottom."""
    corners = mesh.get_coordinates()
    cell = corners[row : row + 2, col : col + 2].reshape(-1, 2).mean(axis=0)
    return tuple(mesh.axes.transData.transform(cell))


def test_plots_are_upright_and_in_degrees() -> None:
    paper = hf.Instrument.load("paper")
    image = example_image(paper)
    labelled = upright(image)
    figure, axes = plt.subplots()
    mesh = labelled.depth.plot(ax=axes)
    try:
        drawn = mesh.get_array().reshape(image.depth.shape)
        np.testing.assert_array_equal(np.ma.filled(drawn, np.nan), image.depth)
        left, top = center_on_screen(mesh, 0, 0)
        right, bottom = center_on_screen(mesh, 191, 127)
        assert left < right
        assert bottom < top
        assert axes.get_xlabel() == "right [degree]"
        assert axes.get_ylabel() == "up [degree]"
    finally:
        plt.close(figure)
    # behind a lens of 8 mm: pixels of 18.4 µm by 9.2 µm
    half = np.degrees(np.arctan(np.array([191 / 2 * 9.2e-3, 127 / 2 * 18.4e-3]) / 8))
    np.testing.assert_allclose(labelled.up[[0, -1]], [half[0], -half[0]])
    np.testing.assert_allclose(labelled.right[[0, -1]], [-half[1], half[1]])
    xr.testing.assert_identical(image, example_image(paper))  # itself stays as it is


def test_positions_are_in_pixels_where_angles_are_unknown() -> None:
    paper = hf.Instrument.load("paper")
    image = example_image(paper)
    part = image.isel(row=slice(0, 4), col=slice(0, 3))
    silent = image.drop_attrs().isel(row=slice(0, 4), col=slice(0, 3))
    for unknown in (part, silent, example_image(paper.replace(lens=None)).isel(row=slice(4))):
        found = upright(unknown)
        assert found.up.attrs["units"] == found.right.attrs["units"] == "pixel"
        np.testing.assert_array_equal(found.up, [1.5, 0.5, -0.5, -1.5])
    np.testing.assert_array_equal(upright(part).right, [-1, 0, 1])
    series = xr.concat([part, part], dim="capture")
    assert upright(series).depth.dims == ("capture", "up", "right")
    with pytest.raises(ImageError, match="comes from instrument"):
        upright(image, instrument=paper.replace(lens=None))
