# SPDX-License-Identifier: Apache-2.0
"""The camera without its link and pins: exposures, sensor, formatter, registers."""

from __future__ import annotations

from dataclasses import dataclass, field

from amaranth.hdl import Module, Mux, Signal, Value, signed
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from hueflight_protocol.camera_map import PIXEL_MASK_ADDRESS, camera_map
from hueflight_protocol.reduction_registers import ReductionRoom
from hueflight_protocol.registers import RegisterMap
from hueflight_protocol.wire import FrameFlags

from ..common.version import VERSION
from ..control.messages import request_stream, response_stream
from ..control.register_file import RegisterFile
from ..control.standard_block import UNKNOWN, add_control
from ..link.packet_word import WORD_LAYOUT
from .clock import camera_clock_members, connect_clock
from .counters import CaptureCounters
from .exposure.control import MARKER_BITS, ExposureControl
from .exposure.frame_guard import PATIENCE_CLOCKS, FrameGuard
from .formatter.formatter import FrameFormatter
from .formatter.pixel_mask import PixelMask
from .frame_format import FormatError, FrameFormat
from .messages import Messenger
from .readout import Readout, plain_readout, reduced_readout
from .reduction.message_merge import MessageMerge
from .reduction.reducer import PACKET_WORDS, Reducer, check_room
from .reduction.registers import connect_registers, lock_of
from .sensor.port import SensorPort
from .sensor.scene import Scene
from .sensor.synthetic import SyntheticSensor

_HAPPENED_LAYOUT = data.StructLayout(
    {
        **dict.fromkeys(
            ("began", "ended", "triggered", "missed", "dropped", "aborted", "fault", "over"), 1
        ),
        "stalled": 1,
        "frame": 64,
    }
)
"""Events that are counted and reported; see `Camera._note`."""


@dataclass(frozen=True)
class CameraConfig:
    """Configuration of a camera.

    Parameters
    ----------
    form : FrameFormat
        Geometry, code width, lanes, run length; its `clock_hz` is that of the domain `sync`.
    buffer_words : int
        Words of eight bytes between formatter and link, a power of two.
    admit_words : int
        A frame is admitted if the buffer has room for this many words when it begins. At
        `FrameFormat.max_packet_words`, no admitted frame is ever aborted for lack of room.
    sensor : bool
        True if a sensor is attached; otherwise there is only the synthetic one.
    overlap : bool
        True if the attached sensor keeps its codes during the next exposure.
    scene : Scene, optional
        Scene of the synthetic sensor.
    patience : int
        Clocks without a beat after which a readout is given up.
    reduction : ReductionRoom, optional
        What the reduction to sums has room for; by default there is none.
    sums_words : int
        Words of eight bytes in a packet of sums, at most; a power of two.
    serial : int
        Serial number of the board.
    source : int
        Hash of the sources; see `common.version.source_hash`.
    reference_hz : int
        Frequency of the external clock that the board can run from; 0 if it cannot.
    temperature : bool
        The board measures its temperature.

    Raises
    ------
    FormatError
        If the buffer is smaller than what is asked of it, the scene or the reduction does not fit,
        or there are fewer banks than an empty frame needs.
    """

    form: FrameFormat = field(default_factory=FrameFormat)
    buffer_words: int = 512
    admit_words: int = 64
    sensor: bool = False
    overlap: bool = True
    scene: Scene | None = None
    patience: int = PATIENCE_CLOCKS
    reduction: ReductionRoom | None = None
    sums_words: int = PACKET_WORDS
    serial: int = 0
    source: int = 0
    reference_hz: int = 0
    temperature: bool = False

    def __post_init__(self) -> None:
        if self.scene is not None:
            self.scene.check(self.form)
        if self.reduction is not None:
            check_room(self.form, self.reduction, packet_words=self.sums_words)
        form = self.form
        if form.banks < form.least_banks:
            raise FormatError(
                f"banks = {form.banks}: must be {form.least_banks} or more for runs of {form.run} "
                f"pixels in {form.lanes} lanes, or every frame without a pause is aborted; choose "
                "longer runs or more banks"
            )
        if not 3 <= self.admit_words <= self.buffer_words:
            raise FormatError(
                f"admit_words = {self.admit_words}: must be from 3 to buffer_words = "
                f"{self.buffer_words}"
            )

    def registers(self) -> RegisterMap:
        """Return the register map of this build."""
        form = self.form
        return camera_map(
            rows=form.rows,
            cols=form.cols,
            code_bits=form.code_bits,
            lanes=form.lanes,
            run=form.run,
            geometry=form.geometry,
            clock_hz=form.clock_hz,
            reduction=self.reduction,
            external_clock=bool(self.reference_hz),
            reference_hz=self.reference_hz,
        )


class Camera(wiring.Component):
    """The camera between the sensor port, the pins of the illuminator and the streams of a link.

    Members
    -------
    requests : In, responses : Out
        See `control.messages`.
    packets : Out(stream)
        See `WORD_LAYOUT`.
    sensor : Out(SensorPort)
        See `camera.sensor.port`.
    trigger, frame_sync : Out(1)
        To the illuminator.
    marker : In(16), missed : In(1)
        From the illuminator; need not be synchronous.
    reference_wanted : Out(1), reference_state : In
        Choice of the clock, as in `illuminator.illuminator.IlluminatorCore`; these and the next
        three are there only in builds with an external clock.
    clock_failed : In(1)
        The clocks are not valid, or have not been for long: they may have paused. It need not be
        synchronous. A capture that is on ends at once, as with the register's ``abort``.
    time_sync : In(1), time_sync_out : Out(1)
        Pins of `TimeSync`.
    temperature : In(signed(32))
        In millidegrees Celsius or `TEMPERATURE_UNKNOWN`, where the board measures it.
    """

    def __init__(self, config: CameraConfig) -> None:
        self.config = config
        form = config.form
        reduces = config.reduction is not None
        self._registers = RegisterFile(
            config.registers(),
            constants=self._constants(),
            windows=("pixel_mask",),
            lock_of=lock_of if reduces else None,
            locks=1 if reduces else 0,
        )
        self._exposure = ExposureControl(time_sync=bool(config.reference_hz))
        self._synthetic = SyntheticSensor(form, config.scene)
        self._guard = FrameGuard(form, patience=config.patience)
        self._formatter = FrameFormatter(form, buffer_words=config.buffer_words)
        self._mask = PixelMask(form)
        self._counters = CaptureCounters()
        self._messenger = Messenger()
        self._reducer: Reducer | None = None
        if config.reduction is not None:
            self._reducer = Reducer(
                form,
                config.reduction,
                patience=config.patience,
                packet_words=config.sums_words,
            )
        super().__init__(
            {
                "requests": In(request_stream()),
                "responses": Out(response_stream()),
                "packets": Out(stream.Signature(WORD_LAYOUT)),
                "sensor": Out(SensorPort(form)),
                "trigger": Out(1),
                "frame_sync": Out(1),
                "marker": In(MARKER_BITS),
                "missed": In(1),
                **(camera_clock_members() if config.reference_hz else {}),
                **({"temperature": In(signed(32))} if config.temperature else {}),
            }
        )

    def _constants(self) -> dict[str | tuple[str, tuple[int, ...]], int]:
        registers = self.config.registers()
        major, minor, patch = VERSION
        return {
            "versions": registers["versions"].encode(major=major, minor=minor, patch=patch),
            "serial": self.config.serial,
            "source": self.config.source,
            "features": registers["features"].encode(
                sensor=self.config.sensor,
                scene=self.config.scene is not None,
                overlap=self.config.overlap or not self.config.sensor,
                temperature=self.config.temperature,
                **({"external_clock": 1} if self.config.reference_hz else {}),
            ),
        }

    def elaborate(self, platform: object) -> Module:
        m = Module()
        temperature = self.temperature if self.config.temperature else UNKNOWN
        engine = add_control(m, self._registers, temperature=temperature)
        m.d.comb += self._messenger.temperature.eq(temperature)
        m.submodules.exposure = self._exposure
        m.submodules.synthetic = self._synthetic
        m.submodules.guard = self._guard
        m.submodules.formatter = self._formatter
        m.submodules.mask = self._mask
        m.submodules.counters = self._counters
        m.submodules.messenger = self._messenger
        connect(m, flipped(self.requests), engine.requests)
        connect(m, engine.responses, flipped(self.responses))
        connect(m, self._guard.beats, self._formatter.beats)
        if self._reducer is None:
            connect(m, self._messenger.o, self._formatter.messages)
        else:
            m.submodules.merge = merge = MessageMerge()
            connect(m, self._messenger.o, merge.first)
            connect(m, self._reducer.o, merge.second)
            connect(m, merge.o, self._formatter.messages)
        connect(m, self._formatter.o, flipped(self.packets))
        readout = plain_readout(self._exposure, self._guard, self._formatter)
        if self._reducer is not None:
            readout = reduced_readout(m, readout, self._reducer)
        self._exposures(m, readout)
        synthetic = self._sensors(m, readout)
        capture = self._capture(m)
        happened = self._note(m, readout)
        self._frames(m, synthetic, capture, readout)
        self._filters(m)
        self._count(m, happened, readout)
        self._messages(m, capture, happened, readout)
        self._status(m, happened, readout)
        if self._reducer is not None:
            self._reduce(m, self._reducer, capture)
        return m

    def _reduce(self, m: Module, reducer: Reducer, capture: Signal) -> None:
        """Add frames to sums, beside the formatter or instead of it."""
        exposure, registers = self._exposure, self._registers
        m.submodules.reducer = reducer
        m.submodules.reducer_mask = mask = PixelMask(self.config.form)
        connect_registers(m, registers, reducer)
        m.d.comb += [
            registers.locked.eq(exposure.running),
            reducer.began.eq(exposure.began),
            reducer.ended.eq(exposure.ended),
            reducer.read.eq(exposure.read),
            reducer.give_up.eq(exposure.give_up),
            reducer.sensor.valid.eq(self._guard.sensor.valid),
            reducer.sensor.payload.eq(self._guard.sensor.payload),
            reducer.filters.eq(self._formatter.filters),
            mask.write.eq(self._mask.write),
            mask.write_address.eq(self._mask.write_address),
            mask.write_word.eq(self._mask.write_word),
            mask.address.eq(reducer.mask_address),
            reducer.mask_data.eq(mask.word),
            reducer.about.flags.eq(self._formatter.info.flags),
            reducer.about.periods.eq(exposure.periods),
            reducer.capture.eq(capture),
            reducer.now.eq(exposure.now),
        ]

    def _exposures(self, m: Module, readout: Readout) -> None:
        registers, exposure, guard = self._registers, self._exposure, self._guard
        settings = exposure.settings
        abort: Value = registers.run.abort
        if self.config.reference_hz:
            abort = abort | connect_clock(m, self, registers, exposure)
        m.d.comb += [
            settings.period.eq(registers.period.value),
            settings.periods.eq(registers.exposure.value),
            settings.gap.eq(registers.gap.value),
            settings.frame_limit.eq(registers.frame_limit.value),
            settings.trigger_width.eq(registers.trigger.width),
            settings.trigger_inverted.eq(registers.trigger.inverted),
            settings.trigger_always.eq(registers.trigger.always),
            settings.sync_width.eq(registers.trigger.sync_width),
            settings.overlap.eq(
                registers.readout.overlap & (self.config.overlap or not self.config.sensor)
            ),
            exposure.start.eq(registers.run.start),
            exposure.stop.eq(registers.run.stop),
            exposure.abort.eq(abort),
            exposure.marker_pins.eq(self.marker),
            exposure.missed_pin.eq(self.missed),
            exposure.read_done.eq(readout.over),
            guard.read.eq(readout.read),
            guard.give_up.eq(exposure.give_up),
            self.trigger.eq(exposure.trigger),
            self.frame_sync.eq(exposure.frame_sync),
        ]

    def _sensors(self, m: Module, readout: Readout) -> Signal:
        """Connect one of the two sensors; return whether it is the synthetic one."""
        registers, exposure, guard = self._registers, self._exposure, self._guard
        settings, inner, outer = self._synthetic.settings, self._synthetic.port, self.sensor
        chosen = Signal()
        # one sensor from the exposure to the end of its readout
        with m.If(~exposure.exposing & ~exposure.read & ~readout.busy):
            m.d.sync += chosen.eq(registers.synthetic.enable | (not self.config.sensor))
        # a clock later: far from all else, and clocks before the first readout
        m.d.sync += self._synthetic.began.eq(exposure.began)
        m.d.comb += [
            settings.source.eq(registers.synthetic.source),
            settings.occupancy.eq(registers.synthetic.occupancy),
            settings.seed.eq(registers.synthetic_seed.value),
            settings.delay_start.eq(registers.synthetic_delay.start),
            settings.delay_step.eq(registers.synthetic_delay.step),
            inner.expose.eq(exposure.expose & chosen),
            inner.read.eq(exposure.read & chosen),
            outer.expose.eq(exposure.expose & ~chosen),
            outer.read.eq(exposure.read & ~chosen),
            guard.sensor.valid.eq(Mux(chosen, inner.beats.valid, outer.beats.valid)),
            guard.sensor.payload.eq(Mux(chosen, inner.beats.payload, outer.beats.payload)),
        ]
        return chosen

    def _capture(self, m: Module) -> Signal:
        """Return the label of the capture, as it was when the capture began."""
        capture = Signal.like(self._registers.capture.value)
        with m.If(self._exposure.began):
            m.d.sync += capture.eq(self._registers.capture.value)
        return capture

    def _frames(self, m: Module, synthetic: Signal, capture: Signal, readout: Readout) -> None:
        """Admission, and what a frame's header says."""
        exposure, guard, formatter = self._exposure, self._guard, self._formatter
        dropped = self._counters.counters.frames_dropped
        info = formatter.info
        missed = Signal()  # a trigger, since the frame before
        begun, just_missed = Signal(), Signal()  # a clock ago: `begins` has come a long way
        m.d.sync += [
            begun.eq(readout.begins | exposure.began),
            just_missed.eq(exposure.missed),
        ]
        with m.If(exposure.missed):
            m.d.sync += missed.eq(1)
        with m.Elif(begun):
            m.d.sync += missed.eq(just_missed)
        m.d.sync += guard.admit.eq(
            (formatter.room >= self.config.admit_words)
            & (formatter.banks_free >= self.config.form.burst_banks)
        )
        m.d.comb += [
            guard.ends.eq(formatter.ends),
            formatter.abort.eq(guard.abort),
            info.timestamp.eq(exposure.timestamp),
            info.frame.eq(exposure.frame),
            info.periods.eq(exposure.periods),
            info.dropped.eq(dropped),
            info.step.eq(exposure.step),
            info.capture.eq(capture),
            info.flags.eq(
                Mux(synthetic, FrameFlags.TEST_PATTERN.value, 0)
                | Mux(missed, FrameFlags.TRIGGER_LOST.value, 0)
                | Mux(dropped.all(), FrameFlags.SATURATED.value, 0)
            ),
        ]

    def _filters(self, m: Module) -> None:
        registers, filters, mask = self._registers, self._formatter.filters, self._mask
        offset = PIXEL_MASK_ADDRESS.bit_length() - 1
        m.d.comb += [
            filters.mask.eq(registers.filters.mask),
            filters.roi.eq(registers.filters.roi),
            filters.gate.eq(registers.filters.gate),
            filters.rows.eq(registers.roi_rows),
            filters.cols.eq(registers.roi_cols),
            filters.codes.eq(registers.gate),
            mask.write.eq(registers.written & registers.written_address[offset]),
            mask.write_address.eq(registers.written_address),
            mask.write_word.eq(registers.written_word),
            mask.host_address.eq(registers.address),
            registers.pixel_mask_word.eq(mask.host_word),
            mask.address.eq(self._formatter.mask_address),
            self._formatter.mask_data.eq(mask.word),
        ]

    def _note(self, m: Module, readout: Readout) -> data.View:
        """Return the events of the previous clock.

        Counters and reports all use these, one clock late and in step, so that wide counters are
        not on the timing paths of decisions about a frame.
        """
        exposure = self._exposure
        happened = Signal(_HAPPENED_LAYOUT)
        m.d.sync += [
            happened.began.eq(exposure.began),
            happened.ended.eq(exposure.ended),
            happened.triggered.eq(exposure.triggered & exposure.running),
            happened.missed.eq(exposure.missed & exposure.running),
            happened.dropped.eq(readout.dropped),
            happened.aborted.eq(readout.aborted),
            happened.fault.eq(readout.fault),
            happened.over.eq(readout.over),
            happened.stalled.eq(self.packets.valid & ~self.packets.ready),
            happened.frame.eq(exposure.frame),
        ]
        return happened

    def _count(self, m: Module, happened: data.View, readout: Readout) -> None:
        formatter, counters = self._formatter, self._counters
        m.d.comb += [
            counters.began.eq(happened.began),
            counters.frames_dropped.eq(happened.dropped),
            counters.frames_aborted.eq(happened.aborted),
            counters.triggers_lost.eq(happened.missed),
            counters.stall_clocks.eq(happened.stalled),
            counters.faults.eq(happened.fault),
            counters.sent.eq(readout.sent),
            counters.hits.eq(readout.hits),
            counters.triggered.eq(happened.triggered),
            counters.waiting.eq((self.config.buffer_words - formatter.room) << 3),
            counters.frame.eq(happened.frame),
        ]

    def _messages(self, m: Module, capture: Signal, happened: data.View, readout: Readout) -> None:
        registers, exposure = self._registers, self._exposure
        counters, messenger = self._counters, self._messenger
        # what ends a capture is said when its last frame has been sent
        ending = Signal()
        settled, ready = Signal(), Signal()
        ends = exposure.ended | happened.ended | ending
        m.d.sync += ready.eq(messenger.idle & ~ends)
        all_sent = ending & ~self._formatter.in_frame & ~self._formatter.sending
        if readout.sums_wait is not None:
            all_sent &= ~readout.sums_wait
        m.d.comb += settled.eq(all_sent)
        with m.If(happened.ended):
            m.d.sync += ending.eq(1)
        with m.Elif(settled):
            m.d.sync += ending.eq(0)

        interval = registers.status_interval.value
        frames = Signal(32)  # since the last status
        due = Signal()
        m.d.comb += due.eq(happened.over & (frames + 1 >= interval))
        with m.If(happened.began | due):
            m.d.sync += frames.eq(0)
        with m.Elif(happened.over):
            m.d.sync += frames.eq(frames + 1)

        m.d.comb += [
            exposure.ready.eq(ready),
            messenger.started.eq(happened.began),
            messenger.overflow.eq(happened.dropped | happened.aborted),
            messenger.trigger_lost.eq(happened.missed),
            messenger.fault.eq(happened.fault),
            messenger.stopped.eq(settled),
            messenger.status.eq((due | settled) & (interval != 0)),
            messenger.test.eq(registers.test_send.value),
            messenger.capture.eq(capture),
            messenger.now.eq(exposure.now),
            messenger.counters.eq(counters.counters),
            messenger.pattern.eq(registers.test_packet.pattern),
            messenger.words.eq(registers.test_packet.words),
            messenger.seed.eq(registers.test_seed.value),
        ]

    def _status(self, m: Module, happened: data.View, readout: Readout) -> None:
        registers, exposure = self._registers, self._exposure
        formatter, counters = self._formatter, self._counters
        counted = counters.counters
        sending = formatter.sending | formatter.in_frame
        if readout.sums_wait is not None:
            sending |= readout.sums_wait
        m.d.comb += [
            registers.state.running.eq(exposure.running),
            registers.state.stopping.eq(exposure.stopping),
            registers.state.exposing.eq(exposure.exposing),
            registers.state.sending.eq(sending),
            registers.state.stalled.eq(happened.stalled),
            registers.faults_set.dropped.eq(happened.dropped),
            registers.faults_set.aborted.eq(happened.aborted),
            registers.faults_set.trigger_lost.eq(happened.missed),
            registers.faults_set.sensor.eq(happened.fault),
            registers.faults_set.saturated.eq(counters.saturated),
            registers.timestamp.value.eq(exposure.now),
            registers.frame.value.eq(counted.frame),
            registers.frames_sent.value.eq(counted.frames_sent),
            registers.hits.value.eq(counters.hits_sent),
            registers.periods.value.eq(counters.periods),
            registers.frames_dropped.value.eq(counted.frames_dropped),
            registers.frames_aborted.value.eq(counted.frames_aborted),
            registers.triggers_lost.value.eq(counted.triggers_lost),
            registers.stall_clocks.value.eq(counted.stall_clocks),
            registers.buffer_peak.value.eq(counted.buffer_peak),
            registers.sequence.value.eq(formatter.sequence),
            registers.marker.value.eq(exposure.marker),
        ]
