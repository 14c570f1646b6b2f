# SPDX-License-Identifier: Apache-2.0
"""Depth in millimetres, single planes, colors of channels, and bands by their names."""

import xml.etree.ElementTree as Xml

import numpy as np
import pytest
import tifffile
from PIL import Image

import hueflight as hf
from hueflight.errors import ExportError, ImageError
from hueflight.export import write
from hueflight.export.ome import _color
from hueflight.importers import read_image


@pytest.fixture(scope="module")
def camera(small):
    return small(rows=5, cols=7)


@pytest.fixture(scope="module")
def calibration(camera, draw):
    return hf.calibrate(draw(camera, depth=0.4, photons=20_000), camera, distance=0.4)


@pytest.fixture(scope="module")
def image(camera, calibration, draw):
    found = hf.reconstruct(draw(camera, depth=0.6, photons=4000, seed=1), calibration)
    found["depth"][1, 2] = np.nan
    return found


def test_bands_have_labels_also_in_files(image, tmp_path):
    green = image.reflectance.sel(band="green")
    assert float(green.wavelength) == 525
    for name in ("a.zarr", "a.nc"):
        write(image, tmp_path / name)
        found = read_image(tmp_path / name)
        np.testing.assert_array_equal(found.reflectance.sel(band="green"), green)
    write(image.drop_vars("band"), tmp_path / "earlier.zarr")
    found = read_image(tmp_path / "earlier.zarr")
    np.testing.assert_array_equal(found.reflectance.sel(band="green"), green)


def test_depth_in_millimetres(image, tmp_path):
    write(image, tmp_path / "scene.depth.png")
    with Image.open(tmp_path / "scene.depth.png") as file:
        assert file.mode.startswith("I;16")
        shown = np.asarray(file)
        assert file.text["unit"] == "mm"
    assert shown[1, 2] == 0
    known = np.isfinite(image.depth.values)
    np.testing.assert_allclose(shown[known] / 1e3, image.depth.values[known], atol=0.00051)
    far = image.copy()
    far["depth"] = far["depth"] + 70
    with pytest.raises(ExportError, match=r"16 bits hold 1 mm to 65\.5 m"):
        write(far, tmp_path / "far.depth.png")


def test_a_single_plane_as_tiff(image, tmp_path):
    write(image, tmp_path / "depth.tif", variable="depth")
    with tifffile.TiffFile(tmp_path / "depth.tif") as file:
        assert len(file.pages) == 1
        np.testing.assert_array_equal(file.asarray(), image.depth.values)
    write(image, tmp_path / "one.tif", variable="reflectance", band=4)
    np.testing.assert_array_equal(
        tifffile.imread(tmp_path / "one.tif"), image.reflectance.values[..., 4]
    )
    write(image, tmp_path / "near.tif", variable="reflectance", band="532 nm")
    assert (tmp_path / "near.tif").read_bytes() == (tmp_path / "one.tif").read_bytes()
    with pytest.raises(ImageError, match=r"no band '9'.*numbers 0 to 8"):
        write(image, tmp_path / "none.tif", variable="reflectance", band=9)
    with pytest.raises(ExportError, match="no such plane"):
        write(image, tmp_path / "none.tif", variable="depth", band=1)


def test_channels_have_colors_and_excitation(image, tmp_path):
    write(image, tmp_path / "a.ome.tif")
    with tifffile.TiffFile(tmp_path / "a.ome.tif") as file:
        root = Xml.fromstring(file.ome_metadata)
    channels = [one.attrib for one in root.iter() if one.tag.endswith("}Channel")][:9]
    assert [float(one["ExcitationWavelength"]) for one in channels] == list(image.wavelength)
    assert len({one["Color"] for one in channels}) == 9
    # OME: red 0xFF0000FF and so on as a signed number
    assert _color(660) == 0xFF0000FF - 2**32
    assert _color(850) == -1


def test_a_calibration_on_one_screen(calibration):
    assert len(repr(calibration).splitlines()) < 12
    assert "5 rows, 7 columns; 0 dead, 0 hot" in repr(calibration)
    assert "<table>" in calibration._repr_html_()
