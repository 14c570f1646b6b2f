# SPDX-License-Identifier: Apache-2.0
"""TIFF read by tifffile and by Pillow; OME-TIFF held against the published schema."""

import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import ome_types
import pytest
import tifffile
import xarray as xr
from lxml import etree
from PIL import Image

import hueflight as hf
from hueflight.errors import ExportError
from hueflight.export import write
from hueflight.files.image_schema import layers

OME = {"ome": "http://www.openmicroscopy.org/Schemas/OME/2016-06"}


ROWS, COLS = 20, 14  #: of the camera in conftest


def test_pages_hold_every_plane_and_say_which(
    image: xr.Dataset, tmp_path: Path, same: Callable[..., None]
) -> None:
    write(image, tmp_path / "scene.tif")
    wanted = layers(image)
    with tifffile.TiffFile(tmp_path / "scene.tif") as file:
        assert len(file.pages) == len(wanted)
        for page, (name, band, plane) in zip(file.pages, wanted, strict=True):
            about = json.loads(page.description)
            assert about["variable"] == name
            same(page.asarray(), plane)
            assert about["units"] == image[name].attrs.get("units", "1")
            if band is not None:
                assert about["wavelength_nm"] == image["wavelength"].values[band]
                assert about["fwhm_nm"] == image["emission_fwhm"].values[band]
                assert page.tags[285].value.startswith(name)
        assert file.pages[0].tags["Software"].value == image.attrs["software"]
        first = json.loads(file.pages[0].description)["image"]
        assert first["calibration.distance_m"] == "0.4"
        assert first["recording"] == "test.mcap"


def test_a_stack_has_slice_labels_and_is_one_for_imagej(
    image: xr.Dataset, series: xr.Dataset, tmp_path: Path
) -> None:
    """ImageJ gives labels to pages of one type whose values follow each other without a gap."""
    write(image, tmp_path / "bands.tif", variable="reflectance")
    with tifffile.TiffFile(tmp_path / "bands.tif") as file:
        labels = file.pages.first.tags["IJMetadata"].value["Labels"]
        assert labels[4] == "reflectance green 525 nm"
        assert labels == [page.tags[285].value for page in file.pages]
        starts = [page.dataoffsets[0] for page in file.pages]
        assert {len(page.dataoffsets) for page in file.pages} == {1}
        assert set(np.diff(starts)) == {image["depth"].values.nbytes}
        assert [json.loads(page.description)["band"] for page in file.pages] == list(
            image["band_name"].values
        )
    write(series, tmp_path / "depths.tif", variable="depth")
    with tifffile.TiffFile(tmp_path / "depths.tif") as file:
        labels = file.pages.first.tags["IJMetadata"].value["Labels"]
    assert labels == ["depth a", "depth b", "depth c"]


def test_pages_read_by_pillow(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "scene.tif")
    with Image.open(tmp_path / "scene.tif") as file:
        for number, (_, _, plane) in enumerate(layers(image)):
            file.seek(number)
            np.testing.assert_array_equal(np.asarray(file), plane)


def test_series_is_one_file_of_all_captures(series: xr.Dataset, tmp_path: Path) -> None:
    write(series, tmp_path / "s.tiff")
    with tifffile.TiffFile(tmp_path / "s.tiff") as file:
        about = [json.loads(page.description) for page in file.pages]
        assert [a["capture"] for a in about] == sorted(a["capture"] for a in about)
        found = [
            page.asarray()
            for page, a in zip(file.pages, about, strict=True)
            if a["variable"] == "reflectance" and a["capture"] == 1
        ]
    np.testing.assert_array_equal(np.stack(found, axis=-1), series["reflectance"][1])


def test_types_that_readers_do_not_know_are_refused(image: xr.Dataset, tmp_path: Path) -> None:
    odd = image.assign(photons=image["photons"].astype(np.int64))
    for name in ("x.tif", "x.ome.tif"):
        with pytest.raises(ExportError, match=r"int64 of 'photons'.*convert"):
            write(odd, tmp_path / name)
    assert not list(tmp_path.iterdir())


def ome_schema() -> etree.XMLSchema:
    """Schema 2016-06 as the Open Microscopy Environment publishes it."""
    path = Path(ome_types.__file__).parent / "ome-2016-06.xsd"
    return etree.XMLSchema(etree.parse(path))


def test_ome_block_is_valid_by_the_schema(series: xr.Dataset, tmp_path: Path) -> None:
    write(series, tmp_path / "s.ome.tif")
    with tifffile.TiffFile(tmp_path / "s.ome.tif") as file:
        block = file.ome_metadata
    assert block is not None
    ome_schema().assertValid(etree.fromstring(block.encode()))
    broken = block.replace('DimensionOrder="XYCZT"', 'DimensionOrder="CXYZT"')
    assert not ome_schema().validate(etree.fromstring(broken.encode())), "the schema must bite"


def test_ome_channels_are_bands_with_wavelengths(
    image: xr.Dataset, series: xr.Dataset, tmp_path: Path
) -> None:
    write(series, tmp_path / "s.ome.tif")
    with tifffile.TiffFile(tmp_path / "s.ome.tif") as file:
        assert file.is_ome
        by_name = {entry.name: entry for entry in file.series}
        cube = by_name["reflectance"]
        assert cube.axes == "TCYX"
        np.testing.assert_array_equal(
            cube.asarray(), series["reflectance"].transpose("capture", "band", "row", "col")
        )
        np.testing.assert_array_equal(by_name["quality"].asarray(), series["quality"])
        root = Xml.fromstring(file.ome_metadata or "")
    entry = root.find("ome:Image[@Name='reflectance']", OME)
    assert entry is not None
    channels = entry.findall("ome:Pixels/ome:Channel", OME)
    assert [float(c.attrib["EmissionWavelength"]) for c in channels] == list(
        image["wavelength"].values
    )
    assert {c.attrib["EmissionWavelengthUnit"] for c in channels} == {"nm"}
    planes = root.find("ome:Image[@Name='planes']", OME)
    assert planes is not None
    names = [c.attrib["Name"] for c in planes.findall("ome:Pixels/ome:Channel", OME)]
    assert "depth [m]" in names
    assert "depth_std [m]" in names
    known = {m.attrib["K"]: m.text for m in root.iter(f"{{{OME['ome']}}}M")}
    assert known["calibration.distance_m"] == "0.4"
    assert json.loads(known["instrument_description"] or "")["name"] == "paper"


def test_ome_has_angles_and_no_lengths_of_pixels(
    image: xr.Dataset, camera: hf.Instrument, tmp_path: Path
) -> None:
    """What a pixel of 168 µm sees behind 8 mm grows with the distance: 1.2° and no length."""

    def annotated(pixels: xr.Dataset) -> dict[str, str]:
        write(pixels, tmp_path / "a.ome.tif", overwrite=True)
        document = ome_types.from_tiff(tmp_path / "a.ome.tif")
        assert {entry.pixels.physical_size_x for entry in document.images} == {None}
        return dict(document.structured_annotations[0].value)

    width, height = 18.4e-3 * 128 / COLS, 9.2e-3 * 192 / ROWS
    whole = annotated(image)
    one = np.degrees(2 * np.arctan(np.array([width, height]) / 2 / 8))
    found = [float(whole[f"pixel_angle_{axis}_deg"]) for axis in "xy"]
    np.testing.assert_allclose(found, one, rtol=1e-5)
    assert float(whole["field_of_view_y_deg"]) == pytest.approx(12.6, abs=0.05)
    part = annotated(image.isel(row=slice(2, 9)))
    assert part["pixel_angle_y_deg"] == whole["pixel_angle_y_deg"]
    assert "field_of_view_y_deg" not in part
    blind = camera.replace(lens=None)
    changed = {
        "instrument_description": blind.to_json(),
        "instrument_fingerprint": blind.fingerprint(),
    }
    assert "pixel_angle_x_deg" not in annotated(image.assign_attrs(changed))


def test_single_ome_image(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "one.ome.tif")
    found = tifffile.imread(tmp_path / "one.ome.tif", series=0)
    np.testing.assert_array_equal(found, image["reflectance"].transpose("band", "row", "col"))
    ome_schema().assertValid(
        etree.fromstring(tifffile.tiffcomment(tmp_path / "one.ome.tif").encode())
    )
