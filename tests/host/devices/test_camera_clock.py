# SPDX-License-Identifier: Apache-2.0
"""The driver chooses the clock of a camera, and begins a common time of several."""

from __future__ import annotations

import json

import pytest

from hueflight.cli import board as command
from hueflight.cli.app import main
from hueflight.devices.camera import Camera
from hueflight.devices.clock_choice import ClockState
from hueflight.devices.common_time import has_common_time, start_common_time
from hueflight.devices.errors import DeviceError
from hueflight.emulation.simulated_transport import SimulatedTransport
from hueflight_protocol import RegisterFile, camera_map
from hueflight_protocol.typed_registers import camera as registers

from .conftest import SoftwareCamera

HZ = 10_000_000


def without_clock() -> Camera:
    """A camera of a build without an external clock."""
    transport = SimulatedTransport(RegisterFile(camera_map()).handle, "plain line")
    return Camera(transport, lambda size: pytest.fail("it sends no packets"))


def test_there_and_back():
    board = SoftwareCamera()
    camera = board.camera()
    assert camera.clock() == ClockState("internal", HZ, present=False, lost=False)
    with pytest.raises(DeviceError, match=r"no clock of 10000000 Hz at the input of the board"):
        camera.choose_clock("external")
    board.connect_clock(True)
    assert camera.choose_clock("external") == ClockState("external", HZ, present=True, lost=False)
    assert not camera.board.read(registers.Faults).clock_failed  # that of the change is cleared
    assert camera.choose_clock("internal").source == "internal"


def test_a_run_is_not_ended_by_a_change():
    board = SoftwareCamera()
    board.connect_clock(True)
    camera = board.camera()
    camera.board.write(registers.Run(start=1))
    with pytest.raises(DeviceError, match="is in a run, which a change of the clock would end"):
        camera.choose_clock("external")
    assert camera.running()
    camera.stop()
    assert camera.choose_clock("external").source == "external"


def test_a_loss_is_a_fault_and_ends_the_common_time():
    board = SoftwareCamera()
    board.connect_clock(True)
    board.edges = [board]
    camera = board.camera()
    camera.choose_clock("external")
    start_common_time([camera])
    assert has_common_time(camera)
    board.connect_clock(False)
    assert camera.clock() == ClockState("internal", HZ, present=False, lost=True)
    assert camera.board.read(registers.Faults).reference_lost
    assert not has_common_time(camera)


def test_builds_without_an_external_clock():
    camera = without_clock()
    assert camera.clock() == ClockState("internal", None, present=False, lost=False)
    with pytest.raises(DeviceError, match="was built without an external clock"):
        camera.choose_clock("external")
    assert not has_common_time(camera)
    with pytest.raises(DeviceError, match=r"plain line was built .* --set reference_hz=FREQUENCY"):
        start_common_time([SoftwareCamera().camera(), camera])


def test_one_camera_sends_the_edge_to_all():
    boards = [SoftwareCamera(), SoftwareCamera(), SoftwareCamera()]
    cameras = [board.camera() for board in boards]
    boards[0].edges = boards[:2]
    with pytest.raises(DeviceError, match=r"no edge came to the input time_sync of test line w"):
        start_common_time(cameras, timeout_s=0.02)
    assert [has_common_time(camera) for camera in cameras] == [True, True, False]
    boards[0].edges = boards
    start_common_time(cameras)
    assert all(has_common_time(camera) for camera in cameras)


def test_an_edge_from_elsewhere():
    boards = [SoftwareCamera(), SoftwareCamera()]
    cameras = [board.camera() for board in boards]
    start_common_time(cameras, give_edge=lambda: [board.edge() for board in boards])
    assert all(has_common_time(camera) for camera in cameras)
    cameras[1].board.write(registers.Run(start=1))
    with pytest.raises(DeviceError, match="is in a run, whose time stamps would jump"):
        start_common_time(cameras)


def test_the_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    board = SoftwareCamera()
    board.connect_clock(True)
    asked = []

    def open_usb_camera(serial: str) -> Camera:
        asked.append(serial)
        return board.camera()

    monkeypatch.setattr(command, "open_usb_camera", open_usb_camera)

    def run(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["board", "clock", *words])
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    code, out, _ = run("usb:0123ABCD", "--source", "external", "--json")
    assert code == 0
    assert json.loads(out)["source"] == "external"
    assert asked == ["0123ABCD"]
    code, out, _ = run("usb:")
    assert code == 0
    assert "external" in out
    code, _, err = run("usb:", "--baud", "115200")
    assert code == 1
    assert "usb:: --baud 115200 belongs to illuminators" in " ".join(err.split())
