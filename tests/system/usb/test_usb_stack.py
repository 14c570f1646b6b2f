# SPDX-License-Identifier: Apache-2.0
"""The camera driver on real libusb, pyusb and libusb1, over every event a bus can bring."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from hueflight.devices.transports.usb_identity import CONTROL_IN, STREAM_IN
from hueflight.emulation import CameraModel
from support.emulated_camera import EmulatedCamera
from support.usbfs import UsbfsBus

Run = Callable[[str], Any]
LIMITED = """
camera = open_camera()
camera.configure(instrument)
say(serial=camera.identity.serial)
wait()
camera.start(capture=3, frame_limit=800)
parser = PacketParser()
read_all(camera, parser)
r = parser.report
say(frames=r.frames, missing=r.missing, damaged=r.damaged, skipped=r.skipped_bytes,
    sent=camera.counters().frames_sent, errors=camera.statistics.link_errors)
camera.close()
"""


def run_limited(run_client: Run, act: Callable[[], None] = lambda: None) -> dict[str, int]:
    client = run_client(LIMITED)
    assert client.hear()["serial"] == "0000000000000001"
    act()
    client.tell()
    return client.hear()


def test_every_frame_arrives(run_client: Run) -> None:
    found = run_limited(run_client)
    assert found == {
        "frames": 800, "missing": 0, "damaged": 0, "skipped": 0, "sent": 800, "errors": 0
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("most", [1, 700, 1024, 5000])
def test_short_packets_are_no_end(run_client: Run, bus: UsbfsBus, most: int) -> None:
    """A transfer may end anywhere, within a packet or at its end."""
    if most == 1:
        bus.camera.most = 1  # one byte a transfer for a while, then as usual

        def widen() -> None:
            time.sleep(0.2)
            bus.camera.most = None

        found = run_limited(run_client, widen)
    else:
        bus.camera.most = most
        found = run_limited(run_client)
    assert (found["frames"], found["damaged"], found["missing"]) == (800, 0, 0)


@pytest.mark.slow
def test_zero_length_packets_are_no_end(run_client: Run, bus: UsbfsBus) -> None:
    bus.camera.zero_length = 50
    assert run_limited(run_client)["frames"] == 800


def test_a_stalled_stream_is_cleared_and_goes_on(run_client: Run, bus: UsbfsBus) -> None:
    client = run_client(LIMITED)
    client.hear()
    bus.camera.stalled.add(STREAM_IN)
    client.tell()
    found = client.hear()
    assert found["frames"] == 800
    assert found["errors"] >= 1


@pytest.mark.slow
def test_a_stalled_control_endpoint_is_cleared(run_client: Run, bus: UsbfsBus) -> None:
    client = run_client(LIMITED)
    client.hear()
    bus.camera.stalled.add(CONTROL_IN)
    client.tell()
    assert client.hear()["frames"] == 800


@pytest.mark.slow
def test_overflow_costs_what_it_must_and_is_counted(run_client: Run, bus: UsbfsBus) -> None:
    bus.camera.overflows = 3
    found = run_limited(run_client)
    assert found["errors"] == 3
    assert found["frames"] + found["missing"] + found["damaged"] >= 800 - 1
    assert found["frames"] >= 700


@pytest.mark.slow
def test_memory_of_usbfs_is_shared_with_others(run_client: Run, bus: UsbfsBus) -> None:
    """Where the kernel grants less than was asked, fewer transfers do."""
    bus.memory_limit = 3 * (1 << 17)
    assert run_limited(run_client)["frames"] == 800


@pytest.mark.slow
def test_too_little_memory_says_what_to_raise(run_client: Run, bus: UsbfsBus) -> None:
    bus.memory_limit = 2048
    client = run_client("""
camera = open_camera()
try:
    camera.listen()
except DeviceError as error:
    say(error=str(error))
""")
    assert "usbfs_memory_mb" in client.hear()["error"]


@pytest.mark.slow
def test_a_reader_that_is_late_stalls_the_camera_and_cuts_nothing(
    run_client: Run, bus: UsbfsBus, model: CameraModel
) -> None:
    """The queue is bounded; what the camera drops meanwhile is dropped whole and counted."""
    model._buffer_bytes = 20_000
    client = run_client("""
from hueflight.devices.transports.usb_stream import UsbStream
from hueflight.devices.transports import usb
place = find_cameras()[0]
camera = Camera(usb.UsbTransport(place),
                lambda size: UsbStream(place.bus, place.address, size, queue_bytes=40000,
                                       transfers=12))
camera.configure(instrument)
camera.start(frame_limit=2000)
while camera.running():
    time.sleep(0.05)
stalls = camera.statistics.stalls
queued = camera.statistics.queued_bytes
parser = PacketParser()
read_all(camera, parser)
c, r = camera.counters(), parser.report
say(frames=r.frames, damaged=r.damaged, missing=r.missing, skipped=r.skipped_bytes, stalls=stalls,
    queued=queued, sent=c.frames_sent, dropped=c.frames_dropped)
camera.close()
""")
    found = client.hear()
    assert found["frames"] == found["sent"]
    assert found["sent"] + found["dropped"] == 2000
    assert found["dropped"] > 0
    assert (found["damaged"], found["missing"], found["skipped"]) == (0, 0, 0)
    assert found["stalls"] >= 1
    # the queue's limit and what was under way when it was reached
    assert found["queued"] < 60_000 + 12 * 32_768


class Stuck(set[int]):
    """Endpoints that stall again as soon as they are cleared."""

    def discard(self, element: int, /) -> None:
        """Keep it."""


@pytest.mark.slow
def test_a_link_on_which_all_fails_is_given_up(run_client: Run, bus: UsbfsBus) -> None:
    client = run_client("""
camera = open_camera()
camera.configure(instrument)
say(ready=True)
wait()
camera.start(capture=1)
try:
    while True:
        camera.read(0.05)
except DeviceGoneError as error:
    say(error=str(error))
""")
    client.hear()
    bus.camera.stalled = Stuck({STREAM_IN})
    client.tell()
    assert "all transfers failed 4 times in a row: check the cable" in client.hear()["error"]


def test_unplugged_while_reading(run_client: Run, bus: UsbfsBus, model: CameraModel) -> None:
    client = run_client("""
camera = open_camera()
camera.configure(instrument)
camera.start(capture=1)
parser, told = PacketParser(), False
try:
    while True:
        parser.feed(camera.read(0.05))
        if parser.report.frames > 100 and not told:
            told = True
            say(streaming=True)
except DeviceGoneError as error:
    say(error=str(error), frames=parser.report.frames, damaged=parser.report.damaged)
try:
    camera.counters()
except DeviceGoneError as error:
    say(error=str(error))
camera.close()
while not find_cameras():
    time.sleep(0.05)
camera = open_camera()
say(place=camera.identity.place, running=camera.running())
camera.close()
""")
    client.hear()
    bus.unplug()
    found = client.hear()
    assert "unplugged" in found["error"]
    assert found["damaged"] == 0
    assert "unplugged" in client.hear()["error"]
    bus.plug()
    assert client.hear() == {"place": "USB 001:003", "running": True}


@pytest.mark.slow
def test_wrong_descriptors_are_refused(bus: UsbfsBus, run_client: Run) -> None:
    bus.unplug()
    bus.camera = EmulatedCamera(bus.camera.model, endpoints=((0, 0x02), (0, 0x81)))
    bus.plug()
    client = run_client("""
try:
    open_camera()
except WrongDeviceError as error:
    say(error=str(error))
""")
    assert "has no bulk endpoint 0x82 of interface 0, 0x81 of interface 1" in client.hear()["error"]


@pytest.mark.slow
def test_foreign_devices_with_the_test_number_are_left_alone(
    bus: UsbfsBus, run_client: Run
) -> None:
    bus.unplug()
    bus.camera = EmulatedCamera(bus.camera.model, product="Somebody's blinking light")
    bus.plug()
    client = run_client("""
say(found=len(find_cameras()))
try:
    open_camera()
except DeviceNotFoundError as error:
    say(error=str(error))
""")
    assert client.hear() == {"found": 0}
    assert "no camera on USB: is it plugged in" in client.hear()["error"]


@pytest.mark.slow
def test_found_by_serial_number(run_client: Run) -> None:
    client = run_client("""
camera = open_camera("HF0001")
say(place=camera.identity.place)
camera.close()
try:
    open_camera("HF0002")
except DeviceNotFoundError as error:
    say(error=str(error))
""")
    assert client.hear() == {"place": "USB 001:002"}
    assert "no camera with serial number 'HF0002'; there are HF0001" in client.hear()["error"]


@pytest.mark.slow
def test_a_camera_in_use_is_busy(run_client: Run) -> None:
    first = run_client("camera = open_camera(); camera.listen(); say(ok=True); wait()")
    first.hear()
    second = run_client("""
try:
    open_camera()
except DeviceBusyError as error:
    say(error=str(error))
""")
    assert "another program holds the camera" in second.hear()["error"]
    first.tell()


@pytest.mark.slow
def test_a_deaf_camera_times_out(run_client: Run, bus: UsbfsBus) -> None:
    bus.camera.deaf = True
    client = run_client("""
try:
    open_camera()
except DeviceTimeoutError as error:
    say(error=str(error))
""")
    assert "did not answer IDENTIFY" in client.hear()["error"]
