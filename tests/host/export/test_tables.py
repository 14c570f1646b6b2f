# SPDX-License-Identifier: Apache-2.0
"""CSV of region spectra, read by pandas and by the csv module."""

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from hueflight.analysis import region_spectra
from hueflight.errors import HueflightError
from hueflight.export import write, write_csv
from hueflight.reconstruction.quality import Quality

REGIONS = {"left": (slice(2, 12), slice(0, 5)), "right": (slice(2, 12), slice(8, 14))}


def test_table_read_by_pandas(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "s.csv", regions=REGIONS)
    table = pd.read_csv(tmp_path / "s.csv", comment="#")
    assert len(table) == 2 * 9
    left = table[table.region == "left"]
    assert list(left.wavelength_nm) == list(image["wavelength"].values)
    assert list(left.fwhm_nm) == list(image["emission_fwhm"].values)
    # by hand: every pixel there counts once, but those whose flags speak against it
    part = image.isel(row=slice(2, 12), col=slice(0, 5))
    sound = (part["quality"].values & ~np.uint16(Quality.LOW_SIGNAL)) == 0
    values = part["reflectance"].values[sound].astype(float)
    values = values[np.isfinite(values).all(axis=1)]
    np.testing.assert_allclose(left.reflectance, values.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(left.reflectance_scatter, values.std(axis=0, ddof=1), rtol=1e-10)
    assert set(left.pixels) == {np.isfinite(part["depth"].values[sound]).sum()}


def test_origin_stands_above_the_table(image: xr.Dataset, tmp_path: Path) -> None:
    write(image, tmp_path / "s.csv")
    lines = (tmp_path / "s.csv").read_text().splitlines()
    assert "# calibration.distance_m: 0.4" in lines
    assert f"# software: {image.attrs['software']}" in lines
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert {row["region"] for row in rows} == {"whole image"}


def test_series_has_a_column_of_captures(series: xr.Dataset, tmp_path: Path) -> None:
    write(series, tmp_path / "s.csv", regions=REGIONS)
    table = pd.read_csv(tmp_path / "s.csv", comment="#")
    assert list(table.capture.unique()) == ["a", "b", "c"]
    means = region_spectra(series, REGIONS)["reflectance"]
    for name in "abc":
        chosen = table[(table.capture == name) & (table.region == "right")]
        np.testing.assert_array_equal(
            chosen.reflectance, means.sel(capture=name, region="right").values
        )


def test_what_is_unknown_is_empty(image: xr.Dataset, tmp_path: Path) -> None:
    hole = {"hole": (slice(3, 4), slice(4, 6))}
    write(image, tmp_path / "s.csv", regions=hole)
    table = pd.read_csv(tmp_path / "s.csv", comment="#")
    assert table.reflectance.isna().all()
    assert (table.pixels == 0).all()


def test_regions_outside_are_named(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(HueflightError, match="region 'far' holds no pixel of the 20×14 image"):
        write(image, tmp_path / "s.csv", regions={"far": (slice(30, 40), slice(0, 5))})
    with pytest.raises(HueflightError, match="give a boolean mask"):
        write(image, tmp_path / "s.csv", regions={"odd": np.zeros((3, 3))})
    assert not list(tmp_path.iterdir())


def test_names_with_the_character_of_comments(image: xr.Dataset, tmp_path: Path) -> None:
    names = [f'IR #{number}, "near"' for number in range(image.sizes["band"])]
    named = image.assign_coords(band_name=("band", names))
    everything = np.ones((image.sizes["row"], image.sizes["col"]), dtype=bool)
    write_csv(named, tmp_path / "a.csv", regions={"#1": everything})
    table = pd.read_csv(tmp_path / "a.csv", comment="#")
    assert table["band"].tolist() == names
    assert set(table["region"]) == {"#1"}
    assert table["pixels"].notna().all()
