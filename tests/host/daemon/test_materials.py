# SPDX-License-Identifier: Apache-2.0
"""Abundances and indices of a pixel are those of the analysis; what can't be is refused."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.analysis import SpectralLibrary, add_materials
from hueflight.daemon.config import ConfigError, DaemonConfig, MaterialsConfig
from hueflight.daemon.http.answers import MaterialValue
from hueflight.daemon.materials import MaterialError, PictureMaterials
from hueflight.daemon.picture import Picture
from hueflight.live.image import picture_of_message
from hueflight.live.message import decode_message

CHOSEN = MaterialsConfig(
    library="colorchecker", names=("red", "blue"), indices=("NGRDI", "525nm,659nm")
)


def picture(instrument: hf.Instrument) -> xr.Dataset:
    rng = np.random.default_rng(4)
    shape = (*instrument.image_shape, len(instrument.bands))
    cube = ("row", "col", "band")
    planes = {
        "reflectance": (cube, rng.uniform(0.2, 0.8, shape).astype(np.float32)),
        "reflectance_std": (cube, np.full(shape, 0.01, np.float32)),
    }
    return xr.Dataset(planes, {"wavelength": ("band", instrument.wavelengths_nm)})


def test_values_are_those_of_the_whole_image(instrument: hf.Instrument) -> None:
    image = picture(instrument)
    library = SpectralLibrary.colorchecker().select(CHOSEN.names)
    whole = add_materials(image, library=library, indices=CHOSEN.indices, instrument=instrument)
    materials = PictureMaterials(CHOSEN, instrument)
    found = materials.of(image.isel(row=slice(2, 3), col=slice(5, 6)))
    assert [entry["name"] for entry in found][:2] == ["abundance of red", "abundance of blue"]
    for entry, name in zip(
        found, ("abundance_red", "abundance_blue", "index_NGRDI", "index_525nm_659nm"), strict=True
    ):
        assert entry["value"] == pytest.approx(whole[name].values[2, 5], rel=1e-5)
        assert entry["std"] == pytest.approx(whole[f"{name}_std"].values[2, 5], rel=1e-5)
        assert msgspec.to_builtins(msgspec.convert(entry, MaterialValue)) == entry
    image["reflectance"][2, 5] = np.nan
    unknown = materials.of(image.isel(row=slice(2, 3), col=slice(5, 6)))
    assert [(entry["value"], entry["std"]) for entry in unknown] == [(None, None)] * 4
    assert PictureMaterials(MaterialsConfig(), instrument).of(image) == []


def test_a_map_has_the_values_of_the_whole_image(instrument: hf.Instrument) -> None:
    image = picture(instrument)
    image["reflectance"][0, 0] = np.nan
    photons = np.ones(instrument.image_shape, np.int64)
    shown = Picture(
        number=7, kind="scene", histogram=np.empty(0, np.uint16), image=image, photons=photons,
        frames=9, frames_by_pixel=photons, device_s=0.0, received_s=0.0, begun_s=0.0, ready_s=0.0,
    )  # fmt: skip
    library = SpectralLibrary.colorchecker().select(CHOSEN.names)
    whole = add_materials(image, library=library, indices=CHOSEN.indices, instrument=instrument)
    materials = PictureMaterials(CHOSEN, instrument)
    assert materials.names["abundance_red"] == "abundance of red"
    assert len(materials.names) == 4
    for plane, text in materials.names.items():
        found = picture_of_message(decode_message(materials.message(shown, plane)))
        np.testing.assert_array_equal(found["value"], whole[plane])
        np.testing.assert_array_equal(found["std"], whole[f"{plane}_std"])
        assert (found.attrs["number"], found.attrs["name"]) == (7, text)
        assert np.isnan(found["value"].values[0, 0])
    with pytest.raises(MaterialError, match=r"'gold' is not configured.*'abundance_red'"):
        materials.message(shown, "gold")
    with pytest.raises(MaterialError, match="no calibrated picture yet"):
        materials.message(None, "abundance_red")


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        (MaterialsConfig(indices=("NDVI",)), "materials: index NDVI needs a band between 760"),
        (MaterialsConfig(library="colorchecker"), "9 bands can't tell 24 materials apart"),
        (MaterialsConfig(library="colorchecker", names=("gold",)), "material 'gold'"),
        (MaterialsConfig(library="missing.csv"), "missing.csv"),
    ],
)
def test_what_the_bands_do_not_support_is_refused_at_the_start(
    instrument: hf.Instrument, config: MaterialsConfig, reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        PictureMaterials(config, instrument)


def test_the_configuration_names_them(tmp_path) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text('[materials]\nlibrary = "colorchecker"\nnames = ["red"]\nindices = ["NGRDI"]\n')
    read = DaemonConfig.load(path).materials
    assert (read.library, read.names, read.indices) == ("colorchecker", ("red",), ("NGRDI",))
