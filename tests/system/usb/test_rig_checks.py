# SPDX-License-Identifier: Apache-2.0
"""The checks of rigs that the package ships, over USB: real libusb, the camera model behind it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import hueflight as hf
from support.usbfs import UsbfsBus

PATIENCE_S = 240
PROGRAM = """
import os
import pytest
import hueflight as hf
from hueflight.devices.rig import rig_from_uri
from hueflight.testing import RigChecks

class TestCameraOnUsb(RigChecks):
    @pytest.fixture
    def instrument(self):
        return hf.Instrument.from_json(os.environ["INSTRUMENT"])

    @pytest.fixture
    def connect(self, instrument):
        return rig_from_uri("usb:", instrument)
"""


def test_a_camera_on_usb_passes_the_checks_of_rigs(
    bus: UsbfsBus, instrument: hf.Instrument, tmp_path: Path
) -> None:
    program = tmp_path / "test_rig.py"
    program.write_text(PROGRAM)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(program)]
    ended = subprocess.run(
        command,
        env=os.environ | bus.environment | {"INSTRUMENT": instrument.to_json()},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "6 passed" in ended.stdout
