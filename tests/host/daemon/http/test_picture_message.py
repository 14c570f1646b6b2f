# SPDX-License-Identifier: Apache-2.0
"""A picture's message, read back by the layout that the page knows."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.color import color_picture
from hueflight.color.live_color import LiveColor
from hueflight.daemon.http.picture_message import UNKNOWN, encode_picture
from hueflight.daemon.picture import Picture

LIVE_COLOR = LiveColor(hf.Instrument.load("paper"))


def picture(image: xr.Dataset | None, photons: np.ndarray) -> Picture:
    return Picture(
        number=7, kind="scene", histogram=np.zeros((*photons.shape, 2), np.uint16), image=image,
        photons=photons, frames=3, frames_by_pixel=np.full(photons.shape, 3), device_s=1.5,
        received_s=10.0, begun_s=10.1, ready_s=10.25,
    )  # fmt: skip


def decode(message: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """As page/message.js does."""
    size = int.from_bytes(message[:4], "little")
    header = json.loads(message[4 : 4 + size])
    planes = {}
    for entry in header["planes"]:
        start = 4 + size + entry["offset"]
        assert start % 8 == 0
        count = int(np.prod(entry["shape"]))
        found = np.frombuffer(message, entry["type"], count, start)
        planes[entry["name"]] = found.reshape(entry["shape"])
    return header, planes


def test_photons_alone_without_a_calibration() -> None:
    photons = np.array([[0, 5, 70_000]])
    header, planes = decode(encode_picture(picture(None, photons), LIVE_COLOR))
    assert (header["number"], header["rows"], header["cols"], header["made_ms"]) == (7, 1, 3, 250)
    assert planes["photons"].tolist() == [[0, 5, 70_000]]
    assert list(planes) == ["photons", "frames"]
    assert planes["frames"].tolist() == [[3, 3, 3]]


def test_an_image_in_the_coding_of_the_page() -> None:
    rng = np.random.default_rng(0)
    shape = (5, 3)
    depth = rng.uniform(0.3, 2.0, shape)
    depth[0, 0] = np.nan
    reflectance = rng.uniform(0, 1, (*shape, 9))
    reflectance[1, 1, 2] = np.nan
    image = xr.Dataset(
        {
            "depth": (("row", "col"), depth),
            "depth_std": (("row", "col"), depth / 100),
            "reflectance": (("row", "col", "band"), reflectance),
            "reflectance_std": (("row", "col", "band"), np.full((*shape, 9), 0.01)),
            "quality": (("row", "col"), np.full(shape, 33, np.uint16)),
        }
    )
    header, planes = decode(encode_picture(picture(image, np.ones(shape, int)), LIVE_COLOR))
    known = np.isfinite(depth)
    assert (planes["depth"][~known] == UNKNOWN).all()
    found = planes["depth"][known] * header["depth_scale"]
    assert found == pytest.approx(depth[known], abs=header["depth_scale"])
    assert header["depth_scale"] < 1e-4
    shown = (planes["bands"] / 255.0) ** 2 * np.array(header["tops"])[:, None, None]
    wanted = np.minimum(np.moveaxis(reflectance, -1, 0), np.array(header["tops"])[:, None, None])
    there = np.isfinite(wanted)
    assert shown[there] == pytest.approx(wanted[there], abs=0.005)
    assert planes["bands"][2, 1, 1] == 0
    assert (planes["quality"] == 33).all()
    assert planes["colours"].shape == (5, 3, 3)
    assert (planes["colours"][1, 1] == 0).all()
    assert (planes["colours"].max(axis=-1) > 0).sum() == 14


@pytest.mark.parametrize(("noise", "tolerance"), [(0.005, 0.003), (0.05, 0.015)])
def test_colours_are_near_those_that_weigh_each_pixel(noise: float, tolerance: float) -> None:
    instrument = hf.Instrument.load("paper")
    rng = np.random.default_rng(3)
    shape, nm = (24, 24), instrument.wavelengths_nm
    middle, width = rng.uniform(400, 700, (*shape, 1)), rng.uniform(60, 200, (*shape, 1))
    bump = np.exp(-(((nm - middle) / width) ** 2) / 2)
    truth = rng.uniform(0.2, 0.5, (*shape, 1)) + 0.4 * bump
    image = xr.Dataset(
        {
            name: (("row", "col", "band"), values)
            for name, values in {
                "reflectance": truth + noise * rng.standard_normal(truth.shape),
                "reflectance_std": np.full(truth.shape, noise),
            }.items()
        },
        coords={"wavelength": ("band", nm)},
    )
    found = LiveColor(instrument).render(image)
    assert found is not None
    expected = color_picture(image, instrument=instrument)
    assert np.sqrt(np.mean((found / 255 - expected) ** 2)) < tolerance
    # and far nearer than a picture that knows no colours
    grey = expected.mean(axis=-1, keepdims=True)
    assert np.sqrt(np.mean((grey - expected) ** 2)) > 3 * tolerance


def test_two_visible_bands_tell_no_colours() -> None:
    paper = hf.Instrument.load("paper")
    bands = tuple(band for band in paper.bands if band.wavelength_nm > 600)[-2:]
    image = xr.Dataset({"reflectance": (("row", "col", "band"), np.ones((2, 2, 2)))})
    assert LiveColor(paper.replace(bands=bands)).render(image) is None
