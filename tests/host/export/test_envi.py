# SPDX-License-Identifier: Apache-2.0
"""ENVI cubes opened by Spectral Python."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from spectral.io import envi

from hueflight.errors import ExportError, OutputExistsError
from hueflight.export import write, write_envi


def test_cube_read_by_spectral(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "scene.hdr")
    cube = envi.open(tmp_path / "scene.hdr")
    np.testing.assert_array_equal(cube.open_memmap(interleave="bip"), image["reflectance"])
    assert cube.bands.centers == list(image["wavelength"].values)
    assert cube.bands.bandwidths == list(image["emission_fwhm"].values)
    assert cube.bands.band_unit == "Nanometers"
    assert cube.metadata["band names"] == list(image["band_name"].values)
    assert cube.metadata["bbl"] == [1] * 9
    assert "calibration.distance_m: 0.4" in cube.metadata["description"]
    assert image.attrs["software"] in cube.metadata["description"]


def test_uncertainty_and_planes_beside_it(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "scene.hdr")
    noise = envi.open(tmp_path / "scene_reflectance_std.hdr")
    np.testing.assert_array_equal(noise.open_memmap(interleave="bip"), image["reflectance_std"])
    assert noise.bands.centers == list(image["wavelength"].values)
    planes = envi.open(tmp_path / "scene_planes.hdr")
    names = planes.metadata["band names"]
    depth = planes.read_band(names.index("depth [m]"))
    np.testing.assert_array_equal(depth, image["depth"])
    flags = planes.read_band(names.index("quality [1]"))
    np.testing.assert_array_equal(flags, image["quality"])


def test_bad_bands_are_found_and_may_be_given(image: xr.Dataset, tmp_path: Path) -> None:
    noisy = image["reflectance_std"].copy(deep=True)
    noisy[..., 3] *= 1e4  # its noise hides it
    worse = image.assign(reflectance_std=noisy, reflectance=image["reflectance"].copy(deep=True))
    worse["reflectance"][..., 7] = np.nan
    write(worse, tmp_path / "a.hdr")
    assert envi.open(tmp_path / "a.hdr").metadata["bbl"] == [1, 1, 1, 0, 1, 1, 1, 0, 1]
    write(worse, tmp_path / "b.hdr", bad_bands=[True] + [False] * 8)
    assert envi.open(tmp_path / "b.hdr").metadata["bbl"] == [0] + [1] * 8
    with pytest.raises(ExportError, match="2 entries for 9 bands"):
        write(worse, tmp_path / "c.hdr", bad_bands=[True, False])


def test_series_becomes_numbered_cubes(series: xr.Dataset, tmp_path: Path) -> None:
    written = write(series, tmp_path / "s.hdr")
    assert [p.name for p in written] == ["s-0.hdr", "s-1.hdr", "s-2.hdr"]
    cube = envi.open(written[1])
    np.testing.assert_array_equal(cube.open_memmap(interleave="bip"), series["reflectance"][1])


@pytest.mark.parametrize("name", ["blue, {dark}", "two\nlines"])
def test_names_cannot_break_the_header(
    image: xr.Dataset, tmp_path: Path, name: str, same: Callable[..., None]
) -> None:
    names = [name, *image["band_name"].values[1:]]
    write(image.assign_coords(band_name=("band", names)), tmp_path / "x.hdr")
    cube = envi.open(tmp_path / "x.hdr")
    assert len(cube.metadata["band names"]) == 9
    assert cube.bands.centers == list(image["wavelength"].values)


def test_header_must_be_named_so(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"ends in \.hdr"):
        write_envi(image, tmp_path / "scene.img")


def test_data_beside_a_header_is_not_overwritten_unasked(image: xr.Dataset, tmp_path: Path) -> None:
    (tmp_path / "scene.img").write_text("precious")
    with pytest.raises(OutputExistsError, match=r"scene\.img' exists already"):
        write(image, tmp_path / "scene.hdr")
    assert [p.name for p in tmp_path.iterdir()] == ["scene.img"]
    assert (tmp_path / "scene.img").read_text() == "precious"
