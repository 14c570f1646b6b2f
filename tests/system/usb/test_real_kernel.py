# SPDX-License-Identifier: Apache-2.0
"""The camera driver on a real kernel's xHCI driver at SuperSpeed, in an emulated machine."""

from __future__ import annotations

from pathlib import Path

import pytest

import hueflight as hf
from hueflight.emulation import CameraModel
from support.emulated_camera import EmulatedCamera
from support.guest import boot, require_guest

FRAMES = 800
PROGRAM = f"""
speed = [open(f"/sys/bus/usb/devices/{{name}}/speed").read().strip()
         for name in os.listdir("/sys/bus/usb/devices") if "-" in name and ":" not in name]
camera = open_camera()
say(serial=camera.identity.serial, speed=speed, release=os.uname().release)
camera.configure(instrument)
camera.start(capture=3, frame_limit={FRAMES})
parser = PacketParser()
read_all(camera, parser)
r = parser.report
say(frames=r.frames, missing=r.missing, damaged=r.damaged, skipped=r.skipped_bytes,
    sent=camera.counters().frames_sent, errors=camera.statistics.link_errors)
camera.start(capture=4)
parser = PacketParser()
while parser.report.frames < 200:
    parser.feed(camera.read(0.5))
say(streaming=parser.report.frames)
try:
    while True:
        camera.read(0.5)
except DeviceGoneError as error:
    say(gone=str(error))
"""


@pytest.mark.slow
@pytest.mark.timeout(260)
def test_discovery_stream_and_unplugging_on_a_real_kernel(
    model: CameraModel, instrument: hf.Instrument, tmp_path: Path
) -> None:
    kernel = require_guest()
    camera = EmulatedCamera(model)
    with boot(kernel, camera, instrument.to_json(), PROGRAM, tmp_path) as guest:
        found = guest.hear()
        assert found["serial"] == "0000000000000001", guest.log
        assert found["speed"] == ["5000"], guest.log
        assert found["release"] in kernel.image.name
        whole = guest.hear()
        assert whole == {
            "frames": FRAMES, "missing": 0, "damaged": 0, "skipped": 0, "sent": FRAMES,
            "errors": 0,
        }, guest.log  # fmt: skip
        assert guest.hear()["streaming"] >= 200
        guest.cable.unplug()
        assert "unplugged" in guest.hear()["gone"], guest.log
