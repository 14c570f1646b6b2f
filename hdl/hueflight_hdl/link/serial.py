# SPDX-License-Identifier: Apache-2.0
"""The serial link: UART and COBS, between the pins and the control engine."""

from __future__ import annotations

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ..control.messages import request_stream, response_stream
from .cobs import CobsDecoder, CobsEncoder
from .uart import UartReceiver, UartTransmitter, bit_increment


class SerialLink(wiring.Component):
    """Frames on a serial line.

    Parameters
    ----------
    clock_hz : float
        Frequency of the domain `sync`.
    baud : float

    Members
    -------
    rx : In(1), tx : Out(1)
        Pins.
    requests : Out, responses : In
        See `control.messages`.
    """

    def __init__(self, *, clock_hz: float, baud: float) -> None:
        self.increment = bit_increment(clock_hz, baud)
        super().__init__(
            {
                "rx": In(1),
                "tx": Out(1, init=1),
                "requests": Out(request_stream()),
                "responses": In(response_stream()),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.receiver = receiver = UartReceiver(self.increment)
        m.submodules.transmitter = transmitter = UartTransmitter(self.increment)
        m.submodules.decoder = decoder = CobsDecoder()
        m.submodules.encoder = encoder = CobsEncoder()
        m.d.comb += [receiver.rx.eq(self.rx), self.tx.eq(transmitter.tx)]
        connect(m, receiver.line, decoder.line)
        connect(m, decoder.frames, flipped(self.requests))
        connect(m, flipped(self.responses), encoder.messages)
        connect(m, encoder.line, transmitter.line)
        return m
