# SPDX-License-Identifier: Apache-2.0
"""Exposure control: triggers for the illuminator, frame sync, and readout requests."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

MARKER_BITS = 16

EXPOSURE_LAYOUT = data.StructLayout(
    {
        "period": 16,  # clocks; 0 as 1
        "periods": 32,  # of an exposure; 0 reads out at once
        "gap": 32,  # clocks from the end of the readout to the exposure
        "frame_limit": 32,  # 0 = until stopped
        "trigger_width": 8,  # clocks; 0 = no triggers
        "trigger_inverted": 1,
        "trigger_always": 1,  # between exposures too
        "sync_width": 8,  # clocks
        "overlap": 1,  # the next exposure does not wait for the readout; the gap is from its begin
    }
)
"""Settings; those of time are taken over when an exposure begins."""


class ExposureControl(wiring.Component):
    """Runs captures: sequences of exposure, readout and gap.

    With a sensor that keeps its codes while it exposes, readouts may overlap exposures: after
    an exposure its readout begins, or waits for the one before to be over, and the next
    exposure follows at once.

    A trigger begins each period of an exposure. The frame sync begins with the first one and
    makes the illuminator take its next step; the step marker is sampled when the exposure ends.

    Parameters
    ----------
    time_sync : bool
        The device clock can be set to 0.

    Members
    -------
    settings : In
        See `EXPOSURE_LAYOUT`.
    start, stop, abort : In(1)
        Begin a capture, ending at once one that is on; end it after the present frame; end it
        at once. What has not begun yet is not begun after a stop or an abort.
    ready : In(1)
        A capture may begin: what is to be said of the one before has been said.
    trigger, frame_sync : Out(1)
        To the illuminator.
    marker_pins : In(16), missed_pin : In(1)
        From the illuminator, not synchronous: step marker; a trigger was missed (rising edge).
    expose, read : Out(1)
        To the sensor.
    read_done : In(1)
        The readout has ended, whether the frame was passed or not.
    give_up : Out(1)
        The readout is to be ended early.
    starting : Out(1)
        A start waits for the capture before to end, and for `ready`.
    running, stopping, exposing : Out(1)
        State.
    began, ended : Out(1)
        A capture begins: counters start at 0; or ended.
    triggered, missed : Out(1)
        A trigger was sent; the illuminator missed one.
    frame : Out(64)
        Number of the present frame in the capture; after its end, the number of its frames.
    now : Out(64)
        Device clock.
    zero : In(1)
        It is 0 in the next clock; only with `time_sync`.
    timestamp, periods, step : Out
        Of the exposure that is read.
    marker : Out(16)
        On the pins now.
    """

    def __init__(self, *, time_sync: bool = False) -> None:
        self.time_sync = time_sync
        super().__init__(
            {
                "settings": In(EXPOSURE_LAYOUT),
                "start": In(1),
                "stop": In(1),
                "abort": In(1),
                "ready": In(1),
                "trigger": Out(1),
                "frame_sync": Out(1),
                "marker_pins": In(MARKER_BITS),
                "missed_pin": In(1),
                "expose": Out(1),
                "read": Out(1),
                "read_done": In(1),
                "give_up": Out(1),
                "starting": Out(1),
                "running": Out(1),
                "stopping": Out(1),
                "exposing": Out(1),
                "began": Out(1),
                "ended": Out(1),
                "triggered": Out(1),
                "missed": Out(1),
                "frame": Out(64),
                "now": Out(64),
                **({"zero": In(1)} if time_sync else {}),
                "timestamp": Out(64),
                "periods": Out(32),
                "step": Out(MARKER_BITS),
                "marker": Out(MARKER_BITS),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        settings = self.settings
        following: Value = self.now + 1
        if self.time_sync:
            following = Mux(self.zero, 0, following)
        m.d.sync += self.now.eq(following)
        self._inputs(m)

        # periods follow each other without end; an exposure begins with one
        clock = Signal(16)
        last = Signal(16)  # clock of a period
        period_ends = Signal()
        restart = Signal()
        m.d.sync += last.eq(Mux(settings.period == 0, 0, settings.period - 1))
        m.d.comb += period_ends.eq(clock >= last)
        m.d.sync += clock.eq(Mux(period_ends | restart, 0, clock + 1))
        begins = Signal()  # this is the first clock of a period
        m.d.sync += begins.eq(period_ends | restart)

        left = Signal(32)  # periods
        gap = Signal(32)
        limited, frames_left = Signal(), Signal(32)
        no_more = Signal()  # exposures in this capture
        starting = self.starting
        with m.If(self.start):
            m.d.sync += starting.eq(1)
        with m.Elif(self.stop | self.abort):
            m.d.sync += starting.eq(0)
        with m.If(self.stop):
            m.d.sync += self.stopping.eq(1)
        cut, aborting = Signal(), Signal()  # end at once
        m.d.comb += cut.eq(self.abort | aborting | starting)
        with m.If(self.abort):
            m.d.sync += aborting.eq(1)

        reading, read_out = Signal(), Signal()  # read_out: nothing is left to be read
        m.d.comb += read_out.eq(~reading | self.read_done)
        with m.If(reading & self.read_done):
            m.d.sync += [reading.eq(0), self.frame.eq(self.frame + 1)]
        timestamp, periods, step = (
            Signal.like(told, name=f"next_{told.name}")
            for told in (self.timestamp, self.periods, self.step)
        )  # of the present exposure

        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += [self.stopping.eq(0), aborting.eq(0)]
                with m.If(starting & self.ready & ~self.stop & ~self.abort):
                    m.d.comb += self.began.eq(1)
                    m.d.sync += [
                        starting.eq(0),
                        self.running.eq(1),
                        self.frame.eq(0),
                        no_more.eq(0),
                        limited.eq(settings.frame_limit != 0),
                        frames_left.eq(settings.frame_limit),
                    ]
                    m.next = "ALIGN"
            with m.State("ALIGN"):
                # settings are those of this clock; a free-running period is waited for
                m.d.comb += restart.eq(~settings.trigger_always)
                with m.If(cut | self.stopping):
                    m.next = "SETTLE"
                with m.Elif(restart | period_ends):
                    m.d.sync += [
                        left.eq(settings.periods),
                        periods.eq(settings.periods),
                        timestamp.eq(following),
                        self.exposing.eq(settings.periods != 0),
                    ]
                    m.next = "EXPOSE"
            with m.State("EXPOSE"):
                with m.If(cut):
                    m.d.sync += self.exposing.eq(0)
                    m.next = "SETTLE"
                with m.Elif(~self.exposing | (period_ends & (left == 1))):
                    m.d.sync += [self.exposing.eq(0), step.eq(self.marker)]
                    m.next = "READ"
                with m.Elif(period_ends):
                    m.d.sync += left.eq(left - 1)
            with m.State("READ"):
                m.d.comb += self.read.eq(~reading)
                with m.If(~reading):
                    m.d.sync += [
                        reading.eq(1),
                        self.timestamp.eq(timestamp),
                        self.periods.eq(periods),
                        self.step.eq(step),
                        frames_left.eq(frames_left - 1),
                        no_more.eq(limited & (frames_left == 1)),
                        gap.eq(settings.gap),
                    ]
                    m.next = "WAIT"
                    with m.If(settings.overlap):
                        m.next = "GAP"
                with m.Elif(cut):
                    m.next = "SETTLE"
            with m.State("WAIT"):
                m.d.comb += self.give_up.eq(cut)
                with m.If(read_out):
                    m.d.sync += gap.eq(settings.gap)
                    m.next = "GAP"
                    with m.If(cut | self.stopping | no_more):
                        m.next = "END"
            with m.State("GAP"):
                m.d.sync += gap.eq(gap - 1)
                with m.If(cut | self.stopping | no_more):
                    m.next = "SETTLE"
                with m.Elif(gap <= 1):
                    m.next = "ALIGN"
            with m.State("SETTLE"):
                m.d.comb += self.give_up.eq(cut & reading)
                with m.If(read_out):
                    m.next = "END"
            with m.State("END"):
                m.d.comb += self.ended.eq(1)
                m.d.sync += self.running.eq(0)
                m.next = "IDLE"

        m.d.comb += self.expose.eq(self.exposing)
        self._outputs(m, begins)
        return m

    def _inputs(self, m: Module) -> None:
        """Synchronise the illuminator's pins; the marker counts once it stands still."""
        seen = Signal(MARKER_BITS)
        before = Signal(MARKER_BITS)
        m.submodules.marker_sync = FFSynchronizer(self.marker_pins, seen)
        m.d.sync += before.eq(seen)
        with m.If(seen == before):
            m.d.sync += self.marker.eq(seen)
        missed, missed_before = Signal(), Signal()
        m.submodules.missed_sync = FFSynchronizer(self.missed_pin, missed)
        m.d.sync += missed_before.eq(missed)
        m.d.comb += self.missed.eq(missed & ~missed_before)

    def _outputs(self, m: Module, begins: Signal) -> None:
        """Make pulses of the set width where periods and exposures begin."""
        settings = self.settings
        trigger_left, sync_left = Signal(8), Signal(8)
        exposing_before = Signal()
        m.d.sync += exposing_before.eq(self.exposing)
        m.d.comb += self.triggered.eq(begins & (self.exposing | settings.trigger_always))
        for left, width, fires in (
            (trigger_left, settings.trigger_width, self.triggered),
            (sync_left, settings.sync_width, self.exposing & ~exposing_before),
        ):
            with m.If(fires):
                m.d.sync += left.eq(width)
            with m.Elif(left != 0):
                m.d.sync += left.eq(left - 1)
        # from registers, without glitches
        m.d.sync += [
            self.trigger.eq((trigger_left != 0) ^ settings.trigger_inverted),
            self.frame_sync.eq(sync_left != 0),
        ]
