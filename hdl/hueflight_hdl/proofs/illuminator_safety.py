# SPDX-License-Identifier: Apache-2.0
"""LEDs are off unless the board is armed, and it is armed only while the host confirms it."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from hueflight_protocol.illuminator_map import ARM_KEY

from ..illuminator.arming import Arming
from ..illuminator.pulse_generator.config import PulseConfig
from ..illuminator.pulse_generator.generator import PulseGenerator
from .harness import FreeHarness

CLOCKS_PER_MS = 3


class DarkHarness(FreeHarness):
    """A pulse generator whose settings, triggers, program and arming do anything."""

    def __init__(self) -> None:
        self.generator = PulseGenerator(PulseConfig(channels=2, pulses=1, steps=2))
        super().__init__(self.generator)

    def state(self, m: Module) -> None:
        """Compare the levels with how it was armed."""
        generator = self.generator
        armed = self.armed
        for clock in range(PulseGenerator.armed_latency):
            before = Signal(name=f"armed_before{clock}")
            m.d.sync += before.eq(armed)
            armed = before
        with m.If(~armed):
            m.d.comb += Assert(generator.levels.as_value() == 0)
        m.d.comb += Assert(generator.lit == armed)


class WatchdogHarness(wiring.Component):
    """Arming with any writes, feeds and times."""

    def __init__(self) -> None:
        super().__init__(
            {
                "key": In(32),
                "key_written": In(1),
                "timeout_ms": In(16),
                "feed": In(1),
                "disarm": In(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.safety = safety = Arming(CLOCKS_PER_MS)
        for name in self.signature.members:
            m.d.comb += getattr(safety, name).eq(getattr(self, name))
        keyed = Signal()  # the key was the last word written, and nothing has disarmed since
        allowed = Signal(16)  # milliseconds, as they were at the last key or feed
        elapsed = Signal(20)  # clocks since
        told = Signal()
        m.d.comb += told.eq(self.key_written | (self.feed & safety.armed))
        m.d.sync += elapsed.eq(Mux(told, 0, elapsed + 1))
        with m.If(told):
            m.d.sync += allowed.eq(self.timeout_ms)
        with m.If(self.disarm):
            m.d.sync += keyed.eq(0)
        with m.Elif(self.key_written):
            m.d.sync += keyed.eq(self.key == ARM_KEY)
        with m.If(safety.armed):
            m.d.comb += [
                Assert(keyed),
                Assert(elapsed < allowed * CLOCKS_PER_MS),
                # what the induction needs: the time left is what is not over
                Assert(safety.left_ms != 0),
                Assert(safety.clocks < CLOCKS_PER_MS),
                Assert(
                    elapsed + (safety.left_ms - 1) * CLOCKS_PER_MS + safety.clocks + 1
                    == allowed * CLOCKS_PER_MS
                ),
            ]
        return m
