# SPDX-License-Identifier: Apache-2.0
"""Point clouds: a PLY reader written from the format's description, and laspy for LAS."""

import json
import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import hueflight as hf
from hueflight.errors import ExportError, ImageError
from hueflight.export import image_points, write, write_las, write_ply

# scalar types of "The PLY Polygon File Format", G. Turk, 1994
PLY_TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H",
    "int": "i", "uint": "I", "float": "f", "double": "d",
}  # fmt: skip


def read_ply(path: Path) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Vertex properties and comments of a binary little-endian PLY, value by value."""
    content = path.read_bytes()
    head, _, body = content.partition(b"end_header\n")
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    comments = [line[8:] for line in lines if line.startswith("comment ")]
    (element,) = [line.split() for line in lines if line.startswith("element ")]
    assert element[1] == "vertex"
    properties = [line.split()[1:] for line in lines if line.startswith("property ")]
    record = struct.Struct("<" + "".join(PLY_TYPES[kind] for kind, _ in properties))
    assert len(body) == record.size * int(element[2])
    rows = list(record.iter_unpack(body))
    columns = zip(*rows, strict=True)
    return {
        name: np.array(values) for (_, name), values in zip(properties, columns, strict=True)
    }, comments


def expected_xyz(image: xr.Dataset) -> NDArray[np.float64]:
    """Pinhole camera: the paper's 8 mm lens, pixels spread over 128 × 18.4 by 192 × 9.2 µm."""
    rows, cols = image.sizes["row"], image.sizes["col"]
    points = []
    for row in range(rows):
        for col in range(cols):
            z = float(image["depth"][row, col])
            if np.isfinite(z):
                x = (col - (cols - 1) / 2) * (128 * 18.4e-3 / cols) / 8 * z
                y = (row - (rows - 1) / 2) * (192 * 9.2e-3 / rows) / 8 * z
                points.append((x, y, z))
    return np.array(points)


def test_ply_holds_positions_colours_bands_and_uncertainties(
    image: xr.Dataset, tmp_path: Path
) -> None:
    write(image, tmp_path / "scene.ply")
    found, comments = read_ply(tmp_path / "scene.ply")
    known = np.isfinite(image["depth"].values)
    xyz = np.stack([found["x"], found["y"], found["z"]], axis=1)
    np.testing.assert_allclose(xyz, expected_xyz(image), rtol=1e-12)
    np.testing.assert_array_equal(found["depth_std"], image["depth_std"].values[known])
    for band, wavelength in enumerate(image["wavelength"].values):
        for name in ("reflectance", "reflectance_std"):
            np.testing.assert_array_equal(
                found[f"{name}_{wavelength:.0f}nm"], image[name].values[..., band][known]
            )
    np.testing.assert_array_equal(found["quality"], image["quality"].values[known])
    np.testing.assert_array_equal(found["row"], np.nonzero(known)[0])
    assert found["red"].max() > 100
    assert "unit depth_std: m" in comments
    assert "calibration.distance_m: 0.4" in comments
    assert f"software: {image.attrs['software']}" in comments


def test_las_holds_the_same(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "scene.las")
    las = laspy.read(tmp_path / "scene.las")
    known = np.isfinite(image["depth"].values)
    # coordinates are whole hundredths of a millimetre
    np.testing.assert_allclose(las.xyz, expected_xyz(image), atol=0.51e-5, rtol=0)
    points = image_points(image)
    for name, values in points.fields.items():
        np.testing.assert_array_equal(las[name], values, err_msg=name)
    np.testing.assert_array_equal(np.asarray(las.red) // 257, points.rgb[:, 0])
    mean = image["reflectance"].values.mean(axis=-1)[known].clip(0, 1)
    np.testing.assert_allclose(np.asarray(las.intensity) / 65535, mean, atol=1e-5)
    (origin,) = [vlr for vlr in las.header.vlrs if vlr.user_id == "hueflight"]
    assert json.loads(origin.record_data)["calibration.distance_m"] == "0.4"
    assert las.header.generating_software == image.attrs["software"]
    extra = {dim.name: dim.description for dim in las.point_format.extra_dimensions}
    assert extra["depth_std"] == "unit m"


def test_las_header_by_the_specification(image: xr.Dataset, tmp_path: Path) -> None:
    """Public header block of LAS 1.4 (ASPRS, R15, table 3), read byte by byte."""
    write(image, tmp_path / "scene.las")
    content = (tmp_path / "scene.las").read_bytes()
    assert content[:4] == b"LASF"
    assert content[24:26] == bytes([1, 4])
    header_size, points_at = struct.unpack_from("<HI", content, 94)
    assert header_size == 375
    point_format, length = struct.unpack_from("<BH", content, 104)
    assert point_format == 7
    (count,) = struct.unpack_from("<Q", content, 247)
    assert count == np.isfinite(image["depth"]).sum()
    assert len(content) == points_at + count * length
    scale = struct.unpack_from("<3d", content, 131)
    first = struct.unpack_from("<3i", content, points_at)
    np.testing.assert_allclose(np.multiply(first, scale), expected_xyz(image)[0], atol=0.51e-5)


def test_instrument_may_be_given_instead(image: xr.Dataset, camera: hf.Instrument) -> None:
    bare = image.drop_attrs(deep=False)
    with pytest.raises(ImageError, match="does not describe its instrument"):
        image_points(bare)
    np.testing.assert_array_equal(
        image_points(bare, instrument=camera).xyz, image_points(image).xyz
    )
    with pytest.raises(ImageError, match=r"not\s+from 'spad512'"):
        image_points(image, instrument=hf.Instrument.load("spad512"))


def test_without_a_depth_there_are_no_points(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="no pixel of the image has a depth"):
        write(image.assign(depth=image["depth"] * np.nan), tmp_path / "x.ply")
    with pytest.raises(ExportError, match="cut-out"):
        write(image.isel(row=slice(5)), tmp_path / "x.las")
    assert not list(tmp_path.iterdir())


def test_bands_of_nearly_one_wavelength_keep_their_names(image: xr.Dataset) -> None:
    close = image["wavelength"].values.copy()
    close[1] = close[0] + 0.2
    assert (
        "reflectance_659_2nm"
        in image_points(image.assign_coords(wavelength=("band", close))).fields
    )
    close[1] = close[0]
    fields = image_points(image.assign_coords(wavelength=("band", close))).fields
    assert {"reflectance_659nm_0", "reflectance_659nm_1"} <= set(fields)


def test_series_becomes_numbered_clouds(series: xr.Dataset, tmp_path: Path) -> None:
    for path, factor in zip(write(series, tmp_path / "s.ply"), (1, 1.5, 0.5), strict=True):
        found, _ = read_ply(path)
        known = np.isfinite(series["depth"][0].values)
        expected = series["reflectance"][0].values[known][:, 0] * np.float32(factor)
        np.testing.assert_array_equal(found["reflectance_659nm"], expected)


def read_ply_header(path: Path) -> list[bytes]:
    """Return the lines of the header."""
    return path.read_bytes().partition(b"end_header\n")[0].splitlines()


def test_names_beyond_ascii_are_transliterated(image: xr.Dataset, tmp_path: Path) -> None:
    named = image.assign_attrs(instrument="Caméra du labo λ")
    write_las(named, tmp_path / "a.LAS")
    with laspy.open(tmp_path / "a.LAS") as file:
        assert file.header.system_identifier == "Camera du labo \\u03bb"
    write_ply(named, tmp_path / "a.ply")
    assert b"comment instrument: Camera du labo \\u03bb" in read_ply_header(tmp_path / "a.ply")
    assert b"".join(read_ply_header(tmp_path / "a.ply")).isascii()


def test_long_comments_are_split(image: xr.Dataset, tmp_path: Path) -> None:
    text = "".join(chr(97 + number % 26) for number in range(2500))
    write_ply(image.assign_attrs(remark=text), tmp_path / "a.ply")
    lines = read_ply_header(tmp_path / "a.ply")
    assert max(len(line) for line in lines) < 1000
    comments = b"".join(line.removeprefix(b"comment ") for line in lines)
    assert text.encode() in comments


def test_clouds_beyond_the_range_of_the_usual_resolution(image: xr.Dataset, tmp_path: Path) -> None:
    write_las(image, tmp_path / "near.las")
    far = image.assign(depth=image["depth"] * 1e5)  # 40 km
    write_las(far, tmp_path / "far.las")
    near, distant = laspy.read(tmp_path / "near.las"), laspy.read(tmp_path / "far.las")
    assert (near.header.scales == 1e-5).all()
    assert np.asarray(distant.z).max() > 21_475
    np.testing.assert_allclose(distant.z, np.asarray(near.z) * 1e5, atol=1)
