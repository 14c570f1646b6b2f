# SPDX-License-Identifier: Apache-2.0
"""Emulated USB: real libusb, pyusb and libusb1 in a process of their own, a model behind them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

import hueflight as hf
from hueflight.emulation import CameraModel, FrameBank
from support.emulated_camera import EmulatedCamera
from support.emulation import require_packages
from support.lines import Lines
from support.usbfs import UsbfsBus

PATIENCE_S = 60


@pytest.fixture(scope="session")
def instrument() -> hf.Instrument:
    """Few pixels, two thousand frames a second."""
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(
        paper.sensor, rows=12, cols=16, frame_rate_hz=2000.0, exposure_ms=0.2
    )
    return paper.replace(sensor=sensor)


@pytest.fixture
def model(instrument: hf.Instrument) -> CameraModel:
    return CameraModel(
        instrument.sensor, FrameBank.random(instrument.sensor, occupancy=0.3, frames=16)
    )


@pytest.fixture
def bus(tmp_path: Path, model: CameraModel) -> Iterator[UsbfsBus]:
    """A bus with the model plugged in."""
    require_packages()
    made = UsbfsBus(tmp_path / "bus", EmulatedCamera(model))
    try:
        made.plug()
        yield made
    finally:
        made.close()


class Client:
    """A Python program in a process that sees the emulated bus.

    It sends lines of JSON; the test acts on what they say and answers with lines.
    """

    def __init__(self, bus: UsbfsBus, program: str, instrument: hf.Instrument) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", PRELUDE + program],
            env=os.environ | bus.environment | {"INSTRUMENT": instrument.to_json()},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self._lines = Lines(self._process.stdout)

    def hear(self) -> Any:
        """What the program says next."""
        line = self._lines.next(PATIENCE_S)
        assert line, f"the program ended with {self._process.wait(PATIENCE_S)}"
        return json.loads(line)

    def tell(self) -> None:
        """Let the program go on."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()

    def end(self) -> None:
        """Wait for its end."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(PATIENCE_S)
        self._lines.rest(PATIENCE_S)


PRELUDE = """
import json, os, sys, time
import hueflight as hf
from hueflight.devices import *
from hueflight.devices.transports.usb import find_cameras, open_camera
from hueflight_protocol import PacketParser
instrument = hf.Instrument.from_json(os.environ["INSTRUMENT"])
def say(**values): print(json.dumps(values), flush=True)
def wait(): sys.stdin.readline()
def read_all(camera, parser, quiet=0.3):
    since = time.monotonic()
    while time.monotonic() - since < quiet:
        data = camera.read(0.05)
        if data:
            parser.feed(data)
            since = time.monotonic()
"""


@pytest.fixture
def run_client(bus: UsbfsBus, instrument: hf.Instrument) -> Iterator[Callable[[str], Client]]:
    """Function that starts a program on the emulated bus."""
    clients: list[Client] = []

    def start(program: str) -> Client:
        clients.append(Client(bus, program, instrument))
        return clients[-1]

    try:
        yield start
    finally:
        for client in clients:
            client.end()
