# SPDX-License-Identifier: Apache-2.0
"""Pictures opened by Pillow, their colours turned back into numbers by their own bar."""

from pathlib import Path

import matplotlib
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from PIL import Image

from hueflight.color.colormap import NO_DATA, colours
from hueflight.errors import ExportError
from hueflight.export import write, write_previews


def opened(path: Path) -> tuple[NDArray[np.uint8], dict[str, str]]:
    with Image.open(path) as file:
        return np.asarray(file.convert("RGB")), dict(file.text)  # type: ignore[attr-defined]


def scene_part(pixels: NDArray[np.uint8], image: xr.Dataset) -> NDArray[np.uint8]:
    """One picture pixel per image pixel, taken from the middle of each enlarged one."""
    rows, cols = image.sizes["row"], image.sizes["col"]
    factor = 480 // max(rows, cols)
    top, left = 33, 12
    middle = factor // 2
    return pixels[top + middle :: factor, left + middle :: factor][:rows, :cols]


def test_colours_are_viridis() -> None:
    ours = colours(np.linspace(0, 1, 256)[None], 0, 1)[0]
    theirs = np.asarray(matplotlib.colormaps["viridis"].colors) * 255  # type: ignore[attr-defined]
    assert np.abs(ours - theirs).max() <= 3.5


def test_picture_decoded_by_its_own_bar_gives_the_depth(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "depth.png")
    pixels, text = opened(tmp_path / "depth.png")
    low, high = (float(v) for v in text["limits"].split())
    assert text["variable"] == "depth [m]"
    assert text["calibration.distance_m"] == "0.4"
    assert text["software"] == image.attrs["software"]
    shown = scene_part(pixels, image).astype(int)
    # the bar runs from the upper limit at its top to the lower one, right of the picture
    height = 480 // 20 * 20
    bar_x = max(14 * 24, 160) + 2 * 12 + 5
    bar = pixels[33 : 33 + height, bar_x].astype(int)
    distance = np.abs(shown[:, :, None] - bar).sum(axis=-1)
    decoded = high + (low - high) * distance.argmin(axis=-1) / (height - 1)
    depth = image["depth"].values
    known = np.isfinite(depth)
    step = (high - low) / 100  # neighbouring colours of the bar differ by one or two steps
    np.testing.assert_allclose(decoded[known], depth.clip(low, high)[known], atol=step)
    assert (shown[~known] == NO_DATA).all()


def test_limits_are_the_callers_to_choose(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "a.png", limits=(0.5, 2.0), variable="reflectance", band=2)
    _, text = opened(tmp_path / "a.png")
    assert text["limits"] == "0.5 2"
    assert text["variable"] == "reflectance, 623 nm"
    with pytest.raises(ExportError, match="first must be below"):
        write(image, tmp_path / "b.png", limits=(2.0, 0.5))


def test_wrong_planes_are_named(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"no 'hue': choose rgb, three-band or one of depth"):
        write(image, tmp_path / "x.png", variable="hue")
    with pytest.raises(ExportError, match="9 bands"):
        write(image, tmp_path / "x.png", variable="reflectance")
    with pytest.raises(ExportError, match="has no bands"):
        write(image, tmp_path / "x.png", band=1)
    with pytest.raises(ExportError, match="no option 'colour'"):
        write(image, tmp_path / "x.png", colour="red")


def test_folder_of_all_pictures(image: xr.Dataset, tmp_path: Path) -> None:
    write_previews(image, tmp_path / "pictures")
    names = {path.name for path in (tmp_path / "pictures").iterdir()}
    assert {"rgb.png", "depth.png", "depth_std.png", "reflectance-659nm.png"} <= names
    assert len(names) == 5 + 9
    pixels, text = opened(tmp_path / "pictures" / "rgb.png")
    assert pixels.shape == (480, 336, 3)
    assert text["variable"] == "rgb"


def test_colours_of_all_bands_or_of_the_papers_three(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "all.png", variable="rgb")
    write(image, tmp_path / "three.png", variable="three-band")
    assert (opened(tmp_path / "all.png")[0] != opened(tmp_path / "three.png")[0]).any()
    unknown = image.drop_attrs()
    write(unknown, tmp_path / "unknown.png", variable="rgb")
    pixels, text = opened(tmp_path / "unknown.png")
    assert text["variable"] == "three-band"
    np.testing.assert_array_equal(pixels, opened(tmp_path / "three.png")[0])


def test_a_plane_without_values_is_all_grey(image: xr.Dataset, tmp_path: Path) -> None:
    write(image.assign(depth_std=image["depth_std"] * np.nan), tmp_path / "x.png",
          variable="depth_std")  # fmt: skip
    pixels, _ = opened(tmp_path / "x.png")
    assert (scene_part(pixels, image) == NO_DATA).all()
