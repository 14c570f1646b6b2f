# SPDX-License-Identifier: Apache-2.0
"""Answers requests: each is checked completely before any part of it takes effect.

Rules C1 to C10 are those of ``docs/protocol.md``; `hueflight_protocol.RegisterFile` is the
implementation in software.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, enum, wiring
from amaranth.lib.crc.catalog import CRC32_ISCSI
from amaranth.lib.wiring import In, Out

from hueflight_protocol.control import (
    CONTROL_CRC_BYTES,
    CONTROL_HEADER,
    CONTROL_VERSION,
    IDENTITY_ADDRESS,
    IDENTITY_WORDS,
    MAX_MESSAGE_BYTES,
    MAX_WORDS,
    MIN_MESSAGE_BYTES,
    RESPONSE_BIT,
    STATUS_ADDRESS,
    STATUS_WORDS,
    Op,
    Result,
)
from hueflight_protocol.registers import ADDRESS_BITS, WORD_BITS

from .messages import request_stream, response_stream
from .register_file import RegisterFile
from .request_buffer import RequestBuffer

assert IDENTITY_WORDS == STATUS_WORDS
HEADER_BYTES = CONTROL_HEADER.size
HEADER = data.StructLayout(
    {"version": 8, "op": 8, "transaction": 16, "address": 16, "count": 8, "result": 8}
)
"""As `CONTROL_HEADER`: the first byte is the lowest."""
SNAPSHOT_CLOCKS = 32
"""Clocks from `begin` until registers are looked at; for what crosses clock domains."""


class State(enum.Enum):
    """State of the engine."""

    IDLE = 0
    CHECKSUM = 1
    FRAME = 2
    JUDGE = 3
    LOOK_UP = 4
    GATHER = 5
    STORE = 6
    HEAD = 7
    SEND = 8
    NEXT = 9


class ControlEngine(wiring.Component):
    """Takes requests from a link, accesses registers, and sends responses.

    Members
    -------
    requests : In, responses : Out
        See `control.messages`.
    begin : Out(1)
        A request arrived, valid or not; status registers may now be updated.
    latched : Out(1)
        High for one clock, at least `SNAPSHOT_CLOCKS` later; registers are read after it.
    answered, crc_error, framing_error : Out(1)
        High for one clock.
    address, reading, write, write_word : Out
        To the register file.
    exists, writable, refused, word : In
        From the register file.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "requests": In(request_stream()),
                "responses": Out(response_stream()),
                "begin": Out(1),
                "latched": Out(1),
                "answered": Out(1),
                "crc_error": Out(1),
                "framing_error": Out(1),
                "address": Out(ADDRESS_BITS + 1),
                "reading": Out(1),
                "write": Out(1),
                "write_word": Out(WORD_BITS),
                "exists": In(1),
                "writable": In(1),
                "refused": In(1),
                "word": In(WORD_BITS),
            }
        )
        # what proofs look at
        self.buffer = RequestBuffer()
        self.state = Signal(State)
        self.result = Signal(8)
        self.words = Signal(range(MAX_WORDS + 1))  # of the request
        self.left = Signal.like(self.words)
        self.dwell = Signal(2)  # clocks since index or address moved
        self.waited = Signal(range(SNAPSHOT_CLOCKS))
        self.outgoing_left = Signal(range(HEADER_BYTES + 1))
        self.tail = Signal()  # the CRC is being sent
        self.writing = Signal()

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.buffer = buffer = self.buffer
        m.submodules.crc = crc = CRC32_ISCSI(data_width=8).create()
        wiring.connect(m, wiring.flipped(self.requests), buffer.stream)

        state, result, words, left = self.state, self.result, self.words, self.left
        dwell, waited = self.dwell, self.waited
        outgoing_left, tail = self.outgoing_left, self.tail
        writing, header = self.writing, Signal(HEADER)
        first = Signal(ADDRESS_BITS)
        word = Signal(WORD_BITS)
        outgoing = Signal(8 * HEADER_BYTES)  # bytes to send, the next one lowest
        wrong_length = Signal()
        m.d.comb += writing.eq(header.op == Op.WRITE)
        m.d.sync += wrong_length.eq(
            (buffer.length < MIN_MESSAGE_BYTES)
            | (buffer.length > MAX_MESSAGE_BYTES)
            | (buffer.length[:2] != 0)
        )
        m.d.sync += [
            dwell.eq(dwell + 1),
            self.begin.eq(0),
            self.latched.eq(0),
            self.answered.eq(0),
            self.crc_error.eq(0),
            self.framing_error.eq(buffer.dropped),
        ]
        with m.If(waited != SNAPSHOT_CLOCKS - 1):
            m.d.sync += waited.eq(waited + 1)

        with m.Switch(state):
            with m.Case(State.IDLE):
                m.d.comb += crc.start.eq(1)
                m.d.sync += [buffer.index.eq(0), dwell.eq(0), waited.eq(0)]
                with m.If(buffer.full):
                    m.d.sync += [self.begin.eq(1), state.eq(State.CHECKSUM)]

            with m.Case(State.CHECKSUM):
                with m.If(dwell == RequestBuffer.latency):
                    m.d.comb += [crc.valid.eq(1), crc.data.eq(buffer.byte)]
                    m.d.sync += [buffer.index.eq(buffer.index + 1), dwell.eq(0)]
                    with m.If(buffer.index < HEADER_BYTES):
                        m.d.sync += header.eq(Cat(header.as_value()[8:], buffer.byte))
                with m.If(buffer.index == buffer.length):
                    m.d.sync += state.eq(State.FRAME)

            with m.Case(State.FRAME):
                with m.If(waited == SNAPSHOT_CLOCKS - 1):
                    m.d.sync += [self.latched.eq(1), state.eq(State.IDLE)]
                    with m.If(wrong_length):
                        m.d.comb += buffer.done.eq(1)
                        m.d.sync += self.framing_error.eq(1)
                    with m.Elif(~crc.match_detected):
                        m.d.comb += buffer.done.eq(1)
                        m.d.sync += self.crc_error.eq(1)
                    with m.Elif((header.op & RESPONSE_BIT) != 0):
                        m.d.comb += buffer.done.eq(1)
                        m.d.sync += self.framing_error.eq(1)
                    with m.Else():
                        m.d.sync += state.eq(State.JUDGE)

            with m.Case(State.JUDGE):
                m.d.sync += [
                    result.eq(self._judge(m, header, buffer.length, words)),
                    first.eq(header.address),
                    self.address.eq(header.address),
                    dwell.eq(0),
                    state.eq(State.LOOK_UP),
                ]
                for op, address in ((Op.IDENTIFY, IDENTITY_ADDRESS), (Op.STATUS, STATUS_ADDRESS)):
                    with m.If(header.op == op):
                        m.d.sync += [first.eq(address), self.address.eq(address)]
                m.d.sync += left.eq(0)

            with m.Case(State.LOOK_UP):
                # `left` counts up here: every address is looked at before anything is done
                # That it is over is seen in the first clock of an address, so never in its last.
                with m.If(dwell == RegisterFile.latency):
                    m.d.sync += [
                        self.address.eq(self.address + 1),
                        dwell.eq(0),
                        left.eq(left + 1),
                    ]
                    self._examine(m, result, writing)
                with m.Elif(
                    (left == words) | (result < Result.BAD_ADDRESS) & (result != Result.OK)
                ):
                    m.d.sync += [
                        self.address.eq(first),
                        buffer.index.eq(HEADER_BYTES),
                        dwell.eq(0),
                        left.eq(words),
                        state.eq(State.HEAD),
                    ]
                    with m.If((result == Result.OK) & writing):
                        m.d.sync += state.eq(State.GATHER)

            with m.Case(State.GATHER):
                with m.If(dwell == RequestBuffer.latency):
                    m.d.sync += [
                        word.eq(Cat(word[8:], buffer.byte)),
                        buffer.index.eq(buffer.index + 1),
                        dwell.eq(0),
                    ]
                    with m.If(buffer.index[:2] == 3):
                        m.d.sync += state.eq(State.STORE)

            with m.Case(State.STORE):
                m.d.comb += self.write.eq(1)
                m.d.sync += [
                    self.address.eq(self.address + 1),
                    dwell.eq(0),
                    left.eq(left - 1),
                    state.eq(Mux(left == 1, State.HEAD, State.GATHER)),
                ]

            with m.Case(State.HEAD):
                answer = Signal(HEADER)
                reads = Signal()
                m.d.comb += [
                    crc.start.eq(1),
                    reads.eq((result == Result.OK) & ~writing),
                    answer.version.eq(CONTROL_VERSION),
                    answer.op.eq(header.op | RESPONSE_BIT),
                    answer.transaction.eq(header.transaction),
                    answer.address.eq(header.address),
                    answer.count.eq(Mux(reads, words, 0)),
                    answer.result.eq(result),
                ]
                m.d.sync += [
                    outgoing.eq(answer),
                    outgoing_left.eq(HEADER_BYTES),
                    tail.eq(0),
                    left.eq(Mux(reads, words, 0)),
                    state.eq(State.SEND),
                ]

            with m.Case(State.SEND):
                m.d.comb += [
                    self.responses.valid.eq(1),
                    self.responses.payload.data.eq(outgoing[:8]),
                    self.responses.payload.last.eq(tail & (outgoing_left == 1)),
                    crc.data.eq(outgoing[:8]),
                ]
                with m.If(self.responses.ready):
                    m.d.comb += crc.valid.eq(~tail)
                    m.d.sync += [outgoing.eq(outgoing[8:]), outgoing_left.eq(outgoing_left - 1)]
                    with m.If(outgoing_left == 1):
                        m.d.sync += [dwell.eq(0), state.eq(State.NEXT)]

            with m.Case(State.NEXT):
                with m.If(tail):
                    m.d.comb += buffer.done.eq(1)
                    m.d.sync += [self.answered.eq(1), state.eq(State.IDLE)]
                with m.Elif(left == 0):
                    m.d.sync += [
                        outgoing.eq(crc.crc),
                        outgoing_left.eq(CONTROL_CRC_BYTES),
                        tail.eq(1),
                        state.eq(State.SEND),
                    ]
                with m.Elif(dwell == RegisterFile.latency):
                    m.d.comb += self.reading.eq(1)
                    m.d.sync += [
                        outgoing.eq(self.word),
                        outgoing_left.eq(WORD_BITS // 8),
                        self.address.eq(self.address + 1),
                        left.eq(left - 1),
                        state.eq(State.SEND),
                    ]
        m.d.comb += self.write_word.eq(word)
        return m

    def _judge(self, m: Module, header: data.View, length: Signal, words: Signal) -> Signal:
        """Return what can be said of the header alone; sets `words` to those asked for."""
        result = Signal(8)
        payload = Signal(8)
        expected = Signal(8)
        m.d.comb += payload.eq((length >> 2) - MIN_MESSAGE_BYTES // 4)
        with m.Switch(header.op):
            with m.Case(Op.IDENTIFY, Op.STATUS):
                m.d.sync += words.eq(IDENTITY_WORDS)
                m.d.comb += result.eq(Mux(payload == 0, Result.OK, Result.BAD_COUNT))
            with m.Case(Op.READ, Op.WRITE):
                m.d.sync += words.eq(header.count)
                m.d.comb += expected.eq(Mux(header.op == Op.WRITE, header.count, 0))
                fits = (header.count != 0) & (header.count <= MAX_WORDS) & (payload == expected)
                m.d.comb += result.eq(Mux(fits, Result.OK, Result.BAD_COUNT))
            with m.Default():
                m.d.comb += result.eq(Result.BAD_OP)
        with m.If(header.version != CONTROL_VERSION):
            m.d.comb += result.eq(Result.BAD_VERSION)
        return result

    def _examine(self, m: Module, result: Signal, writing: Signal) -> None:
        """Lower `result` to what the address at hand gives, if that comes before it."""
        with m.If(~self.exists):
            m.d.sync += result.eq(Result.BAD_ADDRESS)
        with m.Elif(writing & ~self.writable):
            with m.If(result != Result.BAD_ADDRESS):
                m.d.sync += result.eq(Result.READ_ONLY)
        with m.Elif(writing & self.refused & (result == Result.OK)):
            m.d.sync += result.eq(Result.REFUSED)
