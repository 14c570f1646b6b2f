# SPDX-License-Identifier: Apache-2.0
"""The pulse generator: everything in the fast clock domain `pulse`."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out
from amaranth.utils import bits_for

from hueflight_protocol.illuminator_map import MAX_FILTER_TICKS, TriggerSource

from ...common.fast_counter import FastCounter
from .channel import Channel
from .config import MIN_SPACING, Limits, PulseConfig
from .phases import PhaseStatistics
from .program import WORDS_PER_STEP, ProgramReader
from .sequencer import Sequencer
from .slot import PulseSlot
from .train import Train
from .trigger import ExternalTrigger, InternalTrigger
from .trigger_filter import TriggerFilter, filter_latency

COUNTERS = ("seen", "served", "ignored", "restarts", "swaps")

MISSED_CLOCKS = 16

LIVE_LAYOUT = data.StructLayout(
    {
        "source": TriggerSource,
        "restart": 1,
        "falling": 1,
        "output": 1,
        "period": 16,
        "out_delay": 12,
        "out_width": 12,
        "filter": bits_for(MAX_FILTER_TICKS),
        "bank": 1,
        "by_frame": 1,
        "loop": 1,
        "length": 8,
    }
)
"""Settings that may change while trains run."""

STROBE_LAYOUT = data.StructLayout(
    dict.fromkeys(
        ("start", "stop", "frame", "trigger", "clear_counters", "clear_phase", "snapshot"), 1
    )
)
"""Commands of the host, high for one clock."""


def status_layout(config: PulseConfig) -> data.StructLayout:
    """Return the layout of the status that the host can read, all from the same clock."""
    return data.StructLayout(
        {
            **dict.fromkeys(COUNTERS, 32),
            "phase_last": config.lane_bits,
            "phase_min": config.lane_bits,
            "phase_max": config.lane_bits,
            "phase_valid": 1,
            "phase_count": data.ArrayLayout(32, config.lanes),
            "busy": 1,
            "bank": 1,
            "running": 1,
            "step": 8,
            "left": 32,
            "idle_left": 32,
            "marker": 8,
            "trigger_level": 1,
            "saturated": 1,
            # since the last snapshot
            "on_limited": config.channels,
            "duty_limited": config.channels,
            "trigger_ignored": 1,
        }
    )


class PulseGenerator(wiring.Component):
    """Generates a train of LED pulses for each served trigger.

    A pulse begins `latency_ticks` plus its delay after the tick of the trigger; with a filter for
    the trigger, `filter_clocks` later.

    Members
    -------
    samples : In(lanes)
        Of the trigger input.
    frame_sync : In(1)
        From the camera, asynchronous; a rising edge counts.
    banks : In
        Schedules; each must be at rest while it may be used.
    live : In
        See `LIVE_LAYOUT`.
    strobes : In
        See `STROBE_LAYOUT`.
    armed : In(1)
    program_write : In(1), program_address : In, program_word : In
        See `ProgramReader`; in the clock domain `sync`.
    levels : Out
        For each channel, `lanes` ticks.
    trigger_out : Out(lanes)
    marker : Out(8)
        Of the running train.
    missed : Out(1)
        A trigger was ignored; lasts `MISSED_CLOCKS`, for a camera with a slower clock.
    lit : Out(1)
        Armed, as the outputs see it: in its clock the levels may be on.
    bank, running : Out(1)
        Of the present train and of the sequencer; at once, not a snapshot.
    status : Out
        See `status_layout`; at the last snapshot.
    """

    latency = ExternalTrigger.latency + 1 + Train.latency + Channel.latency
    choice_latency = ExternalTrigger.latency + 1
    """Clocks from a trigger's sample until its train takes over what `live` says."""
    armed_latency = 2
    """Clocks from `armed` to the levels."""

    def __init__(self, config: PulseConfig, *, memory_style: str | None = None) -> None:
        self.config = config
        self.memory_style = memory_style
        super().__init__(
            {
                "samples": In(config.lanes),
                "frame_sync": In(1),
                "banks": In(data.ArrayLayout(config.bank_layout, 2)),
                "live": In(LIVE_LAYOUT),
                "strobes": In(STROBE_LAYOUT),
                "armed": In(1),
                "program_write": In(1),
                "program_address": In(range(config.steps * WORDS_PER_STEP)),
                "program_word": In(32),
                "levels": Out(data.ArrayLayout(config.lanes, config.channels)),
                "trigger_out": Out(config.lanes),
                "marker": Out(8),
                "missed": Out(1),
                "lit": Out(1),
                "bank": Out(1),
                "running": Out(1),
                "status": Out(status_layout(config)),
            }
        )

    @property
    def latency_ticks(self) -> int:
        """Ticks from a trigger sample to the first tick of a pulse without delay."""
        return self.latency * self.config.lanes

    @staticmethod
    def filter_clocks(config: PulseConfig, /) -> int:
        """Return the clocks by which the filter makes all trains later, whatever its width."""
        return filter_latency(config.lanes) - 1

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.train = train = Train(self.config)
        m.submodules.sequencer = sequencer = Sequencer(self.config)
        external_served, trigger_level = self._trigger(m, train)
        self._program(m, train, sequencer)
        on_limited, duty_limited = self._channels(m, train)
        self._trigger_out(m, train)
        missed_before = Signal(MISSED_CLOCKS)
        m.d.pulse += [
            missed_before.eq(Cat(train.ignored, missed_before)),
            self.missed.eq(missed_before.any()),
            self.marker.eq(train.marker_out),
            self.bank.eq(train.train.bank),
            self.running.eq(sequencer.running),
        ]

        now = Signal(status_layout(self.config))
        self._statistics(m, train, external_served, now)
        busy = Signal()  # kept from the train's own, which a snapshot would draw away from it
        m.d.pulse += busy.eq(train.busy)
        m.d.comb += [
            now.busy.eq(busy),
            now.bank.eq(self.bank),
            now.running.eq(sequencer.running),
            now.step.eq(sequencer.number),
            now.left.eq(sequencer.left),
            now.idle_left.eq(sequencer.idle_left),
            now.marker.eq(self.marker),
            now.trigger_level.eq(trigger_level),
        ]
        # events since the last snapshot; one that happens in its very clock is kept for the next
        events = {
            "on_limited": on_limited,
            "duty_limited": duty_limited,
            "trigger_ignored": train.ignored,
        }
        for name, event in events.items():
            held = Signal.like(now[name], name=f"{name}_held")
            m.d.pulse += held.eq(Mux(self.strobes.snapshot, 0, held) | event)
            m.d.comb += now[name].eq(held)
        with m.If(self.strobes.snapshot):
            m.d.pulse += self.status.eq(now)
        return m

    def _trigger(self, m: Module, train: Train) -> tuple[Signal, Signal]:
        """Connect the chosen source; return when an external trigger was served, and its level."""
        m.submodules.external = external = ExternalTrigger(self.config)
        m.submodules.internal = internal = InternalTrigger(self.config)
        m.submodules.filter = filtered = TriggerFilter(self.config)
        source = self.live.source
        is_external = Signal()
        is_direct = Signal()
        is_filtered = Signal()
        is_internal = Signal()
        is_software = Signal()
        m.d.pulse += [
            is_external.eq(source == TriggerSource.EXTERNAL),
            is_direct.eq((source == TriggerSource.EXTERNAL) & (self.live.filter == 0)),
            is_filtered.eq((source == TriggerSource.EXTERNAL) & (self.live.filter != 0)),
            is_internal.eq(source == TriggerSource.INTERNAL),
            is_software.eq(source == TriggerSource.SOFTWARE),
        ]
        m.d.comb += [
            external.samples.eq(self.samples),
            external.falling.eq(self.live.falling),
            filtered.samples.eq(external.samples_out),
            filtered.before.eq(external.before_out),
            filtered.falling.eq(self.live.falling),
            filtered.width.eq(self.live.filter),
            internal.enable.eq(is_internal),
            internal.period.eq(self.live.period),
            train.restart.eq(self.live.restart),
            *(train.periods[bank].eq(self.banks[bank].period) for bank in range(2)),
        ]
        m.d.pulse += [
            train.edge.eq(
                (external.edge & is_direct)
                | (filtered.edge & is_filtered)
                | (internal.edge & is_internal)
                | (self.strobes.trigger & is_software)
            ),
            train.lane.eq(
                Mux(is_direct, external.lane, 0)
                | Mux(is_filtered, filtered.lane, 0)
                | Mux(is_internal, internal.lane, 0)
            ),
        ]
        served = Signal()  # one clock after `train.served`, with the train's phase
        m.d.pulse += served.eq(train.served & is_external)
        return served, external.level

    def _program(self, m: Module, train: Train, sequencer: Sequencer) -> None:
        m.submodules.reader = reader = ProgramReader(self.config, memory_style=self.memory_style)
        frame_sync = Signal()
        m.submodules.frame_sync = FFSynchronizer(
            self.frame_sync, frame_sync, o_domain="pulse", init=1
        )
        frame_before = Signal(init=1)
        frame = Signal()
        quiet = Signal(range(MIN_SPACING))
        edge = Signal()
        m.d.comb += edge.eq(((frame_sync & ~frame_before) | self.strobes.frame) & (quiet == 0))
        m.d.pulse += [
            frame_before.eq(frame_sync),
            frame.eq(edge),
            quiet.eq(Mux(edge, MIN_SPACING - 1, Mux(quiet == 0, 0, quiet - 1))),
        ]
        m.d.comb += [
            reader.write.eq(self.program_write),
            reader.address.eq(self.program_address),
            reader.word.eq(self.program_word),
            reader.length.eq(self.live.length),
            reader.loop.eq(self.live.loop),
            reader.rewind.eq(sequencer.rewind),
            reader.take.eq(sequencer.take),
            sequencer.step.eq(reader.step),
            sequencer.ready.eq(reader.ready),
            sequencer.finished.eq(reader.finished),
            sequencer.start.eq(self.strobes.start),
            sequencer.stop.eq(self.strobes.stop),
            sequencer.by_frame.eq(self.live.by_frame),
            sequencer.frame.eq(frame),
            sequencer.served.eq(train.served),
            sequencer.manual_bank.eq(self.live.bank),
            train.bank.eq(sequencer.bank),
            train.mask.eq(sequencer.mask),
            train.marker.eq(sequencer.marker),
        ]

    def _channels(self, m: Module, train: Train) -> tuple[Signal, Signal]:
        on_limited = Signal(self.config.channels)
        duty_limited = Signal(self.config.channels)
        lit = Signal()
        m.d.pulse += [lit.eq(self.armed), self.lit.eq(lit)]
        for index in range(self.config.channels):
            channel = Channel(self.config, index)
            m.submodules[f"channel{index}"] = channel
            armed = Signal(name=f"armed{index}")
            m.d.pulse += armed.eq(self.armed)
            m.d.comb += [
                channel.train.eq(train.train),
                channel.selected.eq(train.mask_out[index]),
                *(channel.enable[bank].eq(self.banks[bank].enable[index]) for bank in range(2)),
                *(channel.pulses[bank].eq(self.banks[bank].pulses[index]) for bank in range(2)),
                channel.armed.eq(armed),
                self.levels[index].eq(channel.level),
                on_limited[index].eq(channel.on_limited),
                duty_limited[index].eq(channel.duty_limited),
            ]
        return on_limited, duty_limited

    def _trigger_out(self, m: Module, train: Train) -> None:
        """Generate the trigger output: a pulse with the latency of an LED, without limits."""
        unlimited = PulseConfig(
            channels=1, pulses=1, lanes=self.config.lanes, limits=Limits(max_on_ticks=4094)
        )
        m.submodules.trigger_out = slot = PulseSlot(unlimited)
        m.d.comb += [
            slot.train.eq(train.train),
            slot.lit.eq(self.live.output),
            *(slot.settings[bank].delay.eq(self.live.out_delay) for bank in range(2)),
            *(slot.settings[bank].width.eq(self.live.out_width) for bank in range(2)),
        ]
        level = slot.level
        for stage in range(Channel.latency - PulseSlot.latency):
            later = Signal(self.config.lanes, name=f"trigger_out{stage}")
            m.d.pulse += later.eq(level)
            level = later
        m.d.comb += self.trigger_out.eq(level)

    def _statistics(self, m: Module, train: Train, external_served: Signal, now: data.View) -> None:
        seen = Signal()
        m.d.comb += seen.eq(train.served | train.ignored)
        events = (seen, train.served, train.ignored, train.restarted, train.swapped)
        full = Signal(len(COUNTERS))
        for number, (name, event) in enumerate(zip(COUNTERS, events, strict=True)):
            counter = FastCounter()
            m.submodules[name] = counter
            m.d.comb += [
                counter.event.eq(event),
                counter.clear.eq(self.strobes.clear_counters),
                now[name].eq(counter.value),
                full[number].eq(counter.saturated),
            ]
        m.submodules.phases = phases = PhaseStatistics(self.config)
        m.d.comb += [
            phases.event.eq(external_served),
            phases.lane.eq(train.train.phase),
            phases.clear.eq(self.strobes.clear_phase),
            now.phase_last.eq(phases.last),
            now.phase_min.eq(phases.smallest),
            now.phase_max.eq(phases.largest),
            now.phase_valid.eq(phases.valid),
            *(now.phase_count[i].eq(phases.counts[i]) for i in range(self.config.lanes)),
            now.saturated.eq(full.any() | phases.saturated),
        ]
