# SPDX-License-Identifier: Apache-2.0
"""Arming and the watchdog: LEDs may fire only while the host confirms it regularly."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.illuminator_map import ARM_KEY


class Arming(wiring.Component):
    """Arms the board when the host writes the key; disarms on any other word and on time-out.

    The board is disarmed after configuration.

    Parameters
    ----------
    clocks_per_ms : int
        Clocks of the domain `sync` in a millisecond.

    Members
    -------
    key : In(32), key_written : In(1)
        The word that the host wrote to the register, and when.
    timeout_ms : In(16)
        Time without a feed after which the board disarms; 0 keeps it disarmed.
    feed : In(1)
        The host feeds the watchdog.
    disarm : In(1)
        Disarms the board; has precedence over the key.
    armed : Out(1)
        LEDs may fire.
    left_ms : Out(16)
        Time until the board disarms, rounded up to milliseconds.
    expired : Out(1)
        High for one clock when the watchdog disarms the board.
    """

    def __init__(self, clocks_per_ms: int) -> None:
        self.clocks_per_ms = clocks_per_ms
        self.clocks = Signal(range(clocks_per_ms))  # left of the millisecond
        super().__init__(
            {
                "key": In(32),
                "key_written": In(1),
                "timeout_ms": In(16),
                "feed": In(1),
                "disarm": In(1),
                "armed": Out(1),
                "left_ms": Out(16),
                "expired": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        clocks = self.clocks
        start = Signal()
        m.d.sync += self.expired.eq(0)
        m.d.comb += start.eq(self.feed & self.armed)
        with m.If(self.disarm):
            m.d.sync += self.armed.eq(0)
        with m.Elif(self.key_written):
            m.d.sync += self.armed.eq((self.key == ARM_KEY) & (self.timeout_ms != 0))
            m.d.comb += start.eq(1)
        with m.Elif(self.timeout_ms == 0):
            m.d.sync += self.armed.eq(0)
        with m.Elif(self.armed & ~self.feed & (clocks == 0) & (self.left_ms == 1)):
            m.d.sync += [self.armed.eq(0), self.expired.eq(1), self.left_ms.eq(0)]
        with m.If(start):
            m.d.sync += [clocks.eq(self.clocks_per_ms - 1), self.left_ms.eq(self.timeout_ms)]
        with m.Elif(clocks != 0):
            m.d.sync += clocks.eq(clocks - 1)
        with m.Elif(self.left_ms != 0):
            m.d.sync += [clocks.eq(self.clocks_per_ms - 1), self.left_ms.eq(self.left_ms - 1)]
        with m.If(~self.armed & ~start):
            m.d.sync += self.left_ms.eq(0)
        return m
