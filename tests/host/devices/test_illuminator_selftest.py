# SPDX-License-Identifier: Apache-2.0
"""The self-test's walk of the LEDs on a board in software: how long, and how short a pulse."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace

import pytest

from hueflight.devices import illuminator_selftest
from hueflight.devices.illuminator import Illuminator
from hueflight.devices.selftest import SelfTestResult
from hueflight.emulation.simulated_transport import SimulatedTransport
from hueflight_protocol.registers import Register

from .conftest import SoftwareIlluminator


class FiringIlluminator(SoftwareIlluminator):
    """A board that has played all trains by the time it is fed."""

    feeds = 0

    def _wrote(self, register: Register, indices: tuple[int, ...], word: int) -> None:
        super()._wrote(register, indices, word)
        if register.name == "watchdog_feed":
            self.feeds += 1
            self.registers.set("triggers_served", value=illuminator_selftest.TRAINS)


def walk(board: SoftwareIlluminator, *, dwell_s: float) -> SelfTestResult:
    """Result of the only LED of a board."""
    driver = Illuminator(SimulatedTransport(board.registers.handle, "software"))
    results = illuminator_selftest.run_illuminator_selftest(driver, words=1, dwell_s=dwell_s)
    return next(result for result in results if result.name == "LED 0")


def test_an_led_fires_for_the_time_that_is_asked(monkeypatch: pytest.MonkeyPatch):
    seconds = count()
    monkeypatch.setattr(
        illuminator_selftest, "time", SimpleNamespace(monotonic=lambda: next(seconds))
    )
    board = FiringIlluminator(channels=1)
    assert walk(board, dwell_s=1000).passed
    assert board.feeds == 1000


@pytest.mark.parametrize(("tick_ns", "ticks"), [(1.25, 8), (6, 1), (20, 1)])
def test_an_led_is_on_for_at_most_10_ns_or_a_tick(tick_ns: float, ticks: int):
    board = FiringIlluminator(channels=1, tick_fs=round(tick_ns * 1e6))
    assert walk(board, dwell_s=0).passed
    words = [board.registers.get("pulse", bank, 0, 0) for bank in range(2)]
    assert {board.registers.registers["pulse"].decode(word)["width"] for word in words} == {
        0,  # the bank that is not in use
        ticks,
    }
