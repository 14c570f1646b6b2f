# SPDX-License-Identifier: Apache-2.0
"""The sensor port behind serial lanes: aligned words to beats of codes."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.fifo import AsyncFIFO
from amaranth.lib.wiring import In, Out

from ..port import SensorPort, sensor_beat_layout
from .lane import LaneAligner
from .link_format import FLAGS, LinkFormat, control_word

READ_CLOCKS = 8
"""Clocks of `sync` for which the pin that asks for a readout is high."""
_LOST_WORDS = 4
"""Wrong words in a row, outside of a frame, after which a lane is aligned again."""
_QUEUE_BEATS = 16


class DdrReceiver(wiring.Component):
    """Aligns the lanes, finds frames and passes them to the sensor port.

    A frame is passed to its end only if all lanes show the training word behind it. If a lane
    has slipped, or a control word is damaged, a beat with wrong marks ends the frame, and the
    camera counts a fault: no shifted image is ever delivered. A lane may lag behind another by a
    word.

    Parameters
    ----------
    link : LinkFormat
        Words and lanes. No more words may come than the domain `sync` has clocks.

    Members
    -------
    port : In(SensorPort)
        The sensor port, from the side of the sensor; domain `sync`.
    samples : In
        From the I/O registers, domain `sensor`; see `LinkFormat.samples_layout`.
    expose_pin, read_pin : Out(1)
        To the sensor, in `sync`; the second is high for `READ_CLOCKS` clocks.
    locked : Out(lanes)
        Lanes that are aligned, in `sync`.
    """

    def __init__(self, link: LinkFormat) -> None:
        self.link = link
        super().__init__(
            {
                "port": In(SensorPort(link.form)),
                "samples": In(link.samples_layout),
                "expose_pin": Out(1),
                "read_pin": Out(1),
                "locked": Out(link.lanes),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        self._requests(m)
        lanes, fresh = self._lanes(m)
        beat, valid = self._frames(m, lanes, fresh)
        out: stream.Interface = self.port.beats
        m.submodules.queue = queue = AsyncFIFO(
            width=len(beat.as_value()), depth=_QUEUE_BEATS, w_domain="sensor", r_domain="sync"
        )
        m.d.comb += [
            queue.w_data.eq(beat),
            queue.w_en.eq(valid),
            queue.r_en.eq(1),
            out.payload.eq(queue.r_data),
            out.valid.eq(queue.r_rdy),
        ]
        return m

    def _requests(self, m: Module) -> None:
        """Drive the sensor's pins from registers, without glitches."""
        left = Signal(range(READ_CLOCKS + 1))
        with m.If(self.port.read):
            m.d.sync += left.eq(READ_CLOCKS)
        with m.Elif(left != 0):
            m.d.sync += left.eq(left - 1)
        m.d.sync += [self.expose_pin.eq(self.port.expose), self.read_pin.eq(left != 0)]

    def _lanes(self, m: Module) -> tuple[list[LaneAligner], Signal]:
        """Add the lanes; return them, and a signal that they have new words."""
        count = Signal(range(self.link.clocks_per_word))
        strobe, fresh = Signal(), Signal()
        m.d.comb += strobe.eq(count == self.link.clocks_per_word - 1)
        m.d.sensor += [count.eq(Mux(strobe, 0, count + 1)), fresh.eq(strobe)]
        lanes = []
        for number in range(self.link.lanes):
            m.submodules[f"lane{number}"] = lane = LaneAligner(self.link)
            m.d.comb += [lane.samples.eq(self.samples[number]), lane.strobe.eq(strobe)]
            lanes.append(lane)
        m.submodules.locked = FFSynchronizer(Cat(lane.locked for lane in lanes), self.locked)
        return lanes, fresh

    def _frames(
        self, m: Module, lanes: list[LaneAligner], fresh: Signal
    ) -> tuple[data.View, Signal]:
        """Return beats and when there is one, in the domain `sensor`.

        What words are is found out in one clock, and what follows from it in the next.
        """
        link, form = self.link, self.link.form
        *coded, control = lanes
        known, right, locked = Signal(), Signal(), Signal()
        training, start = Signal(link.lanes), Signal(link.lanes)
        flags = Signal(len(FLAGS))
        m.d.comb += flags.eq(control.word)
        m.d.sensor += [
            known.eq(fresh),
            training.eq(Cat(lane.word == link.training for lane in lanes)),
            start.eq(Cat(lane.word == link.start for lane in lanes)),
            locked.eq(Cat(lane.locked for lane in lanes).all()),
            # the words can be codes, and the control word is one
            right.eq(
                (control.word == control_word(flags))
                & ~Cat(lane.word[form.code_bits :] for lane in coded).any()
            ),
        ]
        beat = Signal(sensor_beat_layout(form))
        valid, wrong, begun = Signal(), Signal(), Signal()
        m.d.sensor += valid.eq(0)
        with m.FSM(domain="sensor") as machine:
            with m.State("BETWEEN"):
                m.d.sensor += begun.eq(0)
                with m.If(known & locked & start.all()):
                    m.next = "FRAME"
            with m.State("FRAME"):
                with m.If(known & ~right):
                    m.d.comb += wrong.eq(1)
                    m.next = "BETWEEN"
                with m.Elif(known & flags[0]):
                    m.d.sensor += [
                        *(beat.codes[number].eq(lane.word) for number, lane in enumerate(coded)),
                        Cat(beat.first, beat.row, beat.last).eq(flags[1:]),
                    ]
                    with m.If(flags[3]):
                        m.next = "END"
                    with m.Else():
                        m.d.sensor += [valid.eq(1), begun.eq(1)]
            with m.State("END"):
                with m.If(known):
                    m.d.comb += wrong.eq(~training.all())
                    m.d.sensor += valid.eq(1)
                    m.next = "BETWEEN"
        with m.If(wrong):
            # right nowhere: neither as a frame's first beat nor as a later one
            m.d.sensor += [valid.eq(1), beat.first.eq(begun), beat.last.eq(1)]
        between = Signal()
        m.d.comb += between.eq(known & machine.ongoing("BETWEEN"))
        self._supervise(m, lanes, training, start, between & locked, between)
        return beat, valid

    def _supervise(
        self,
        m: Module,
        lanes: list[LaneAligner],
        training: Signal,
        start: Signal,
        compare: Value,
        between: Signal,
    ) -> None:
        """Delay lanes whose start word comes before others'; align lanes that are lost again."""
        delayed = Cat(lane.delayed for lane in lanes)
        apart, too_far = Signal(), Signal()
        m.d.comb += [
            apart.eq(compare & start.any() & ~start.all()),
            too_far.eq(apart & (start & delayed).any()),
        ]
        for number, lane in enumerate(lanes):
            lost, misses = Signal(), Signal(range(_LOST_WORDS), name=f"misses{number}")
            known_word = training[number] | start[number]
            m.d.comb += [
                lost.eq(between & ~known_word & (misses == _LOST_WORDS - 1)),
                lane.restart.eq(too_far | (lost & lane.locked)),
                lane.delay.eq(apart & start[number]),
            ]
            with m.If(between):
                m.d.sensor += misses.eq(Mux(known_word | lost, 0, misses + 1))
