# SPDX-License-Identifier: Apache-2.0
"""The faults: each is brought about, noticed if it must be, and mended."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator

from hueflight.acquisition.recorder import BATCH_BYTES
from hueflight.devices.transports.usb_identity import STREAM_IN
from support.daemon_process import until
from support.fault_runs.machine import Fault, Machine
from support.fault_runs.plan import RESERVE_MB, Step

FAULTS: dict[str, Fault] = {}
MANY = 300  #: idle connections


def fault(function: Fault) -> Fault:
    """Enter a fault under the name of its function."""
    FAULTS[function.__name__] = function
    return function


# -- camera and cable -----------------------------------------------------------------------------


@fault
def unplug(machine: Machine, step: Step) -> None:
    machine.bus.unplug()
    machine.must_tell("unplug")
    time.sleep(step.hold_s)
    machine.bus.plug()
    machine.must_be_well()


@fault
def power(machine: Machine, step: Step) -> None:
    machine.exact = False
    machine.bus.unplug()
    machine.model.reset()
    machine.must_tell("power")
    time.sleep(step.hold_s)
    machine.bus.plug()
    machine.must_be_well()


@fault
def stall(machine: Machine, step: Step) -> None:
    machine.camera.stalled.add(STREAM_IN)
    time.sleep(step.hold_s)


@fault
def overflow(machine: Machine, step: Step) -> None:
    machine.camera.overflows = 1 + round(4 * step.amount)
    until(lambda: not machine.camera.overflows, "all overflows have happened")


@fault
def zero_length(machine: Machine, step: Step) -> None:
    machine.camera.zero_length = 1 + round(40 * step.amount)
    until(lambda: not machine.camera.zero_length, "all empty packets have been sent")


@fault
def short(machine: Machine, step: Step) -> None:
    machine.camera.most = 1 + round(3000 * step.amount)
    time.sleep(step.hold_s)
    machine.camera.most = None


@fault
def damage(machine: Machine, step: Step) -> None:
    machine.camera.damage = step.amount
    time.sleep(step.hold_s)
    machine.camera.damage = 0.0


@fault
def deaf(machine: Machine, step: Step) -> None:
    machine.camera.deaf = True
    time.sleep(step.hold_s)
    machine.camera.deaf = False
    machine.must_be_well()


@fault
def pause(machine: Machine, step: Step) -> None:
    """The whole process has no processor for a while."""
    os.kill(machine.daemon.process.pid, signal.SIGSTOP)
    time.sleep(step.hold_s)
    os.kill(machine.daemon.process.pid, signal.SIGCONT)


# -- disk -----------------------------------------------------------------------------------------


def _disk_fails(call: str, error: int) -> Fault:
    def function(machine: Machine, step: Step) -> None:
        machine.record()
        machine.note_told()
        machine.disk_faults.fail(call, error=error)
        machine.must_tell(f"{call} {errno.errorcode[error]}", os.strerror(error))
        time.sleep(step.hold_s)
        machine.disk_faults.heal()
        machine.must_go_on()

    return function


FAULTS["write_eio"] = _disk_fails("write", errno.EIO)
FAULTS["write_enospc"] = _disk_fails("write", errno.ENOSPC)
FAULTS["room_eio"] = _disk_fails("room", errno.EIO)


@fault
def some_writes(machine: Machine, step: Step) -> None:
    """A share of the calls fails, for a while."""
    machine.record()
    machine.note_told()
    machine.disk_faults.fail("write", "sync", error=errno.EIO, share=0.02 + 0.5 * step.amount)
    time.sleep(step.hold_s)
    machine.disk_faults.heal()
    machine.must_go_on()


def _end_fails(call: str) -> Fault:
    def function(machine: Machine, step: Step) -> None:
        machine.record()
        machine.note_told()
        machine.disk_faults.fail(call)
        name = machine.recording
        machine.end_recording()
        last = machine.status()["recording"]["last"]
        assert os.strerror(errno.EIO) in last["failure"], f"{name!r} ended well: {last}"
        time.sleep(step.hold_s)
        machine.disk_faults.heal()  # soon afterwards it is finished

    return function


FAULTS["end_sync"] = _end_fails("sync")
FAULTS["end_rename"] = _end_fails("rename")


@fault
def full(machine: Machine, step: Step) -> None:
    """Another program fills the disk up to the reserve."""
    machine.record()
    machine.note_told()
    ballast = machine.data / "ballast"
    reserve = RESERVE_MB << 20
    found = os.statvfs(machine.data)
    size = found.f_bavail * found.f_frsize - reserve - (1 << 20)
    with ballast.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, max(1, size))
    machine.must_tell("full", "MiB are free")
    time.sleep(step.hold_s)
    left = os.statvfs(machine.data)
    # what the other program takes between a look at the disk and the batch after it is not seen
    assert left.f_bavail * left.f_frsize >= reserve - BATCH_BYTES, "the reserve was used"
    ballast.unlink()
    machine.must_go_on()


@fault
def unmount(machine: Machine, step: Step) -> None:
    assert machine.disk is not None
    machine.record()
    machine.note_told()
    machine.disk.unmount()
    machine.must_tell("unmount", "mount")
    time.sleep(step.hold_s)
    assert not any(machine.data.iterdir()), "something was written below the mount point"
    machine.disk.mount()
    machine.must_go_on()


# -- the program itself ---------------------------------------------------------------------------


def _program_fails(part: str) -> Fault:
    def function(machine: Machine, step: Step) -> None:
        machine.record()
        machine.note_told()
        name = machine.recording
        (machine.program_faults / part).write_text("transition" if step.amount < 0.3 else "")
        machine.must_tell(part, "asked for")
        if part == "acquisition":
            machine.exact = False
            machine.ended_badly.add(name)
        if part == "recorder":
            machine.end_recording()
        machine.must_be_well()

    return function


FAULTS["acquisition_fails"] = _program_fails("acquisition")
FAULTS["pictures_fail"] = _program_fails("pictures")
FAULTS["recorder_fails"] = _program_fails("recorder")


@fault
def kill(machine: Machine, step: Step) -> None:
    """The process is killed, and started again."""
    machine.record()
    machine.note_told()
    name, told = machine.recording, machine.status()["recording"]["frames"]
    machine.told[name] = min(machine.told.get(name, told), told)
    machine.end(signal.SIGKILL)
    machine.ended_badly.add(name)
    machine.exact = False
    machine.start()


# -- clients and clock ----------------------------------------------------------------------------


def _address(machine: Machine) -> tuple[str, int]:
    host, port = machine.daemon.url.removeprefix("http://").split(":")
    return host, int(port)


@contextlib.contextmanager
def _sockets(machine: Machine, number: int, said: Callable[[int], bytes]) -> Iterator[None]:
    opened = []
    try:
        for index in range(number):
            sock = socket.socket()
            opened.append(sock)
            sock.settimeout(10.0)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            with contextlib.suppress(ConnectionError):  # it had to make way
                sock.connect(_address(machine))
                sock.sendall(said(index))
        yield
    finally:
        for sock in opened:
            sock.close()


@fault
def idle(machine: Machine, step: Step) -> None:
    """Connections on which nothing, or half a request, comes."""
    with _sockets(machine, MANY, lambda index: b"GET /health HTTP/1.1\r\n" * (index % 2)):
        assert machine.daemon.health()[0] == 200
        time.sleep(step.hold_s)


@fault
def slow_viewers(machine: Machine, step: Step) -> None:
    """Viewers that never read."""
    host, port = _address(machine)
    request = (
        f"GET /api/live HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    ).encode()
    with _sockets(machine, 12, lambda _: request):
        time.sleep(step.hold_s)
        assert machine.daemon.health()[0] == 200


@fault
def flood(machine: Machine, step: Step) -> None:
    for _ in range(20 + round(200 * step.amount)):
        machine.daemon.health()


@fault
def clock(machine: Machine, step: Step) -> None:
    """The wall clock is set: by seconds or by years, and back only at times."""
    exponent = 9 * step.amount
    machine.clock.step(round(10**exponent) * (1 if step.hold_s < 0.5 else -1))
    time.sleep(step.hold_s)
    if step.pause_s < 0.3:
        machine.clock.step(0)


@fault
def calibration(machine: Machine, step: Step) -> None:
    """A calibration is begun and cancelled; a recording does not come between."""
    machine.end_recording()
    machine.daemon.post("/api/calibration", {"distance": 0.4, "frames": 5_000_000, "bands": False})
    until(
        lambda: ((machine.status()["calibration"]["progress"] or {}).get("frames") or 0) > 10,
        "frames of the calibration are taken",
    )
    assert not machine.accepts("/api/recordings", {"name": "between"})
    machine.daemon.post("/api/calibration/cancel")
    until(lambda: machine.status()["calibration"]["progress"] is None, "it is cancelled")
    assert machine.status()["calibration"]["step"] == "cancelled"


@fault
def commands(machine: Machine, step: Step) -> None:
    """Commands as fast as they are taken, in an order of no sense."""
    for index in range(4 + round(20 * step.amount)):
        path = ("/api/stop", "/api/start", "/api/recordings", "/api/recordings/stop")[
            (index * (3 + round(7 * step.amount)) + index // 4) % 4
        ]
        body = None
        if path == "/api/recordings":
            name = f"r{len(machine.names)}"
            body = {"name": name}
            if machine.accepts(path, body):
                machine.names.append(name)
        else:
            machine.accepts(path)
    machine.end_recording()
    machine.daemon.post("/api/start")
    machine.frames_come()
