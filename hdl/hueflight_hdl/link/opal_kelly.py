# SPDX-License-Identifier: Apache-2.0
"""Opal Kelly's host interface (FrontPanel, USB 3): an adapter, **not tested on hardware here**.

The vendor's modules are not public and not part of this project: `okHost` and its endpoints are
instances that the vendor's files implement. The logic between them and the camera is tested.

# Ref: Opal Kelly, FrontPanel SDK: HDL modules for USB 3.0 devices (okHost, okWireOut, okPipeIn,
# okPipeOut, okBTPipeOut).
"""

from __future__ import annotations

from dataclasses import dataclass

from amaranth.hdl import Cat, ClockSignal, Const, Instance, Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.fifo import AsyncFIFO
from amaranth.lib.wiring import In, Out, connect, flipped

from ..control.messages import request_stream, response_stream
from .cobs import CobsDecoder, CobsEncoder
from .packet_crossing import PacketCrossing
from .packet_word import WORD_LAYOUT

BLOCK_BYTES = 1024
"""Of the block-throttled pipe; the host must read blocks of this size."""
QUEUE_WORDS = 1024
ANSWER_ENDPOINT, REQUEST_ENDPOINT, RESPONSE_ENDPOINT, PACKET_ENDPOINT = 0x20, 0x80, 0xA0, 0xA1


class OpalKellyStreams(wiring.Component):
    """Converts between the camera's streams and pipes of 32-bit words, in the clock domain `ok`.

    Pipes keep no boundaries: control messages are COBS frames, filled up with bytes 0 to whole
    words, which COBS ignores.

    Members
    -------
    packets : In, requests : Out, responses : In
        In `sync`.
    request_write, request_data : In
        A word of requests.
    response_read : In, response_data : Out, responses_wait : Out
        A word of responses, one clock after it is asked for; words that wait.
    packet_read : In, packet_data : Out, block_ready : Out
        Half a word of packets, one clock after it is asked for; a whole block waits.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "packets": In(stream.Signature(WORD_LAYOUT)),
                "requests": Out(request_stream()),
                "responses": In(response_stream()),
                "request_write": In(1),
                "request_data": In(32),
                "response_read": In(1),
                "response_data": Out(32),
                "responses_wait": Out(16),
                "packet_read": In(1),
                "packet_data": Out(32),
                "block_ready": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        self._packets(m)
        self._requests(m)
        self._responses(m)
        return m

    def _packets(self, m: Module) -> None:
        m.submodules.crossing = crossing = PacketCrossing(domain="ok", depth=QUEUE_WORDS)
        connect(m, flipped(self.packets), crossing.packets)
        second = Signal()
        m.d.comb += crossing.words.ready.eq(self.packet_read & second)
        m.d.ok += self.block_ready.eq(crossing.level >= BLOCK_BYTES // 8)
        with m.If(self.packet_read):
            m.d.ok += [
                second.eq(~second),
                self.packet_data.eq(crossing.words.payload.data.word_select(second, 32)),
            ]

    def _requests(self, m: Module) -> None:
        m.submodules.inward = inward = AsyncFIFO(
            width=32, depth=128, r_domain="sync", w_domain="ok"
        )
        m.submodules.decoder = decoder = CobsDecoder()
        place = Signal(2)
        m.d.comb += [
            inward.w_data.eq(self.request_data),
            inward.w_en.eq(self.request_write),
            decoder.line.valid.eq(inward.r_rdy),
            decoder.line.payload.data.eq(inward.r_data.word_select(place, 8)),
            inward.r_en.eq(place == 3),
        ]
        with m.If(inward.r_rdy):
            m.d.sync += place.eq(place + 1)
        connect(m, decoder.frames, flipped(self.requests))

    def _responses(self, m: Module) -> None:
        m.submodules.outward = outward = AsyncFIFO(
            width=32, depth=128, r_domain="ok", w_domain="sync"
        )
        m.submodules.encoder = encoder = CobsEncoder()
        connect(m, flipped(self.responses), encoder.messages)
        word = Signal(24)
        place = Signal(2)
        filling = Signal()  # with bytes 0, behind the one that ends a frame
        byte = encoder.line
        free = outward.w_rdy | (place != 3)
        taken = Signal()
        m.d.comb += [
            byte.ready.eq(free & ~filling),
            taken.eq(free & (filling | byte.valid)),
            outward.w_en.eq(taken & (place == 3)),
        ]
        now = Signal(8)
        with m.If(~filling):
            m.d.comb += now.eq(byte.payload)
        m.d.comb += outward.w_data.eq(Cat(word, now))
        with m.If(taken):
            m.d.sync += [
                place.eq(place + 1),
                word.eq(Cat(word[8:], now)),
                filling.eq((filling | (byte.payload == 0)) & (place != 3)),
            ]
        m.d.comb += [
            self.responses_wait.eq(outward.r_level),
            outward.r_en.eq(self.response_read),
        ]
        with m.If(self.response_read):
            m.d.ok += self.response_data.eq(outward.r_data)


@dataclass(frozen=True)
class OpalKellyPins:
    """Pins of the host interface, as a platform hands them out undriven."""

    uh: object
    hu: object
    uhu: object
    aa: object


class OpalKellyLink(wiring.Component):
    """The vendor's host interface with four endpoints.

    The domain `ok` has to be there; its clock is driven here.

    Members
    -------
    packets : In, requests : Out, responses : In
        In `sync`.
    """

    def __init__(self, pins: OpalKellyPins) -> None:
        self.pins = pins
        super().__init__(
            {
                "packets": In(stream.Signature(WORD_LAYOUT)),
                "requests": Out(request_stream()),
                "responses": In(response_stream()),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.streams = streams = OpalKellyStreams()
        connect(m, flipped(self.packets), streams.packets)
        connect(m, streams.requests, flipped(self.requests))
        connect(m, flipped(self.responses), streams.responses)
        to_endpoints = Signal(113)
        answers = [Signal(65, name=f"answer{i}") for i in range(4)]
        from_endpoints = Signal(65)
        m.d.comb += from_endpoints.eq(answers[0] | answers[1] | answers[2] | answers[3])
        m.submodules.host = Instance(
            "okHost",
            i_okUH=self.pins.uh.io,
            o_okHU=self.pins.hu.io,
            io_okUHU=self.pins.uhu.io,
            io_okAA=self.pins.aa.io,
            o_okClk=ClockSignal("ok"),
            o_okHE=to_endpoints,
            i_okEH=from_endpoints,
        )
        for number, (name, address, ports) in enumerate(
            (
                ("okWireOut", ANSWER_ENDPOINT, {"i_ep_datain": streams.responses_wait}),
                (
                    "okPipeIn",
                    REQUEST_ENDPOINT,
                    {
                        "o_ep_write": streams.request_write,
                        "o_ep_dataout": streams.request_data,
                    },
                ),
                (
                    "okPipeOut",
                    RESPONSE_ENDPOINT,
                    {
                        "o_ep_read": streams.response_read,
                        "i_ep_datain": streams.response_data,
                    },
                ),
                (
                    "okBTPipeOut",
                    PACKET_ENDPOINT,
                    {
                        "o_ep_read": streams.packet_read,
                        "i_ep_datain": streams.packet_data,
                        "i_ep_ready": streams.block_ready,
                    },
                ),
            )
        ):
            m.submodules[name] = Instance(
                name,
                i_okHE=to_endpoints,
                o_okEH=answers[number],
                i_ep_addr=Const(address, 8),
                **ports,
            )
        return m


BLACKBOXES = """\
(* blackbox *) module okHost(input [4:0] okUH, output [2:0] okHU, inout [31:0] okUHU, inout okAA,
  output okClk, output [112:0] okHE, input [64:0] okEH); endmodule
(* blackbox *) module okWireOut(input [112:0] okHE, output [64:0] okEH, input [7:0] ep_addr,
  input [31:0] ep_datain); endmodule
(* blackbox *) module okPipeIn(input [112:0] okHE, output [64:0] okEH, input [7:0] ep_addr,
  output ep_write, output [31:0] ep_dataout); endmodule
(* blackbox *) module okPipeOut(input [112:0] okHE, output [64:0] okEH, input [7:0] ep_addr,
  output ep_read, input [31:0] ep_datain); endmodule
(* blackbox *) module okBTPipeOut(input [112:0] okHE, output [64:0] okEH, input [7:0] ep_addr,
  output ep_read, output ep_blockstrobe, input [31:0] ep_datain, input ep_ready); endmodule
"""
"""Ports of the vendor's modules, for counting what is ours."""
