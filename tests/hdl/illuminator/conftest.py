# SPDX-License-Identifier: Apache-2.0
"""A small illuminator in simulation, and the host's driver on its serial pins."""

from __future__ import annotations

import pytest

from hueflight.devices.illuminator import Illuminator
from hueflight.devices.transports.serial import SerialTransport
from hueflight_hdl.illuminator.gearing.ecp5 import Ecp5Gearing
from hueflight_hdl.illuminator.illuminator import IlluminatorConfig
from hueflight_hdl.illuminator.pulse_generator.config import PulseConfig
from hueflight_hdl.testbench.illuminator import IlluminatorTestbench

# a fast line, so that little is simulated for each byte; a clock so slow that milliseconds pass
SMALL = IlluminatorConfig(
    pulse=PulseConfig(channels=3, pulses=2, steps=4), pulse_hz=20e6, baud=1.25e6, serial=0xBEEF
)
WAIT_S = 60.0  # of the computer's time, which says nothing of the board's


@pytest.fixture(scope="module")
def bench(simulator: None) -> IlluminatorTestbench:
    return IlluminatorTestbench(SMALL, Ecp5Gearing())


@pytest.fixture
def driver(bench: IlluminatorTestbench) -> Illuminator:
    bench.trigger = None
    bench.frame_sync = None
    driver = Illuminator(SerialTransport(bench), timeout_s=WAIT_S)
    driver.disarm()
    driver.stop(timeout_s=WAIT_S)
    driver.clear()
    return driver
