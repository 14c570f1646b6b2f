# SPDX-License-Identifier: Apache-2.0
"""Zarr and NetCDF: opened by xarray and, beneath it, by h5py and as plain JSON."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from hueflight.errors import ImageError, OutputExistsError
from hueflight.export import write, write_netcdf, write_zarr
from hueflight.importers import read_image


def test_zarr_read_by_xarray_is_identical(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "scene.zarr")
    with xr.open_dataset(tmp_path / "scene.zarr", engine="zarr", chunks=None) as found:
        xr.testing.assert_identical(found.load().drop_attrs(), image.drop_attrs())
        assert {k: v for k, v in found.attrs.items() if k in image.attrs} == image.attrs
        for name in image.variables:
            assert found[name].dtype.kind == image[name].dtype.kind


def test_netcdf_read_by_xarray_is_identical(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "scene.nc")
    with xr.open_dataset(tmp_path / "scene.nc", engine="h5netcdf") as found:
        # CF 1.3: a coordinate with the name of its dimension holds numbers; text is in `band_name`
        assert "band" not in found.coords
        labelled = found.load().assign_coords(band=found["band_name"].values)
        xr.testing.assert_identical(labelled.drop_attrs(), image.drop_attrs())
        assert {k: v for k, v in found.attrs.items() if k != "history"} == image.attrs
        assert re.fullmatch(r"20\d\d-.+Z: written by hueflight .+", found.attrs["history"])
    written = read_image(tmp_path / "scene.nc")
    assert written.reflectance.sel(band="green").wavelength == 525
    write(written, tmp_path / "again.nc")
    assert read_image(tmp_path / "again.nc").attrs == written.attrs


def test_netcdf_is_hdf5_with_units_and_flags(image: xr.Dataset, tmp_path: Path) -> None:
    write_netcdf(image, tmp_path / "scene.nc")
    with h5py.File(tmp_path / "scene.nc") as file:
        np.testing.assert_array_equal(file["depth"][:], image["depth"].values)
        assert file["depth"].attrs["units"] == "m"
        assert file["depth"].attrs["ancillary_variables"] == "depth_std quality"
        assert file["wavelength"].attrs["standard_name"] == "radiation_wavelength"
        # CF 3.5: masks are of the flags' own type, and as many as there are meanings
        quality = file["quality"]
        assert quality.attrs["flag_masks"].dtype == quality.dtype == np.uint16
        assert len(quality.attrs["flag_masks"]) == len(quality.attrs["flag_meanings"].split())
        assert file.attrs["Conventions"].startswith("CF-1.")
        calibration = json.loads(file.attrs["calibration"])
        assert calibration["distance_m"] == 0.40
        assert calibration["reference_photons"] > 0
        assert file.attrs["software"].startswith("hueflight ")


@pytest.mark.parametrize("ending", ["zarr", "nc"])
def test_series_keeps_captures_and_times(series: xr.Dataset, tmp_path: Path, ending: str) -> None:
    assert write(series, tmp_path / f"s.{ending}") == [tmp_path / f"s.{ending}"]
    engine = "zarr" if ending == "zarr" else "h5netcdf"
    with xr.open_dataset(tmp_path / f"s.{ending}", engine=engine, chunks=None) as found:
        assert found["time"].attrs["units"] == "s"
    again = read_image(tmp_path / f"s.{ending}")
    xr.testing.assert_identical(again.drop_attrs(), series.drop_attrs())
    assert again.sel(capture="b").time == 1


def test_what_is_no_image_is_refused_by_name(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="lacks reflectance"):
        write_zarr(image.drop_vars("reflectance"), tmp_path / "x.zarr")
    with pytest.raises(ImageError, match="complex"):
        write_netcdf(image.assign(depth=image["depth"].astype(complex)), tmp_path / "x.nc")
    with pytest.raises(ImageError, match="dimension 'repeat'"):
        write_zarr(image.expand_dims(repeat=2), tmp_path / "x.zarr")
    with pytest.raises(ImageError, match=r"not <class 'numpy\.ndarray'>"):
        write_zarr(image["depth"].values, tmp_path / "x.zarr")  # pyright: ignore
    assert not list(tmp_path.iterdir())


def test_names_taken_are_kept_unless_told_otherwise(image: xr.Dataset, tmp_path: Path) -> None:
    for name in ("x.zarr", "x.nc"):
        write(image, tmp_path / name)
        changed = image.assign(depth=image["depth"] + 1)
        with pytest.raises(OutputExistsError, match="exists already"):
            write(changed, tmp_path / name)
        write(changed, tmp_path / name, overwrite=True)
        engine = "zarr" if name.endswith("zarr") else "h5netcdf"
        with xr.open_dataset(tmp_path / name, engine=engine, chunks=None) as found:
            np.testing.assert_array_equal(found["depth"], changed["depth"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x.nc", "x.zarr"]
