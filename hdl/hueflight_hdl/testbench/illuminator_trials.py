# SPDX-License-Identifier: Apache-2.0
"""Random trials of illuminators, from the trigger's pin to those of the LEDs.

A serial line takes thousands of clocks for each message. Here a byte takes one clock, so that tens
of thousands of schedules can be tried; `testbench.illuminator` includes the serial line.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from amaranth.hdl import Module, Value
from amaranth.lib.wiring import In, Out, connect, flipped

from hueflight_protocol import decode_request, decode_response, encode_request
from hueflight_protocol.control import MAX_WORDS, Response, Result, read, write
from hueflight_protocol.errors import HueflightError
from hueflight_protocol.illuminator_map import ARM_KEY, Retrigger, TriggerSource

from ..control.messages import request_stream, response_stream
from ..illuminator.gearing.interface import Gearing
from ..illuminator.illuminator import IlluminatorConfig, IlluminatorCore
from ..illuminator.pulse_generator.config import PulseConfig
from ..illuminator.pulse_generator.generator import PulseGenerator
from ..illuminator.pulse_generator.reference import (
    Choice,
    Schedule,
    Train,
    find_edges,
    limit,
    render,
    serve,
)
from .cxxrtl import Simulation, compile_design
from .simulated_pins import SimulatedPins
from .ticks import ticks_to_words, words_to_ticks

_MESSAGE_CLOCKS, _BYTE_CLOCKS, _WORD_CLOCKS = 60, 4, 18
"""More clocks of `sync` than an exchange takes: alone, for each byte, and for each word."""


class TrialError(HueflightError):
    """A request in a trial that was not done."""


class SimulatedIlluminatorCore(SimulatedPins):
    """The illuminator's core between simulated gearings."""

    def __init__(self, config: IlluminatorConfig, gearing: Gearing) -> None:
        members = {"requests": In(request_stream()), "responses": Out(response_stream())}
        super().__init__(config, gearing, members)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.core = core = IlluminatorCore(self.config)
        connect(m, flipped(self.requests), core.requests)
        connect(m, core.responses, flipped(self.responses))
        m.d.comb += [
            core.trigger.eq(self.gearing.add_input(m, "trigger", self.trigger)),
            self.armed.eq(core.armed),
            self.missed.eq(core.missed),
        ]
        for channel in range(self.config.pulse.channels):
            level = Value.cast(core.levels[channel])
            self.gearing.add_output(m, f"channel{channel}", self.levels[channel], level)
        return m


@dataclass(frozen=True)
class Trial:
    """What happens to an illuminator that was at rest.

    Parameters
    ----------
    banks : pair of Schedule
        Bank 0 is selected in the beginning.
    trigger : numpy.ndarray of bool, shape (ticks,)
        At the pin; low in the beginning and at the end.
    arm, swap, disarm : int or None
        Clock in which a request begins that does it.
    restart, falling : bool
        Settings of the trigger.
    """

    banks: tuple[Schedule, Schedule]
    trigger: np.ndarray
    arm: int | None = 0
    swap: int | None = None
    disarm: int | None = None
    restart: bool = False
    falling: bool = False


@dataclass(frozen=True)
class Shot:
    """What an illuminator did in a trial.

    Parameters
    ----------
    levels : numpy.ndarray of bool, shape (channels, ticks)
        Without latency: a pulse of delay 0 begins in the tick of its trigger.
    armed : numpy.ndarray of bool, shape (ticks,)
        Whether the board said, in the clock of the level, that LEDs may be on.
    swapped : range
        Clocks of the trial; from one of them on, triggers found the other bank selected.
    missed : numpy.ndarray of bool, shape (clocks,)
        The output for the camera.
    """

    levels: np.ndarray
    armed: np.ndarray
    swapped: range
    missed: np.ndarray


class TrialTestbench:
    """A simulated board, and a clock-by-clock account of what it is asked for.

    Parameters
    ----------
    config : IlluminatorConfig
    gearing : Gearing
    record : bool
        Keep inputs and outputs, for `testbench.signal_dump`.

    Attributes
    ----------
    clocks : dict of str to int
        Clock domains, see `cxxrtl.compile_design`.
    recorded : list of (numpy.ndarray, numpy.ndarray)
        Inputs and outputs since configuration, if they are kept.
    """

    def __init__(
        self, config: IlluminatorConfig, gearing: Gearing, *, record: bool = False
    ) -> None:
        self.config = config
        self.gearing = gearing
        self.registers = config.registers()
        self._ratio = config.clock_ratio
        self.clocks = {"pulse": 1, "sync": self._ratio}
        self._compiled = compile_design(self.design(), clocks=self.clocks)
        self._record = record
        self.configure()

    def design(self) -> SimulatedIlluminatorCore:
        """Return the simulated design, not elaborated yet."""
        return SimulatedIlluminatorCore(self.config, self.gearing)

    def configure(self) -> None:
        """Have the board be as it is right after configuration."""
        self._simulation = Simulation(*self._compiled)
        self.recorded: list[tuple[np.ndarray, np.ndarray]] = []

    @property
    def latency_clocks(self) -> int:
        """Clocks from the trigger's pin to the LED's."""
        return self.gearing.input_latency + PulseGenerator.latency + self.gearing.output_latency

    @property
    def rest_clocks(self) -> int:
        """After so many dark clocks nothing of the past is left: no pulse, no duty level."""
        pulse = self.config.pulse
        limits = [pulse.limit(channel) for channel in range(pulse.channels)]
        ceiling = max(
            4 * limit.duty_divisor * limit.burst_ticks if limit.duty_divisor > 1 else 0
            for limit in limits
        )
        return (pulse.widest + ceiling) // pulse.lanes + 64

    def play(self, trial: Trial, /) -> Shot:
        """Load the schedules, and do what the trial says."""
        self._exchange([self._write("arm", value=0)])
        self._exchange(self._loading(trial.banks))
        self._exchange(
            [
                self._write("bank_select", value=0),
                self._write(
                    "trigger",
                    source=TriggerSource.EXTERNAL,
                    retrigger=Retrigger.RESTART if trial.restart else Retrigger.IGNORE,
                    falling=int(trial.falling),
                ),
            ],
            rest=self.rest_clocks,
        )
        asked = {
            trial.arm: self._write("arm", value=ARM_KEY),
            trial.swap: self._write("bank_select", value=1),
            trial.disarm: self._write("arm", value=0),
        }
        outputs, answered = self._run(
            {at: message for at, message in asked.items() if at is not None},
            np.concatenate(
                (
                    ticks_to_words(trial.trigger, lanes=self.config.pulse.lanes),
                    np.zeros(self.latency_clocks, np.uint32),
                )
            ),
        )
        swapped = range(len(outputs), len(outputs) + 1)
        if trial.swap is not None:
            swapped = self._effect(answered[sorted(asked.keys() - {None}).index(trial.swap)])
        return self._shot(outputs, swapped)

    def counters(self) -> tuple[int, ...]:
        """Return triggers seen, served and ignored, restarts and swaps."""
        message = encode_request(read(1, self.registers["triggers_seen"].address, 5))
        (answer,) = self._exchange([message])
        return answer.payload

    # -- requests -------------------------------------------------------------------------------

    def _write(self, name: str, /, *indices: int, **fields: int) -> bytes:
        register = self.registers[name]
        word = register.encode(**fields)
        return encode_request(write(1, register.address_of(*indices), [word]))

    def _loading(self, banks: Sequence[Schedule]) -> Iterator[bytes]:
        words: dict[int, int] = {}
        for number, bank in enumerate(banks):
            words[self.registers["bank_period"].address_of(number)] = bank.period
            words[self.registers["bank_enable"].address_of(number)] = bank.enable
            register = self.registers["pulse"]
            for channel, pulses in enumerate(bank.pulses):
                for slot, pulse in enumerate(pulses):
                    word = register.encode(delay=pulse.delay, width=pulse.width)
                    words[register.address_of(number, channel, slot)] = word
        return _block_writes(words)

    def _exchange(self, messages: Iterable[bytes], *, rest: int = 0) -> list[Response]:
        """Do requests one after another, then nothing for some clocks; the trigger is low."""
        at, asked = 0, {}
        for message in messages:
            asked[at] = message
            count = decode_request(message).count
            at += self._ratio * (
                _MESSAGE_CLOCKS + _BYTE_CLOCKS * len(message) + _WORD_CLOCKS * count
            )
        clocks = -(-max(at, rest) // self._ratio) * self._ratio
        _, answered = self._run(asked, np.zeros(clocks, np.uint32))
        return [answer for _, answer in answered]

    def _run(
        self, asked: Mapping[int, bytes], trigger: np.ndarray
    ) -> tuple[np.ndarray, list[tuple[int, Response]]]:
        """Simulate; return the outputs, and answers with the clocks in which they ended."""
        ratio = self._ratio
        records = self._simulation.inputs(-(-len(trigger) // ratio) * ratio)
        records["trigger"][: len(trigger)] = trigger
        records["responses__ready"] = 1
        slow = records.reshape(-1, ratio)
        for at, message in asked.items():
            span = slice(at // ratio, at // ratio + len(message) + 1)
            slow["requests__valid"][span] = 1
            payload = np.array([*message, 1 << 8], np.uint32)
            slow["requests__payload"][span] = payload[:, None]
        outputs = self._simulation.run(records)
        if self._record:
            self.recorded.append((records, outputs))
        answers = self._answers(outputs)
        if len(answers) != len(asked):
            raise TrialError(f"{len(asked)} requests, {len(answers)} answers")
        for at, (_, answer) in zip(sorted(asked), answers, strict=True):
            if answer.result != Result.OK:
                raise TrialError(
                    f"clock {at}: {asked[at].hex()} gives {Result(answer.result).name}"
                )
        return outputs, answers

    def _answers(self, outputs: np.ndarray) -> list[tuple[int, Response]]:
        slow = outputs[:: self._ratio]
        at = np.flatnonzero(slow["responses__valid"])
        beats = slow["responses__payload"][at]
        found, begin = [], 0
        for end in np.flatnonzero(beats >> 8) + 1:
            message = (beats[begin:end] & 0xFF).astype(np.uint8).tobytes()
            found.append((int(at[end - 1]) * self._ratio, decode_response(message)))
            begin = end
        return found

    def _effect(self, answered: tuple[int, Response]) -> range:
        """Return between which clocks a setting whose answer is known reached the generator.

        The word is written before its answer's sixteen bytes begin, and crosses in nine clocks.
        """
        end, _ = answered
        late = self.gearing.input_latency + PulseGenerator.choice_latency
        return range(end - 20 * self._ratio - late, end - late)

    def _shot(self, outputs: np.ndarray, swapped: range) -> Shot:
        pulse, late = self.config.pulse, self.latency_clocks
        clocks = len(outputs) - late
        levels = words_to_ticks(outputs["levels"], lanes=pulse.lanes, signals=pulse.channels)
        # the pin's level left the core some clocks before
        armed = outputs["armed"][late - self.gearing.output_latency :][:clocks].astype(bool)
        return Shot(
            levels[:, late * pulse.lanes :],
            np.repeat(armed, pulse.lanes),
            swapped,
            outputs["missed"].astype(bool),
        )


@dataclass(frozen=True)
class Prediction:
    """What the model says of a trial.

    Parameters
    ----------
    levels : numpy.ndarray of bool, shape (channels, ticks)
    trains : list of Train
    ignored : int
    """

    levels: np.ndarray
    trains: list[Train]
    ignored: int

    @property
    def swaps(self) -> int:
        """Trains of another bank than the one before them."""
        banks = [train.choice.bank for train in self.trains]
        return sum(a != b for a, b in pairwise(banks))


def predictions(config: PulseConfig, trial: Trial, shot: Shot, /) -> Iterator[Prediction]:
    """Return what the model says: one outcome for every trigger with which the swap can begin.

    Which of a few it is depends on the phases of two clocks; all else is certain. What `armed`
    of the shot forbids is dark.
    """
    lanes = config.lanes
    ticks = shot.levels.shape[1]
    trigger = np.zeros(ticks, bool)
    trigger[: len(trial.trigger)] = trial.trigger
    edges = find_edges(trigger, lanes=lanes, falling=trial.falling)
    periods = [schedule.period for schedule in trial.banks]
    clocks = edges // lanes
    possible = clocks[(clocks >= shot.swapped.start) & (clocks < shot.swapped.stop)]
    middle = (shot.swapped.start + shot.swapped.stop) // 2
    seen: list[list[Train]] = []
    for swap in sorted({shot.swapped.stop, *possible.tolist()}, key=lambda at: abs(at - middle)):
        trains, ignored = serve(
            edges,
            lambda clock, swap=swap: Choice(int(clock >= swap)),
            periods,
            lanes=lanes,
            restart=trial.restart,
        )
        if trains in seen:
            continue
        seen.append(trains)
        levels = np.empty((config.channels, ticks), bool)
        for channel in range(config.channels):
            demand = render(
                trains,
                trial.banks,
                channel=channel,
                lanes=lanes,
                ticks=ticks,
                widest=config.widest,
            )
            levels[channel] = limit(demand, config.limit(channel), lanes=lanes) & shot.armed
        yield Prediction(levels, trains, ignored)


def _block_writes(words: Mapping[int, int]) -> Iterator[bytes]:
    """Requests that write words by address, neighbours together."""
    places = sorted(words)
    while places:
        count = 1
        while count < min(len(places), MAX_WORDS) and places[count] == places[0] + count:
            count += 1
        part, places = places[:count], places[count:]
        yield encode_request(write(1, part[0], [words[place] for place in part]))
