# SPDX-License-Identifier: Apache-2.0
"""Packets other than frames: events, status, test patterns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, Value, signed
from amaranth.lib import data, enum, stream, wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.layout import Layout
from hueflight_protocol.wire import (
    EVENT_BODY,
    PACKET_HEADER,
    STATUS_BODY,
    TEST_BODY,
    EventCode,
    EventLevel,
    PacketType,
    PatternKind,
)

from .formatter.piece_reader import MESSAGE_LAYOUT

COUNTERS_LAYOUT = data.StructLayout(
    {
        "frame": 64,
        "frames_sent": 64,
        "frames_dropped": 32,
        "frames_aborted": 32,
        "triggers_lost": 32,
        "stall_clocks": 32,
        "buffer_peak": 32,
        "faults": 32,
    }
)
"""Counters in status and event packets."""

HEADER_WORDS = PACKET_HEADER.size // 8
WORDS_BITS = 18


@dataclass(frozen=True)
class EventKind:
    """An event that the camera reports."""

    name: str
    code: EventCode
    level: EventLevel


EVENTS = (
    EventKind("started", EventCode.RUN_STARTED, EventLevel.INFO),
    EventKind("overflow", EventCode.OVERFLOW, EventLevel.WARNING),
    EventKind("trigger_lost", EventCode.TRIGGER_LOST, EventLevel.WARNING),
    EventKind("fault", EventCode.SENSOR_FAULT, EventLevel.ERROR),
    EventKind("stopped", EventCode.RUN_STOPPED, EventLevel.INFO),
)
"""Events in the order in which they are sent if several wait."""


class _Kind(enum.Enum):
    EVENT = 0
    STATUS = 1
    TEST = 2


class Messenger(wiring.Component):
    """Sends packets for events; an event that repeats before its packet is sent is counted in it.

    Members
    -------
    started, overflow, trigger_lost, fault, stopped : In(1)
        An event happened.
    status, test : In(1)
        A status or a test packet is wanted.
    capture : In(32), now : In(64), counters : In
        What packets say; `counters` see `COUNTERS_LAYOUT`.
    temperature : In(signed(32))
        In status packets, in millidegrees Celsius.
    pattern, words, seed : In
        Of test packets; one of no words is not sent.
    idle : Out(1)
        Nothing waits.
    o : Out(stream)
        See `MESSAGE_LAYOUT`.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                **{event.name: In(1) for event in EVENTS},
                "status": In(1),
                "test": In(1),
                "capture": In(32),
                "now": In(64),
                "counters": In(COUNTERS_LAYOUT),
                "temperature": In(signed(32)),
                "pattern": In(PatternKind),
                "words": In(WORDS_BITS),
                "seed": In(32),
                "idle": Out(1),
                "o": Out(stream.Signature(MESSAGE_LAYOUT)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        kind = Signal(_Kind)
        chosen = Signal(range(len(EVENTS)))
        word = Signal(range(16))
        left = Signal(range(1 << (WORDS_BITS - 1)))  # words of 64 bits of a test pattern
        odd = Signal()  # the last of them is half empty
        words = Signal(WORDS_BITS)
        pattern = Signal(PatternKind)
        next_word = Signal(32)

        # what waits
        waiting = Signal(len(EVENTS))
        status_waits, test_waits = Signal(), Signal()
        taken = Signal(len(EVENTS))
        happened = Signal(len(EVENTS))  # a clock late, as what is told of it
        m.d.sync += [
            happened.eq(Cat(getattr(self, event.name) for event in EVENTS)),
            waiting.eq((waiting & ~taken) | happened),
        ]
        with m.If(self.status):
            m.d.sync += status_waits.eq(1)
        with m.If(self.test):
            m.d.sync += test_waits.eq(1)
        counts, values = self._told(m, happened, taken)

        # one word is made while the one before waits
        made = Signal(MESSAGE_LAYOUT)
        making, free = Signal(), Signal()
        m.d.comb += free.eq(self.o.ready | ~self.o.valid)
        with m.If(free):
            m.d.sync += [self.o.valid.eq(making), self.o.payload.eq(made)]

        header = record_words(PACKET_HEADER, self._header(kind, words))
        event = record_words(EVENT_BODY, self._event(chosen, counts, values))
        status = record_words(STATUS_BODY, self._status())
        test = record_words(TEST_BODY, {"pattern": pattern, "seed": next_word})
        with m.FSM():
            with m.State("IDLE"):
                m.d.comb += self.idle.eq(
                    ~(happened | waiting).any() & ~status_waits & ~test_waits & ~self.o.valid
                )
                m.d.sync += word.eq(0)
                with m.If(waiting.any()):
                    for number in reversed(range(len(EVENTS))):
                        with m.If(waiting[number]):
                            m.d.sync += chosen.eq(number)
                    m.d.sync += kind.eq(_Kind.EVENT)
                    m.next = "HEADER"
                with m.Elif(status_waits):
                    m.d.sync += [kind.eq(_Kind.STATUS), status_waits.eq(0)]
                    m.next = "HEADER"
                with m.Elif(test_waits & (self.words == 0)):
                    m.d.sync += test_waits.eq(0)
                with m.Elif(test_waits):
                    m.d.sync += [
                        kind.eq(_Kind.TEST),
                        test_waits.eq(0),
                        pattern.eq(self.pattern),
                        next_word.eq(self.seed),
                        words.eq(self.words),
                        left.eq(self.words >> 1),
                        odd.eq(~self.words[0]),
                    ]
                    m.next = "HEADER"
            with m.State("HEADER"):
                m.d.comb += [
                    making.eq(1),
                    made.data.eq(header[word[:2]]),
                    made.check.eq(word == HEADER_WORDS - 1),
                ]
                with m.If(free):
                    m.d.sync += word.eq(word + 1)
                    with m.If(made.check):
                        m.d.sync += word.eq(0)
                        m.next = "BODY"
            with m.State("BODY"):
                m.d.comb += making.eq(1)
                ends = Signal()
                with m.Switch(kind):
                    with m.Case(_Kind.EVENT):
                        m.d.comb += [made.data.eq(event[word[0]]), ends.eq(word[0])]
                    with m.Case(_Kind.STATUS):
                        m.d.comb += [made.data.eq(status[word[:2]]), ends.eq(word == 3)]
                    with m.Default():
                        # kind and seed; then two words at a time
                        m.d.comb += [made.data.eq(test[0]), ends.eq(left == 0)]
                with m.If(free):
                    m.d.sync += word.eq(word + 1)
                    with m.If(kind == _Kind.EVENT):
                        m.d.comb += taken.eq(Mux(word[0], 1 << chosen, 0))
                    with m.If(kind == _Kind.TEST):
                        m.d.sync += next_word.eq(_following(next_word, pattern, by=1))
                        m.next = "PATTERN"
                    with m.If(ends):
                        m.next = "TRAILER"
            with m.State("PATTERN"):
                second = Signal(32)
                m.d.comb += [
                    making.eq(1),
                    second.eq(_following(next_word, pattern, by=1)),
                    made.data.eq(Cat(next_word, Mux(odd & (left == 1), 0, second))),
                ]
                with m.If(free):
                    m.d.sync += [
                        left.eq(left - 1),
                        next_word.eq(_following(next_word, pattern, by=2)),
                    ]
                    with m.If(left == 1):
                        m.next = "TRAILER"
            with m.State("TRAILER"):
                m.d.comb += [making.eq(1), made.last.eq(1)]
                with m.If(free):
                    m.next = "IDLE"
        return m

    def _header(self, kind: Signal, words: Signal) -> dict[str, Value]:
        length = Mux(
            kind == _Kind.EVENT,
            EVENT_BODY.size,
            Mux(kind == _Kind.STATUS, STATUS_BODY.size, (words + 1) << 2),
        )
        packet_type = Mux(
            kind == _Kind.EVENT,
            PacketType.EVENT.value,
            Mux(kind == _Kind.STATUS, PacketType.STATUS.value, PacketType.TEST.value),
        )
        return {
            "type": packet_type,
            "length": length,
            "sequence": Const(0),
            "timestamp": self.now,
            "capture": self.capture,
            "check": Const(0),
        }

    def _told(self, m: Module, happened: Signal, taken: Signal) -> tuple[Array, Array]:
        """Return count and value of each kind of event."""
        counters = self.counters
        names = [event.name for event in EVENTS]
        overflow_frame, fault_frame = Signal(64), Signal(64)
        lost_now = Signal(32)
        lost, started = (happened[names.index(name)] for name in ("trigger_lost", "started"))
        with m.If(self.overflow):
            m.d.sync += overflow_frame.eq(counters.frame)
        with m.If(self.fault):
            m.d.sync += fault_frame.eq(counters.frame)
        with m.If(taken[names.index("trigger_lost")] | started):
            m.d.sync += lost_now.eq(lost)
        with m.Elif(lost & (lost_now != (1 << 32) - 1)):
            m.d.sync += lost_now.eq(lost_now + 1)
        overflows = Signal(33)
        m.d.sync += overflows.eq(counters.frames_dropped + counters.frames_aborted)
        told = {
            "started": (Const(1, 32), self.capture),
            "overflow": (Mux(overflows[32], 0xFFFF_FFFF, overflows[:32]), overflow_frame),
            "trigger_lost": (counters.triggers_lost, lost_now),
            "fault": (counters.faults, fault_frame),
            "stopped": (Const(1, 32), counters.frame),
        }
        return Array(told[name][0] for name in names), Array(told[name][1] for name in names)

    def _event(self, chosen: Signal, counts: Array, values: Array) -> dict[str, Value]:
        codes = Array(Const(event.code.value, 16) for event in EVENTS)
        levels = Array(Const(event.level.value, 8) for event in EVENTS)
        return {
            "code": codes[chosen],
            "level": levels[chosen],
            "count": counts[chosen],
            "value": values[chosen],
        }

    def _status(self) -> dict[str, Value]:
        names = ("frames_sent", "frames_dropped", "frames_aborted", "triggers_lost")
        names += ("stall_clocks", "buffer_peak")
        told: dict[str, Value] = {name: self.counters[name] for name in names}
        return told | {"temperature_mdeg": self.temperature.as_unsigned()}


def record_words(layout: Layout, values: Mapping[str, Value]) -> Array:
    """Return a record as words of 64 bits; constants are those of the layout."""
    parts: list[Value] = []
    for field in layout.fields:
        bits = 8 * field.size
        value = Const(field.constant) if field.constant is not None else values[field.name]
        parts.append((Value.cast(value) | Const(0, bits))[:bits])
    whole = Cat(parts)
    return Array(whole[64 * i : 64 * (i + 1)] for i in range(layout.size // 8))


def _following(word: Value, pattern: Value, *, by: int) -> Value:
    """Return the word of a test pattern that comes `by` words after `word`."""
    shifted = word
    for _ in range(by):
        a = shifted ^ (shifted << 13)[:32]
        b = a ^ (a >> 17)
        shifted = b ^ (b << 5)[:32]
    return Mux(pattern == PatternKind.COUNTER, (word + by)[:32], shifted)
