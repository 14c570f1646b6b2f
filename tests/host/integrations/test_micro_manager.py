# SPDX-License-Identifier: Apache-2.0
"""Micro-Manager's core with our camera: snap, live, sequences, properties."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip(
    "pymmcore_plus", reason="other programs are not installed: extra 'micro-manager'"
)

from pymmcore_plus.experimental.unicore import UniMMCore

import hueflight as hf
from hueflight.client import NotReachableError
from hueflight.color.live_color import LiveColor
from hueflight.integrations.micro_manager import HueflightCamera
from support.daemon_process import Daemon, until

WAIT_S = 60


@pytest.fixture
def core(calibrated: Daemon) -> Iterator[UniMMCore]:
    made = UniMMCore()
    made.loadPyDevice("camera", HueflightCamera(calibrated.url))
    made.initializeDevice("camera")
    made.setCameraDevice("camera")
    yield made
    if made.isSequenceRunning():
        made.stopSequenceAcquisition()
    made.unloadAllDevices()


def taken(core: UniMMCore, count: int) -> list[tuple[np.ndarray, Any]]:
    """Images of a sequence with their metadata."""
    core.startSequenceAcquisition(count, 0, True)
    until(lambda: not core.isSequenceRunning(), "the sequence is taken")
    return [core.popNextImageAndMD() for _ in range(core.getRemainingImageCount())]


def test_every_image_has_the_values_of_the_client(core: UniMMCore, calibrated: Daemon) -> None:
    """The same pictures, taken by both at the same time, are equal in every array."""
    names = core.getAllowedPropertyValues("camera", "Image")
    assert {"photons", "depth", "color", "quality", "reflectance", "reflectance 659 nm"} <= {*names}
    with hf.connect(calibrated.url) as camera:
        for name in names:
            core.setProperty("camera", "Image", name)
            pictures = camera.pictures("all", timeout_s=WAIT_S)
            first = next(pictures)
            images = taken(core, 3)
            mine = {first.attrs["number"]: first}
            last = int(images[-1][1]["hueflight.number"])
            while max(mine) < last:
                picture = next(pictures)
                mine[picture.attrs["number"]] = picture
            for image, facts in images:
                picture = mine[int(facts["hueflight.number"])]
                assert int(facts["hueflight.frames"]) == picture.attrs["frames"]
                if name == "color":
                    wanted = LiveColor(camera.instrument).shown(picture)
                    assert image.shape == (24, 16, 3)
                    assert np.array_equal(image, wanted)
                    continue
                variable = picture[name.partition(" ")[0]]
                if " " in name:
                    [number] = np.flatnonzero(picture.wavelength.values == float(name.split()[1]))
                    variable = variable.isel(band=number)
                assert np.array_equal(image, variable.values, equal_nan=True)
                assert image.dtype == variable.dtype or name == "photons"


def test_snaps_hold_photons_of_after_the_call(core: UniMMCore, calibrated: Daemon) -> None:
    core.setExposure(100.0)  # 48 frames of 480 in a second
    assert core.getExposure() == pytest.approx(100.0)
    assert core.getProperty("camera", "Frames") == 48
    core.setProperty("camera", "Image", "photons")
    with hf.connect(calibrated.url) as camera:
        before = camera.expose(480)
        core.setExposure(100.0)
        core.snapImage()
        image = core.getImage()
        after = camera.picture()
    assert image.shape == (core.getImageHeight(), core.getImageWidth()) == (24, 16)
    # as bright as 48 frames are, of which each has the same light
    per_frame = before.photons.sum().item() / before.attrs["frames"]
    assert image.sum() == pytest.approx(48 * per_frame, rel=0.05)
    assert after.attrs["device_s"] - before.attrs["device_s"] >= 48 / 480
    core.setExposure(1.0)
    assert core.getProperty("camera", "Frames") == 16  # of one live picture


def test_a_sequence_of_100_images_without_a_gap(core: UniMMCore, calibrated: Daemon) -> None:
    core.setExposure(1.0)
    core.setProperty("camera", "Image", "depth")
    images = taken(core, 100)
    assert len(images) == 100
    numbers = [int(facts["hueflight.number"]) for _, facts in images]
    missed = [int(facts["hueflight.missed_pictures"]) for _, facts in images]
    assert numbers == sorted(set(numbers))
    assert sum(missed) == 0
    times = np.array([float(facts["hueflight.device_s"]) for _, facts in images])
    assert (np.diff(times) > 0).all()
    assert sum(calibrated.status()["lost"].values()) == 0


def test_live_shows_the_newest_and_stops(core: UniMMCore) -> None:
    core.setProperty("camera", "Image", "color")
    core.startContinuousSequenceAcquisition()
    until(lambda: core.getRemainingImageCount() > 5, "images")
    assert core.getLastImage().shape == (24, 16, 3)
    assert core.getNumberOfComponents() == 3
    core.stopSequenceAcquisition()
    time.sleep(0.1)
    assert not core.isSequenceRunning()
    core.setProperty("camera", "Image", "depth")  # and go on with something else
    core.snapImage()
    assert core.getImage().dtype == np.float32


def test_what_is_not_there_is_refused(core: UniMMCore) -> None:
    with pytest.raises((ValueError, RuntimeError)):
        core.setProperty("camera", "Image", "hue")
    with pytest.raises(NotReachableError, match="localhost:9"):
        HueflightCamera("localhost:9").initialize()
    with pytest.raises(RuntimeError, match="not initialized"):
        HueflightCamera("localhost:9").shape()
