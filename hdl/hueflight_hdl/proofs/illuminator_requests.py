# SPDX-License-Identifier: Apache-2.0
"""Every accepted request is answered within a bounded time."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Mux, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from hueflight_protocol.control import CONTROL_CRC_BYTES, Result
from hueflight_protocol.registers import WORD_BITS

from ..control.engine import HEADER_BYTES, SNAPSHOT_CLOCKS, ControlEngine, State
from ..control.messages import REQUEST_BYTE
from ..control.register_file import RegisterFile
from ..control.request_buffer import RequestBuffer

_WORD_BYTES = WORD_BITS // 8
_LOOK_UP = RegisterFile.latency + 1
_BYTE = RequestBuffer.latency + 1
_READ = _LOOK_UP + _WORD_BYTES
_WRITE = _WORD_BYTES * _BYTE + 1
_WORDS = 127
"""More words than a request can have."""
LONGEST = 4000
"""Clocks in which any request is done, waits for the link not counted."""


class AnswerHarness(wiring.Component):
    """The engine with any bytes from the link, any registers, and a link that waits at will."""

    def __init__(self) -> None:
        self.engine = ControlEngine()
        super().__init__(
            {
                "comes": In(1),
                "byte": In(REQUEST_BYTE),
                "takes": In(1),
                "exists": In(1),
                "writable": In(1),
                "refused": In(1),
                "word": In(WORD_BITS),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.engine = engine = self.engine
        responses = engine.responses
        m.d.comb += [
            engine.requests.valid.eq(self.comes),
            engine.requests.payload.eq(self.byte),
            responses.ready.eq(self.takes),
            engine.exists.eq(self.exists),
            engine.writable.eq(self.writable),
            engine.refused.eq(self.refused),
            engine.word.eq(self.word),
        ]
        idle = engine.state == State.IDLE

        # a request that was taken up is over within LONGEST clocks
        elapsed = Signal(range(LONGEST + 2))
        waits = responses.valid & ~self.takes
        with m.If(idle):
            m.d.sync += elapsed.eq(0)
        with m.Elif(~waits):
            m.d.sync += elapsed.eq(elapsed + 1)
        m.d.comb += Assert(elapsed <= LONGEST)
        # one that waits is taken up at once
        begun = Signal()
        m.d.sync += begun.eq(idle & engine.buffer.full)
        with m.If(begun):
            m.d.comb += Assert(~idle)

        # it ends with one answer, or it was damaged and is counted; nothing else ends it
        ended = Signal()
        whole = Signal()  # an answer was sent to its last byte since the engine took it up
        answering = Signal()
        busy = Signal()
        m.d.sync += [ended.eq(engine.buffer.done), busy.eq(~idle)]
        with m.If(idle):
            m.d.sync += [whole.eq(0), answering.eq(0)]
        with m.If(responses.valid & self.takes):
            m.d.sync += [whole.eq(responses.payload.last), answering.eq(1)]
            m.d.comb += Assert(~whole)
        m.d.comb += Assert(ended == (idle & busy))
        with m.If(ended):
            m.d.comb += [
                Assert(engine.answered | engine.crc_error | engine.framing_error),
            ]
        with m.If(engine.answered):
            m.d.comb += Assert(ended)
        self._invariants(m, elapsed, whole, answering)
        return m

    def _invariants(self, m: Module, elapsed: Signal, whole: Signal, answering: Signal) -> None:
        """What the induction needs: never more to do than the time that is left."""
        engine = self.engine
        state, left, dwell = engine.state, engine.left, engine.dwell
        index, length = engine.buffer.index, engine.buffer.length
        answer = HEADER_BYTES + 1 + 1 + CONTROL_CRC_BYTES + 1
        to_do = Signal(range(2 * LONGEST))
        m.d.comb += Assert(elapsed + to_do <= LONGEST)
        m.d.comb += Assert(Value.cast(state) < len(State))
        with m.If(state != State.IDLE):
            m.d.comb += Assert(engine.buffer.full)
        judged = 1 + _LOOK_UP * _WORDS + 1 + max(_WRITE, _READ) * _WORDS + answer
        with m.Switch(state):
            with m.Case(State.CHECKSUM):
                m.d.comb += [
                    to_do.eq((length - index) * _BYTE - dwell + SNAPSHOT_CLOCKS + 2 + judged),
                    Assert(index <= length),
                    Assert(dwell < _BYTE),
                    Assert((index != length) | (dwell == 0)),
                    Assert(~whole & ~answering),
                ]
            with m.Case(State.FRAME):
                m.d.comb += [
                    to_do.eq(SNAPSHOT_CLOCKS - engine.waited + judged),
                    Assert(~whole & ~answering),
                ]
            with m.Case(State.JUDGE):
                m.d.comb += [to_do.eq(judged), Assert(~whole & ~answering)]
            with m.Case(State.LOOK_UP):
                m.d.comb += [
                    to_do.eq(judged - 1 - left * _LOOK_UP - dwell),
                    Assert(left <= engine.words),
                    Assert((left != engine.words) | (dwell == 0)),
                    Assert((engine.words != 0) | (engine.result != Result.OK) | ~engine.writing),
                    Assert(~whole & ~answering),
                ]
            with m.Case(State.GATHER):
                m.d.comb += [
                    to_do.eq(left * _WRITE - index[:2] * _BYTE - dwell + answer),
                    Assert(engine.writing & (left != 0)),
                    Assert(dwell < _BYTE),
                    Assert(~whole & ~answering),
                ]
            with m.Case(State.STORE):
                m.d.comb += [
                    to_do.eq((left - 1) * _WRITE + 1 + answer),
                    Assert(engine.writing & (left != 0)),
                    Assert(index[:2] == 0),
                    Assert(~whole & ~answering),
                ]
            with m.Case(State.HEAD):
                m.d.comb += [
                    to_do.eq(Mux(engine.writing, 0, _READ * engine.words) + answer),
                    Assert(~whole & ~answering),
                ]
            with m.Case(State.SEND):
                m.d.comb += [
                    to_do.eq(
                        engine.outgoing_left
                        + Mux(engine.tail, 1, left * _READ + 1 + CONTROL_CRC_BYTES + 1)
                    ),
                    Assert(engine.outgoing_left != 0),
                    Assert(~whole),
                ]
            with m.Case(State.NEXT):
                m.d.comb += [
                    to_do.eq(
                        Mux(
                            engine.tail,
                            1,
                            left * _READ - Mux(left == 0, 0, dwell) + 1 + CONTROL_CRC_BYTES + 1,
                        )
                    ),
                    Assert(whole == engine.tail),
                ]
