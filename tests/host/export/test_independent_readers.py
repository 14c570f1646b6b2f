# SPDX-License-Identifier: Apache-2.0
"""Exported files in programs of others, number by number: `tools/dev.py programs` installs these.

`laspy`, `tifffile`, `ome-types`, `spectral` and `zarr` read in the tests of each format.
"""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import xarray as xr

from hueflight.export import write
from hueflight.export.points import image_points


def installed(name: str) -> ModuleType:
    return pytest.importorskip(name, reason=f"other programs are not installed: {name}")


def test_plyfile_reads_every_column(image: xr.Dataset, tmp_path: Path) -> None:
    plyfile = installed("plyfile")
    write(image, tmp_path / "a.ply")
    vertex = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"]
    points = image_points(image)
    np.testing.assert_array_equal(np.stack([vertex[axis] for axis in "xyz"], 1), points.xyz)
    colors = np.stack([vertex[name] for name in ("red", "green", "blue")], 1)
    np.testing.assert_array_equal(colors, points.rgb)
    for name, values in points.fields.items():
        np.testing.assert_array_equal(vertex[name], values, err_msg=name)


def test_meshio_reads_points(image: xr.Dataset, tmp_path: Path) -> None:
    meshio = installed("meshio")
    write(image, tmp_path / "a.ply")
    mesh = meshio.read(tmp_path / "a.ply")
    points = image_points(image)
    np.testing.assert_array_equal(mesh.points, points.xyz)
    for name, values in points.fields.items():
        read = mesh.point_data[name]
        np.testing.assert_array_equal(read, values, err_msg=name)


def test_both_readers_of_open3d(image: xr.Dataset, tmp_path: Path) -> None:
    o3d = installed("open3d")
    write(image, tmp_path / "a.ply")
    points = image_points(image)
    plain = o3d.io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(np.asarray(plain.points), points.xyz)
    np.testing.assert_allclose(np.asarray(plain.colors) * 255, points.rgb, atol=1e-6)
    tensor = o3d.t.io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(tensor.point.positions.numpy(), points.xyz)
    for name, values in points.fields.items():
        np.testing.assert_array_equal(tensor.point[name].numpy()[:, 0], values, err_msg=name)


def test_rasterio_reads_envi(image: xr.Dataset, tmp_path: Path) -> None:
    rasterio = installed("rasterio")
    write(image, tmp_path / "a.hdr")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pictures have no place on a map
        with rasterio.open(tmp_path / "a.img") as opened:
            read = opened.read()
    np.testing.assert_array_equal(np.moveaxis(read, 0, -1), image["reflectance"].values)


def test_netcdf4_reads_every_variable(image: xr.Dataset, tmp_path: Path) -> None:
    installed("netCDF4")
    write(image, tmp_path / "a.nc")
    # in a process of its own: its HDF5 library is another than that of h5py
    program = (
        "import sys, netCDF4, numpy as np\n"
        "f = netCDF4.Dataset(sys.argv[1])\n"
        "f.set_auto_maskandscale(False)\n"
        "np.savez(sys.argv[2], **{k: v[...] for k, v in f.variables.items()\n"
        "         if v.dtype is not str and v.dtype.kind in 'uif'})\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "a.nc"), str(tmp_path / "a.npz")]
    subprocess.run(command, check=True, capture_output=True)
    with np.load(tmp_path / "a.npz") as read:
        for name, values in image.data_vars.items():
            np.testing.assert_array_equal(read[str(name)], values, err_msg=str(name))
        np.testing.assert_array_equal(read["wavelength"], image["wavelength"])


@pytest.mark.parametrize("kind", ["image", "series"])
def test_the_cf_checker_finds_nothing(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    installed("compliance_checker")
    written: xr.Dataset = request.getfixturevalue(kind)
    write(written, tmp_path / "a.nc")
    version = written.attrs["Conventions"].replace("CF-", "cf:")
    # in a process of its own: it needs another HDF5 library than h5py
    program = (
        "import sys\n"
        "from compliance_checker.runner import CheckSuite, ComplianceChecker\n"
        "CheckSuite.load_all_available_checkers()\n"
        "passed, crashed = ComplianceChecker.run_checker(sys.argv[1], [sys.argv[2]], 1, 'strict',\n"
        "    output_filename='-', output_format='text')\n"
        "sys.exit(not passed or crashed)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "a.nc"), version]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
