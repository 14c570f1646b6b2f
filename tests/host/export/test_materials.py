# SPDX-License-Identifier: Apache-2.0
"""Abundances and indices are planes of an image, which every format holds."""

from __future__ import annotations

from pathlib import Path

import h5py
import laspy
import numpy as np
import pytest
import tifffile
import xarray as xr
import zarr
from spectral.io import envi

from hueflight.analysis import SpectralLibrary, add_materials, spectral_index, unmix
from hueflight.errors import HueflightError, ImageError
from hueflight.export import image_points, write
from hueflight.importers import read_image

CHOSEN = ("red", "green", "blue")
PLANES = [
    *(f"abundance_{name}{end}" for name in CHOSEN for end in ("", "_std")),
    "unmixing_chi_square",
    *(f"index_{name}{end}" for name in ("NGRDI", "525nm_659nm") for end in ("", "_std")),
]


@pytest.fixture(scope="module")
def library() -> SpectralLibrary:
    return SpectralLibrary.colorchecker().select(CHOSEN)


@pytest.fixture(scope="module")
def enriched(image: xr.Dataset, library: SpectralLibrary) -> xr.Dataset:
    return add_materials(image, library=library, indices=["NGRDI", "525 nm, 659nm"])


def test_planes_are_what_unmixing_and_indices_give(
    image: xr.Dataset, enriched: xr.Dataset, library: SpectralLibrary, camera
) -> None:
    assert [name for name in enriched.data_vars if name not in image] == PLANES
    found = unmix(image.reflectance, image.reflectance_std, library, camera)
    for name in CHOSEN:
        one = found.sel(entry=name)
        np.testing.assert_array_equal(
            enriched[f"abundance_{name}"], one.abundance.astype(np.float32)
        )
        np.testing.assert_array_equal(
            enriched[f"abundance_{name}_std"], one.abundance_std.astype(np.float32)
        )
    index = spectral_index(image, "NGRDI")
    np.testing.assert_array_equal(enriched["index_NGRDI"], index["index"].astype(np.float32))
    assert enriched["index_NGRDI"].attrs["standard_index"].startswith("NGRDI: Tucker")
    assert np.isfinite(enriched["abundance_red"]).sum() > 200
    assert np.isnan(enriched["abundance_red"].values[3, 4:6]).all()


def test_every_format_holds_them(enriched: xr.Dataset, tmp_path: Path) -> None:
    for name in ("a.zarr", "a.nc", "a.tif", "a.ome.tif", "a.hdr", "a.las", "a.ply"):
        write(enriched, tmp_path / name)
    group = zarr.open_group(tmp_path / "a.zarr", mode="r")
    file = h5py.File(tmp_path / "a.nc")
    with tifffile.TiffFile(tmp_path / "a.tif") as pages:
        planes = {page.tags[285].value: page.asarray() for page in pages.pages}
    with tifffile.TiffFile(tmp_path / "a.ome.tif") as pages:
        microscopy = str(pages.ome_metadata)
    cube = envi.open(tmp_path / "a.hdr")
    cloud = laspy.read(tmp_path / "a.las")
    header = (tmp_path / "a.ply").read_bytes().partition(b"end_header")[0].decode()
    known = np.isfinite(enriched["depth"].values)
    for name in PLANES:
        wanted = enriched[name].values
        np.testing.assert_array_equal(group[name][:], wanted)
        np.testing.assert_array_equal(file[name][:], wanted)
        np.testing.assert_array_equal(planes[name], wanted)
        assert name in microscopy
        np.testing.assert_array_equal(cloud[name[:32]], wanted[known])
        np.testing.assert_array_equal(image_points(enriched).fields[name], wanted[known])
        assert f" {name}\n" in header
    assert cube.nbands >= 9
    file.close()
    again = read_image(tmp_path / "a.nc")
    assert again["abundance_red"].attrs["ancillary_variables"].startswith("abundance_red_std")
    write(enriched, tmp_path / "red.png", variable="abundance_red")


def test_what_cannot_be_added_says_why(image: xr.Dataset, library: SpectralLibrary) -> None:
    with pytest.raises(ImageError, match=r"'EVI': choose one of NDVI.*'525 nm, 659 nm'"):
        add_materials(image, indices=["EVI"])
    with pytest.raises(ImageError, match="NDVI needs a band between 760 and 900 nm"):
        add_materials(image, indices=["NDVI"])
    with pytest.raises(ImageError, match=r"'300nm': the nearest band is .* 118 nm away"):
        add_materials(image, indices=["300nm,525nm"])
    with pytest.raises(HueflightError, match="material 'gold': the library has red, green, blue"):
        library.select(["gold"])
    twice = SpectralLibrary(("a b", "a-b", "c"), library.wavelengths_nm, library.reflectance)
    with pytest.raises(ImageError, match="two planes would be called 'abundance_a_b'"):
        add_materials(image, library=twice)
    blank = SpectralLibrary(("†", "a-b", "c"), library.wavelengths_nm, library.reflectance)
    with pytest.raises(HueflightError, match="name '†'"):
        add_materials(image, library=blank)
