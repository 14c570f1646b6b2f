# SPDX-License-Identifier: Apache-2.0
"""UART with 8 data bits, no parity and one stop bit, at up to an eighth of the clock frequency.

The bit clock is a phase accumulator: any rate is met to better than one part in a thousand on
average, and each edge to one clock.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from hueflight_protocol.errors import HueflightError

from .cobs import LINE_BYTE

_FRACTION_BITS = 20
FEWEST_CLOCKS_PER_BIT = 8
"""With fewer clocks per bit, the receiver's three samples and its synchroniser do not fit."""


class UartError(HueflightError):
    """The clock does not allow the requested baud rate."""


def bit_increment(clock_hz: float, baud: float) -> int:
    """Return what the bit clock's accumulator is advanced by.

    Raises
    ------
    UartError
        If there are too few clocks for a bit, or so many that the rate can't be met.
    """
    if clock_hz < FEWEST_CLOCKS_PER_BIT * baud:
        raise UartError(
            f"{baud:.0f} baud from a clock of {clock_hz:.0f} Hz: at most "
            f"{clock_hz / FEWEST_CLOCKS_PER_BIT:.0f} baud"
        )
    increment = round(baud / clock_hz * (1 << _FRACTION_BITS))
    if increment < 1000:
        raise UartError(f"{baud:.0f} baud from a clock of {clock_hz:.0f} Hz: too slow")
    return increment


class UartReceiver(wiring.Component):
    """Receives bytes; each bit is the majority of three samples around its middle.

    Parameters
    ----------
    increment : int
        See `bit_increment`.

    Members
    -------
    rx : In(1)
        The line, asynchronous.
    line : Out
        Bytes; `bad` where there was no stop bit.
    """

    def __init__(self, increment: int) -> None:
        self.increment = increment
        super().__init__(
            {
                "rx": In(1),
                "line": Out(stream.Signature(LINE_BYTE, always_ready=True)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        rx = Signal(init=1)
        m.submodules.rx = FFSynchronizer(self.rx, rx, init=1)
        recent = Signal(2, init=0b11)
        level = Signal(init=1)
        m.d.sync += [
            recent.eq(Cat(rx, recent)),
            level.eq((rx & recent[0]) | (rx & recent[1]) | (recent[0] & recent[1])),
        ]
        phase = Signal(_FRACTION_BITS + 1)
        bits = Signal(range(10))  # left of the byte, the stop bit included
        data = Signal(8)
        starting = Signal()
        idle = Signal(init=1)
        payload = self.line.payload
        m.d.sync += [phase.eq(phase[:-1] + self.increment), self.line.valid.eq(0)]
        with m.If(idle):
            # half a bit to go, less the clock in which the start is noticed
            m.d.sync += phase.eq((1 << _FRACTION_BITS - 1) + self.increment)
            with m.If(~level):
                m.d.sync += [idle.eq(0), starting.eq(1), bits.eq(9)]
        with m.Elif(phase[-1] & (bits != 0)):
            with m.If(starting):
                m.d.sync += [starting.eq(0), idle.eq(level)]  # a glitch is no start bit
            with m.Elif(bits != 1):
                m.d.sync += [data.eq(Cat(data[1:], level)), bits.eq(bits - 1)]
            with m.Else():
                m.d.sync += [
                    payload.data.eq(data),
                    payload.bad.eq(~level),
                    self.line.valid.eq(1),
                    bits.eq(0),
                ]
        with m.If(~idle & (bits == 0) & level):
            m.d.sync += idle.eq(1)  # after a bad stop bit, wait for the line to rest
        return m


class UartTransmitter(wiring.Component):
    """Sends bytes.

    Parameters
    ----------
    increment : int
        See `bit_increment`.

    Members
    -------
    line : In
        Bytes.
    tx : Out(1)
        The line.
    """

    def __init__(self, increment: int) -> None:
        self.increment = increment
        super().__init__({"line": In(stream.Signature(8)), "tx": Out(1, init=1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        phase = Signal(_FRACTION_BITS + 1)
        shift = Signal(9, init=0x1FF)
        bits = Signal(range(11))
        m.d.sync += phase.eq(phase[:-1] + self.increment)
        m.d.comb += self.line.ready.eq(bits == 0)
        with m.If(bits == 0):
            m.d.sync += phase.eq(0)
            with m.If(self.line.valid):
                m.d.sync += [self.tx.eq(0), shift.eq(Cat(self.line.payload, 1)), bits.eq(10)]
        with m.Elif(phase[-1]):
            m.d.sync += [self.tx.eq(shift[0]), shift.eq(Cat(shift[1:], 1)), bits.eq(bits - 1)]
        return m
