# SPDX-License-Identifier: Apache-2.0
"""The illuminator without its pins: pulse generator, arming, registers and serial link."""

from __future__ import annotations

from dataclasses import dataclass, field

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out, connect, flipped

from hueflight_protocol.illuminator_map import Advance, Retrigger, illuminator_map
from hueflight_protocol.registers import Register, RegisterMap

from ..common.crossing import SettingsCrossing
from ..common.version import VERSION
from ..control.clock_choice import clock_members, connect_clock_choice, count_clock_failures
from ..control.messages import request_stream, response_stream
from ..control.register_file import RegisterFile
from ..control.standard_block import add_control
from ..link.serial import SerialLink
from .arming import Arming
from .fine_delays import FineDelays
from .pulse_generator.config import ConfigError, PulseConfig
from .pulse_generator.generator import COUNTERS, LIVE_LAYOUT, STROBE_LAYOUT, PulseGenerator
from .pulse_generator.schedule_store import ScheduleStore

_STEP_REGISTERS = ("step_setup", "step_mask", "step_count", "step_idle")
_PROGRAM_LOCK = 2  # 0 and 1 are those of the banks
_FINE_LOCK = 3


@dataclass(frozen=True)
class IlluminatorConfig:
    """Configuration of an illuminator.

    Parameters
    ----------
    pulse : PulseConfig
        Configuration of the pulse generator.
    pulse_hz : float
        Frequency of the domain `pulse`; a tick is ``1 / (pulse_hz * lanes)``.
    clock_ratio : int
        Clocks of `pulse` in one clock of `sync`.
    baud : float
        Rate of the serial line.
    serial : int
        Serial number of the board.
    source : int
        Hash of the sources; see `common.version.source_hash`.
    clock_supervision : bool
        Failures of the clock are detected by the board, see `IlluminatorCore`; otherwise
        ``clock_failed`` is ignored.
    memory_style : str, optional
        ``ram_style`` of the sequencer's memory, where synthesis would choose another kind than the
        family needs.
    reference_hz : int
        Frequency of the external clock that the board can run from; 0 if it cannot.
    fine_steps : int
        Settings of the fine delay line that the board's gearing has for each channel; 0 if it has
        none.
    temperature : bool
        The board measures its temperature.
    """

    pulse: PulseConfig = field(default_factory=PulseConfig)
    pulse_hz: float = 200e6
    clock_ratio: int = 2
    baud: float = 3e6
    serial: int = 0
    source: int = 0
    clock_supervision: bool = True
    memory_style: str | None = None
    reference_hz: int = 0
    fine_steps: int = 0
    temperature: bool = False

    def __post_init__(self) -> None:
        if self.clock_ratio < 1:
            raise ConfigError(f"clock_ratio = {self.clock_ratio}: must be 1 or more")

    @property
    def sync_hz(self) -> float:
        """Clock of the domain `sync`."""
        return self.pulse_hz / self.clock_ratio

    @property
    def tick_fs(self) -> int:
        """Length of a tick in femtoseconds."""
        return round(1e15 / (self.pulse_hz * self.pulse.lanes))

    def registers(self) -> RegisterMap:
        """Return the register map of this build."""
        return illuminator_map(
            channels=self.pulse.channels,
            pulses=self.pulse.pulses,
            steps=self.pulse.steps,
            lanes=self.pulse.lanes,
            tick_fs=self.tick_fs,
            clock_hz=round(self.pulse_hz),
            external_clock=bool(self.reference_hz),
            reference_hz=self.reference_hz,
            fine_steps=self.fine_steps,
        )


def _pin_members(config: IlluminatorConfig) -> dict[str, wiring.Member]:
    """Return the signature members for triggers and LEDs."""
    lanes = config.pulse.lanes
    fine = {"fine_load": Out(1), "fine_move": Out(config.pulse.channels)}
    return {
        "trigger": In(lanes),
        "frame_sync": In(1),
        "levels": Out(data.ArrayLayout(lanes, config.pulse.channels)),
        "trigger_out": Out(lanes),
        "marker": Out(8),
        "missed": Out(1),
        "armed": Out(1),
        "clock_failed": In(1),
        **(clock_members() if config.reference_hz else {}),
        **(fine if config.fine_steps else {}),
        **({"temperature": In(signed(32))} if config.temperature else {}),
    }


class IlluminatorCore(wiring.Component):
    """The illuminator behind any link that carries complete messages.

    Members
    -------
    requests : In, responses : Out
        See `control.messages`.
    trigger : In(lanes)
        Samples of the trigger input, lane 0 earliest.
    frame_sync : In(1)
        Asynchronous.
    levels : Out
        For each channel, `lanes` ticks.
    trigger_out : Out(lanes)
    marker : Out(8)
    missed : Out(1)
        A trigger was ignored; for the camera.
    armed : Out(1)
        LEDs may be on; in the domain `pulse`.
    clock_failed : In(1)
        The clocks are not valid, or have not been for long. It may rise at any time and falls
        with a clock of `sync`; after configuration it may begin high. While it is high the board
        is disarmed; when it falls again later, a failure is counted.
    reference_wanted : Out(1), reference_state : In
        Choice of the clock, where there is one: what the host wants, and what
        `boards.reference_clock` made of it, asynchronous.
    fine_load : Out(1), fine_move : Out(channels)
        Control of the fine delay lines, where there are any: see `FineDelays`.
    temperature : In(signed(32))
        In millidegrees Celsius or `TEMPERATURE_UNKNOWN`, where the board measures it; in `sync`.
    """

    def __init__(self, config: IlluminatorConfig) -> None:
        self.config = config
        super().__init__(
            {
                "requests": In(request_stream()),
                "responses": Out(response_stream()),
                **_pin_members(config),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        registers = RegisterFile(
            self.config.registers(),
            constants=self._constants(),
            unkept=(*_STEP_REGISTERS, "pulse"),
            lock_of=_lock_of,
            locks=4 if self.config.fine_steps else 3,
        )
        measured = {"temperature": self.temperature} if self.config.temperature else {}
        engine = add_control(m, registers, clock_ratio=self.config.clock_ratio, **measured)
        connect(m, flipped(self.requests), engine.requests)
        connect(m, engine.responses, flipped(self.responses))
        generator = PulseGenerator(self.config.pulse, memory_style=self.config.memory_style)
        m.submodules.generator = generator
        safety = Arming(round(self.config.sync_hz / 1000))
        m.submodules.safety = safety
        self._safety(m, registers, safety, generator)
        self._settings(m, registers, generator, engine.begin)
        self._schedules(m, registers, generator, safety)
        self._status(m, registers, generator, safety, engine.latched)
        if self.config.reference_hz:
            choice = connect_clock_choice(m, registers, self.reference_state)
            m.d.comb += self.reference_wanted.eq(choice)
        m.d.comb += [
            generator.samples.eq(self.trigger),
            generator.frame_sync.eq(self.frame_sync),
            self.levels.eq(generator.levels),
            self.trigger_out.eq(generator.trigger_out),
            self.marker.eq(generator.marker),
            self.missed.eq(generator.missed),
            self.armed.eq(generator.lit),
        ]
        return m

    def _constants(self) -> dict[str | tuple[str, tuple[int, ...]], int]:
        registers = self.config.registers()
        limits = {}
        for channel in range(self.config.pulse.channels):
            limit = self.config.pulse.limit(channel)
            limits["limit", (channel,)] = registers["limit"].encode(
                on_ticks=limit.max_on_ticks,
                burst_ticks=limit.burst_ticks,
                duty_divisor=limit.duty_divisor,
            )
        major, minor, patch = VERSION
        return {
            **limits,
            "versions": registers["versions"].encode(major=major, minor=minor, patch=patch),
            "serial": self.config.serial,
            "features": registers["features"].encode(
                clock_supervision=self.config.clock_supervision,
                temperature=self.config.temperature,
                **({"external_clock": 1} if self.config.reference_hz else {}),
                **({"fine_delay": 1} if self.config.fine_steps else {}),
            ),
            "source": self.config.source,
        }

    def _safety(
        self, m: Module, registers: RegisterFile, safety: Arming, generator: PulseGenerator
    ) -> None:
        armed = safety.armed
        if self.config.fine_steps:
            armed = self._fine_delays(m, registers, armed)
        m.submodules.armed = FFSynchronizer(armed, generator.armed, o_domain="pulse")
        m.d.comb += [
            safety.key.eq(registers.arm),
            safety.key_written.eq(registers.arm_written),
            safety.timeout_ms.eq(registers.watchdog_ms),
            safety.feed.eq(registers.watchdog_feed.value),
            registers.watchdog_left_ms.value.eq(safety.left_ms),
        ]
        if self.config.clock_supervision:
            self._supervise_clock(m, registers, safety)

    def _fine_delays(self, m: Module, registers: RegisterFile, armed: Signal) -> Signal:
        """Set the fine delay lines; return whether LEDs may fire: armed, and no line moves."""
        first = registers.registers["fine_delay"].address
        last = first + self.config.pulse.channels - 1
        m.submodules.fine = fine = FineDelays(self.config.pulse.channels, self.config.fine_steps)
        may_fire = Signal()
        m.d.sync += may_fire.eq(armed & ~fine.moving)
        m.d.comb += [
            registers.locked[_FINE_LOCK].eq(armed),
            fine.restart.eq(
                self.clock_failed
                | (
                    registers.written
                    & (registers.written_address >= first)
                    & (registers.written_address <= last)
                )
            ),
            *(
                fine.targets[channel].eq(registers.fine_delay[channel].value)
                for channel in range(self.config.pulse.channels)
            ),
            self.fine_load.eq(fine.load),
            self.fine_move.eq(fine.move),
        ]
        return may_fire

    def _supervise_clock(self, m: Module, registers: RegisterFile, safety: Arming) -> None:
        """Disarm while the clock fails, and count the failures."""
        m.d.comb += safety.disarm.eq(self.clock_failed)
        count_clock_failures(m, registers, self.clock_failed)

    def _settings(
        self, m: Module, registers: RegisterFile, generator: PulseGenerator, begin: Signal
    ) -> None:
        """Transfer settings that may change during trains, and commands, to the pulse domain."""
        m.submodules.crossing = crossing = SettingsCrossing(
            LIVE_LAYOUT, STROBE_LAYOUT, domain="pulse"
        )
        settings, commands = crossing.settings, crossing.commands
        trigger, sequencer = registers.trigger, registers.sequencer
        m.d.comb += [
            settings.source.eq(trigger.source),
            settings.restart.eq(trigger.retrigger == Retrigger.RESTART),
            settings.falling.eq(trigger.falling),
            settings.output.eq(trigger.output),
            settings.period.eq(registers.trigger_period.value),
            settings.out_delay.eq(registers.trigger_out.delay),
            settings.out_width.eq(registers.trigger_out.width),
            settings.filter.eq(registers.trigger_filter.width),
            settings.bank.eq(registers.bank_select.value),
            settings.by_frame.eq(sequencer.advance == Advance.FRAME_SYNC),
            settings.loop.eq(sequencer.loop),
            settings.length.eq(sequencer.length),
            commands.start.eq(registers.sequencer_control.start),
            commands.stop.eq(registers.sequencer_control.stop),
            commands.frame.eq(registers.sequencer_control.sync),
            commands.trigger.eq(registers.trigger_now.value),
            commands.clear_counters.eq(registers.clear.counters),
            commands.clear_phase.eq(registers.clear.phase),
            commands.snapshot.eq(begin),
            generator.live.eq(crossing.settings_out),
            generator.strobes.eq(crossing.commands_out),
        ]
        first = registers.registers["step_setup"].address
        in_program = (registers.written_address >= first) & (
            registers.written_address < first + len(_STEP_REGISTERS) * self.config.pulse.steps
        )
        m.d.comb += [
            generator.program_write.eq(registers.written & in_program),
            generator.program_address.eq(registers.written_address - first),
            generator.program_word.eq(registers.written_word),
        ]

    def _schedules(
        self, m: Module, registers: RegisterFile, generator: PulseGenerator, safety: Arming
    ) -> None:
        """Connect the banks; they are read across clock domains, so a bank in use is locked."""
        store = ScheduleStore(self.config.pulse, registers.registers["pulse"])
        m.submodules.schedules = store
        m.d.comb += [
            store.written.eq(registers.written),
            store.address.eq(registers.written_address),
            store.word.eq(registers.written_word),
        ]
        for bank in range(2):
            m.d.comb += [
                generator.banks[bank].period.eq(registers.bank_period[bank].value),
                generator.banks[bank].enable.eq(registers.bank_enable[bank].value),
                generator.banks[bank].pulses.eq(store.pulses[bank]),
            ]
        bank_now = Signal()
        running = Signal()
        m.submodules.bank = FFSynchronizer(generator.bank, bank_now)
        m.submodules.running = FFSynchronizer(generator.running, running)
        for bank in range(2):
            used = (bank_now == bank) | (registers.bank_select.value == bank) | running
            m.d.comb += registers.locked[bank].eq(safety.armed & used)
        m.d.comb += registers.locked[_PROGRAM_LOCK].eq(running)

    def _status(
        self,
        m: Module,
        registers: RegisterFile,
        generator: PulseGenerator,
        safety: Arming,
        latched: Signal,
    ) -> None:
        """Connect the generator's status, which is stable from one snapshot to the next."""
        status = generator.status
        left = Signal(33)
        m.d.sync += left.eq(status.left + status.idle_left)
        m.d.comb += [
            registers.state.armed.eq(safety.armed),
            registers.state.busy.eq(status.busy),
            registers.state.bank.eq(status.bank),
            registers.state.swap_pending.eq(
                (status.bank != registers.bank_select.value) & ~status.running
            ),
            registers.state.sequencing.eq(status.running),
            registers.state.trigger_level.eq(status.trigger_level),
            registers.state.step.eq(status.step),
            registers.state.marker.eq(status.marker),
            registers.step_left.value.eq(Mux(left[32], -1, left)),
            registers.phase.last.eq(status.phase_last),
            registers.phase.min.eq(status.phase_min),
            registers.phase.max.eq(status.phase_max),
            registers.phase.valid.eq(status.phase_valid),
            *(
                registers.phase_count[lane].value.eq(status.phase_count[lane])
                for lane in range(self.config.pulse.lanes)
            ),
        ]
        names = dict(zip(COUNTERS[:3], ("seen", "served", "ignored"), strict=True))
        for counter in COUNTERS:
            name = f"triggers_{counter}" if counter in names else counter
            m.d.comb += getattr(registers, name).value.eq(status[counter])
        # each snapshot's events are taken over once
        m.d.comb += registers.faults_set.watchdog.eq(safety.expired)
        with m.If(latched):
            m.d.comb += [
                registers.on_limited_set.value.eq(status.on_limited),
                registers.duty_limited_set.value.eq(status.duty_limited),
                registers.faults_set.on_limit.eq(status.on_limited.any()),
                registers.faults_set.duty_limit.eq(status.duty_limited.any()),
                registers.faults_set.trigger_ignored.eq(status.trigger_ignored),
                registers.faults_set.saturated.eq(status.saturated),
            ]


class Illuminator(wiring.Component):
    """The illuminator behind a serial line.

    Members
    -------
    rx : In(1), tx : Out(1)
        Pins of the serial line; the others are those of `IlluminatorCore`.
    """

    def __init__(self, config: IlluminatorConfig) -> None:
        self.config = config
        super().__init__({"rx": In(1), "tx": Out(1, init=1), **_pin_members(config)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.core = core = IlluminatorCore(self.config)
        m.submodules.link = link = SerialLink(clock_hz=self.config.sync_hz, baud=self.config.baud)
        connect(m, link.requests, core.requests)
        connect(m, core.responses, link.responses)
        m.d.comb += [link.rx.eq(self.rx), self.tx.eq(link.tx)]
        for name, member in _pin_members(self.config).items():
            mine, inner = getattr(self, name), getattr(core, name)
            if member.flow is In:
                m.d.comb += inner.eq(mine)
            else:
                m.d.comb += mine.eq(inner)
        return m


def _lock_of(register: Register, indices: tuple[int, ...]) -> int | None:
    if register.name in ("pulse", "bank_period", "bank_enable"):
        return indices[0]
    if register.name in _STEP_REGISTERS:
        return _PROGRAM_LOCK
    if register.name == "fine_delay":
        return _FINE_LOCK
    return None
