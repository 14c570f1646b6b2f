# SPDX-License-Identifier: Apache-2.0
"""Buffers complete requests until the engine is free."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from .messages import request_stream

_SLOT_BYTES = 512
SLOTS = 2


class RequestBuffer(wiring.Component):
    """Holds two requests: one in progress and one that arrives.

    A request that is damaged, longer than a slot, or arrives while both slots are occupied is
    dropped completely and reported.

    Members
    -------
    stream : In
        From the link.
    full : Out(1), length : Out
        There is a request, of so many bytes.
    index : In
        Byte to look up.
    byte : Out(8)
        Two clocks later.
    done : In(1)
        The request may be overwritten.
    dropped : Out(1)
        High for one clock.
    """

    latency = 2

    def __init__(self) -> None:
        super().__init__(
            {
                "stream": In(request_stream()),
                "full": Out(1),
                "length": Out(range(_SLOT_BYTES)),
                "index": In(range(_SLOT_BYTES)),
                "byte": Out(8),
                "done": In(1),
                "dropped": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.memory = memory = Memory(shape=8, depth=SLOTS * _SLOT_BYTES, init=[])
        save = memory.write_port(domain="sync")
        load = memory.read_port(domain="sync")
        taken = Signal(SLOTS)
        lengths = [Signal(range(_SLOT_BYTES), name=f"length{i}") for i in range(SLOTS)]
        coming = Signal()  # slot that is written
        working = Signal()  # slot that is read
        count = Signal(range(_SLOT_BYTES + 1))
        overrun = Signal()
        beat = self.stream.payload
        full = Signal()
        too_long = count[-1]  # the count stops there
        m.d.comb += [
            full.eq(taken.bit_select(coming, 1)),
            save.addr.eq(Cat(count[:-1], coming)),
            save.data.eq(beat.data),
            save.en.eq(self.stream.valid & ~beat.end & ~full & ~too_long),
            load.en.eq(1),
            load.addr.eq(Cat(self.index, working)),
            self.full.eq(taken.bit_select(working, 1)),
            self.length.eq(Mux(working, lengths[1], lengths[0])),
        ]
        m.d.sync += [self.byte.eq(load.data), self.dropped.eq(0)]
        with m.If(self.stream.valid):
            with m.If(beat.end):
                m.d.sync += [count.eq(0), overrun.eq(0)]
                with m.If(beat.bad | overrun | full | too_long):
                    m.d.sync += self.dropped.eq(1)
                with m.Else():
                    m.d.sync += [taken.bit_select(coming, 1).eq(1), coming.eq(~coming)]
            with m.Else():
                m.d.sync += overrun.eq(overrun | full)
                with m.If(~too_long):
                    m.d.sync += count.eq(count + 1)
        # of a slot that waits to be written, the length so far is as good as any
        for slot in range(SLOTS):
            with m.If((coming == slot) & ~full):
                m.d.sync += lengths[slot].eq(count)
        with m.If(self.done):
            m.d.sync += [taken.bit_select(working, 1).eq(0), working.eq(~working)]
        return m
