# SPDX-License-Identifier: Apache-2.0
"""Consistent Overhead Byte Stuffing in gateware; the software codec is in `hueflight_protocol`.

# Ref: S. Cheshire, M. Baker, Consistent Overhead Byte Stuffing, IEEE/ACM Transactions on
# Networking 7(2), 1999; rules B1 to B3 of docs/protocol.md.
"""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from hueflight_protocol.control import MAX_COBS_BYTES

from ..control.messages import request_stream, response_stream

_BLOCK = 254

LINE_BYTE = data.StructLayout({"data": 8, "bad": 1})
"""A byte from a line, and whether it came damaged."""


class CobsDecoder(wiring.Component):
    """Decodes frames from a line.

    Zero bytes between frames are ignored. A frame with a damaged byte, a code that points beyond
    its end, or more than `MAX_COBS_BYTES` bytes ends with `bad`.

    Members
    -------
    line : In
        Bytes as they come; always ready.
    frames : Out
        See `control.messages.request_stream`.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "line": In(stream.Signature(LINE_BYTE, always_ready=True)),
                "frames": Out(request_stream()),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        begun = Signal()
        bad = Signal()
        length = Signal(range(MAX_COBS_BYTES + 1))
        block_left = Signal(8)
        zero_due = Signal()  # the last block stands for a zero, if another follows
        beat = self.frames.payload
        byte = self.line.payload
        m.d.sync += [self.frames.valid.eq(0), beat.end.eq(0), beat.bad.eq(0)]
        with m.If(self.line.valid):
            with m.If((byte.data == 0) & ~byte.bad):
                m.d.sync += [
                    self.frames.valid.eq(begun),
                    beat.end.eq(1),
                    beat.bad.eq(bad | (block_left != 0)),
                    begun.eq(0),
                    bad.eq(0),
                    length.eq(0),
                    block_left.eq(0),
                    zero_due.eq(0),
                ]
            with m.Else():
                m.d.sync += begun.eq(1)
                with m.If(byte.bad | (length == MAX_COBS_BYTES)):
                    m.d.sync += bad.eq(1)
                with m.Elif(~bad):
                    m.d.sync += length.eq(length + 1)
                    with m.If(block_left == 0):
                        m.d.sync += [
                            self.frames.valid.eq(zero_due),
                            beat.data.eq(0),
                            block_left.eq(byte.data - 1),
                            zero_due.eq(byte.data != _BLOCK + 1),
                        ]
                    with m.Else():
                        m.d.sync += [
                            self.frames.valid.eq(1),
                            beat.data.eq(byte.data),
                            block_left.eq(block_left - 1),
                        ]
        return m


class CobsEncoder(wiring.Component):
    """Encodes messages and ends each with a zero byte.

    A block is collected until its length is known and then sent; no input is taken meanwhile.

    Members
    -------
    messages : In
        See `control.messages.response_stream`.
    line : Out
        Bytes.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "messages": In(response_stream()),
                "line": Out(stream.Signature(8)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.memory = memory = Memory(shape=8, depth=256, init=[])
        save = memory.write_port(domain="sync")
        load = memory.read_port(domain="sync")
        count = Signal(8)  # bytes of the block
        sent = Signal(8)
        byte = Signal(8)
        last = Signal()  # the block ends the message
        empty = Signal()  # an empty block follows: the message's last byte is zero
        beat = self.messages.payload
        m.d.comb += [
            save.addr.eq(count),
            save.data.eq(beat.data),
            load.addr.eq(sent),
            load.en.eq(1),
        ]
        with m.FSM(name="encoder"):
            with m.State("GATHER"):
                m.d.comb += self.messages.ready.eq(1)
                m.d.sync += [sent.eq(0), last.eq(beat.last), empty.eq(0)]
                with m.If(self.messages.valid):
                    with m.If(beat.data == 0):
                        m.d.sync += empty.eq(beat.last)
                        m.next = "CODE"
                    with m.Else():
                        m.d.comb += save.en.eq(1)
                        m.d.sync += count.eq(count + 1)
                        with m.If(beat.last | (count == _BLOCK - 1)):
                            m.next = "CODE"
            with m.State("CODE"):
                m.d.comb += [self.line.valid.eq(1), self.line.payload.eq(count + 1)]
                with m.If(self.line.ready):
                    m.next = "FETCH"
            with m.State("FETCH"):
                m.next = "LOAD"
                with m.If(sent == count):
                    m.d.sync += [count.eq(0), sent.eq(0)]
                    with m.If(empty):
                        m.d.sync += empty.eq(0)
                        m.next = "CODE"
                    with m.Else():
                        m.next = "GATHER"
                        with m.If(last):
                            m.next = "DELIMITER"
            with m.State("LOAD"):
                m.d.sync += byte.eq(load.data)  # block memories are slow
                m.next = "BYTE"
            with m.State("BYTE"):
                m.d.comb += [self.line.valid.eq(1), self.line.payload.eq(byte)]
                with m.If(self.line.ready):
                    m.d.sync += sent.eq(sent + 1)
                    m.next = "FETCH"
            with m.State("DELIMITER"):
                m.d.comb += [self.line.valid.eq(1), self.line.payload.eq(0)]
                with m.If(self.line.ready):
                    m.next = "GATHER"
        return m
