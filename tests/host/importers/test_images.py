# SPDX-License-Identifier: Apache-2.0
"""Images come back as they were written, or not at all."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from hueflight.errors import FileFormatError
from hueflight.export import write
from hueflight.importers import read_image


@pytest.fixture(scope="module")
def image() -> xr.Dataset:
    rng = np.random.default_rng(0)
    return xr.Dataset(
        {
            "depth": (("row", "col"), rng.random((6, 5), np.float32), {"units": "m"}),
            "reflectance": (("row", "col", "band"), rng.random((6, 5, 2), np.float32)),
            "quality": (("row", "col"), np.zeros((6, 5), np.uint16)),
        },
        coords={"wavelength": ("band", [650.0, 450.0], {"units": "nm"}),
                "band_name": ("band", ["red", "blue"])},
        attrs={"software": "hueflight test"},
    )  # fmt: skip


@pytest.mark.parametrize("name", ["a.zarr", "a.nc"])
def test_round_trip(image: xr.Dataset, tmp_path: Path, name: str) -> None:
    write(image, tmp_path / name)
    found = read_image(tmp_path / name)
    xr.testing.assert_identical(found.drop_attrs(), image.drop_attrs())
    assert found["quality"].dtype == np.uint16
    assert found.attrs["software"] == "hueflight test"
    write(found, tmp_path / f"again-{name}")  # what was read can be written again
    xr.testing.assert_identical(read_image(tmp_path / f"again-{name}"), found)


def test_a_store_that_lacks_a_part_is_refused(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "a.zarr")
    (chunk,) = [p for p in (tmp_path / "a.zarr" / "depth").iterdir() if p.name[0] != "."]
    chunk.unlink()
    with pytest.raises(FileFormatError, match=r"is incomplete: depth/0\.0 is missing"):
        read_image(tmp_path / "a.zarr")


def test_stores_that_other_software_wrote_are_read(image: xr.Dataset, tmp_path: Path) -> None:
    image.to_zarr(tmp_path / "a.zarr", zarr_format=2)
    xr.testing.assert_identical(read_image(tmp_path / "a.zarr"), image)


def test_every_flipped_bit_of_a_store_is_noticed(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "a.zarr")
    files = [path for path in (tmp_path / "a.zarr").rglob("*") if path.is_file()]
    rng = np.random.default_rng(0)
    for path in files:
        whole = path.read_bytes()
        for _ in range(3):
            broken = bytearray(whole)
            broken[rng.integers(len(whole))] ^= 1 << rng.integers(8)
            path.write_bytes(broken)
            with pytest.raises(FileFormatError, match=r"a\.zarr"):
                read_image(tmp_path / "a.zarr")
        path.write_bytes(whole)
    read_image(tmp_path / "a.zarr")
    (tmp_path / "a.zarr" / "quality" / "0.0").write_bytes(b"a chunk that was all zero")
    with pytest.raises(FileFormatError, match=r"was changed: quality/0\.0 was not written"):
        read_image(tmp_path / "a.zarr")


def test_damage_is_named(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "a.zarr")
    (chunk,) = [p for p in (tmp_path / "a.zarr" / "depth").iterdir() if p.name[0] != "."]
    chunk.write_bytes(chunk.read_bytes()[:20])
    with pytest.raises(FileFormatError, match=r"a\.zarr' is damaged: the checksum of depth/0\.0"):
        read_image(tmp_path / "a.zarr")
    (tmp_path / "a.zarr" / ".zmetadata").unlink()
    (tmp_path / "a.zarr" / ".checksums").unlink()
    (tmp_path / "a.zarr" / ".zgroup").unlink()
    with pytest.raises(FileFormatError, match=r"a\.zarr.*can't be read as an image"):
        read_image(tmp_path / "a.zarr")
    write(image, tmp_path / "a.nc")
    whole = (tmp_path / "a.nc").read_bytes()
    for keep in (0, 100, len(whole) // 2):
        (tmp_path / "a.nc").write_bytes(whole[:keep])
        with pytest.raises(FileFormatError, match=r"a\.nc.*(is an empty file|can't be read as)"):
            read_image(tmp_path / "a.nc")


def test_what_is_no_image(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="there is no such file"):
        read_image(tmp_path / "a.zarr")
    (tmp_path / "a.tif").write_bytes(b"II*\x00")
    with pytest.raises(FileFormatError, match=r"is a TIFF file, not an image: give NAME\.zarr"):
        read_image(tmp_path / "a.tif")
    (tmp_path / "b.zarr").mkdir()
    with pytest.raises(FileFormatError, match=r"b\.zarr"):
        read_image(tmp_path / "b.zarr")
    image.drop_vars("depth").to_netcdf(tmp_path / "c.nc", engine="h5netcdf")
    with pytest.raises(FileFormatError, match="lacks depth"):
        read_image(tmp_path / "c.nc")
