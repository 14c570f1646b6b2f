# SPDX-License-Identifier: Apache-2.0
"""A testbench that compares the pulse generator with its reference model tick by tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from amaranth.lib import data

from hueflight_protocol.illuminator_map import TriggerSource

from ..illuminator.pulse_generator.config import PulseConfig
from ..illuminator.pulse_generator.generator import LIVE_LAYOUT, PulseGenerator
from ..illuminator.pulse_generator.reference import (
    Choice,
    Schedule,
    Train,
    find_edges,
    limit,
    render,
    serve,
)
from .cxxrtl import Simulation, simulate
from .ticks import ticks_to_words, words_to_ticks

SETTLE_CLOCKS = 16_000
"""After so many dark clocks nothing of the past is left: no pulse, no duty level."""


@dataclass(frozen=True)
class Stimulus:
    """What happens to a generator.

    Parameters
    ----------
    banks : pair of Schedule
    trigger : numpy.ndarray of bool, shape (ticks,)
        Level of the trigger input.
    bank : numpy.ndarray of int, shape (clocks,), optional
        Bank wanted; 0 by default.
    armed : numpy.ndarray of bool, shape (clocks,), optional
        Armed by default.
    restart, falling : bool
        Settings of the trigger.
    filter_width : int
        Width of the trigger's filter in ticks; 0 for none.
    """

    banks: tuple[Schedule, Schedule]
    trigger: np.ndarray
    bank: np.ndarray | None = None
    armed: np.ndarray | None = None
    restart: bool = False
    falling: bool = False
    filter_width: int = 0


@dataclass(frozen=True)
class Outcome:
    """The response to a stimulus.

    Parameters
    ----------
    levels : numpy.ndarray of bool, shape (channels, ticks)
        Without latency: a pulse of delay 0 begins in the tick of its trigger.
    trains : list of Train
        What the model served.
    """

    levels: np.ndarray
    trains: list[Train] = field(default_factory=list)


def expected(config: PulseConfig, stimulus: Stimulus, /) -> Outcome:
    """Return what the model says."""
    lanes = config.lanes
    ticks = len(stimulus.trigger)
    clocks = ticks // lanes
    edges = find_edges(
        stimulus.trigger,
        lanes=lanes,
        falling=stimulus.falling,
        width=max(stimulus.filter_width, 1),
    )
    later = filter_clocks(config, stimulus)
    bank = np.zeros(clocks, int) if stimulus.bank is None else stimulus.bank

    def choose(clock: int) -> Choice:
        return Choice(int(bank[min(clock + PulseGenerator.choice_latency + later, clocks - 1)]))

    periods = [schedule.period for schedule in stimulus.banks]
    trains, _ = serve(edges, choose, periods, lanes=lanes, restart=stimulus.restart)
    levels = np.empty((config.channels, ticks), bool)
    for channel in range(config.channels):
        demand = render(
            trains,
            stimulus.banks,
            channel=channel,
            lanes=lanes,
            ticks=ticks,
            widest=config.widest,
        )
        levels[channel] = limit(demand, config.limit(channel), lanes=lanes)
    if stimulus.armed is not None:
        late = PulseGenerator.latency + later - PulseGenerator.armed_latency
        armed = np.concatenate((stimulus.armed[late:], np.ones(late, bool)))
        levels &= np.repeat(armed, lanes)
    return Outcome(levels, trains)


def filter_clocks(config: PulseConfig, stimulus: Stimulus, /) -> int:
    """Return how many clocks later everything happens because of the trigger's filter."""
    return PulseGenerator.filter_clocks(config) if stimulus.filter_width else 0


class PulseTestbench:
    """A compiled generator.

    Parameters
    ----------
    config : PulseConfig
    memory_style : str, optional
        As `PulseGenerator` has it.
    """

    def __init__(self, config: PulseConfig, *, memory_style: str | None = None) -> None:
        self.config = config
        self.simulation: Simulation = simulate(
            PulseGenerator(config, memory_style=memory_style), clocks={"pulse": 1, "sync": 2}
        )

    def run(self, stimulus: Stimulus, /, *, settle: bool = True) -> Outcome:
        """Return what the gateware does.

        Parameters
        ----------
        stimulus : Stimulus
        settle : bool
            Have it rest in the dark before, with the same settings and the input's first level.
        """
        lanes = self.config.lanes
        clocks = len(stimulus.trigger) // lanes
        latency = PulseGenerator.latency + filter_clocks(self.config, stimulus)
        records = self.simulation.inputs(clocks + latency)
        self._set(records, "banks", bits(self.banks_layout, schedule_constants(stimulus.banks)))
        live = [self._live(stimulus, bank) for bank in range(2)]
        bank = np.zeros(clocks, int) if stimulus.bank is None else stimulus.bank
        bank = np.concatenate((bank, np.repeat(bank[-1:], latency)))
        for number, word in enumerate(live):
            records["live"][bank == number] = word
        records["armed"] = 1
        if stimulus.armed is not None:
            records["armed"][:clocks] = stimulus.armed
        records["samples"][:clocks] = ticks_to_words(stimulus.trigger, lanes=lanes)
        records["samples"][clocks:] = records["samples"][clocks - 1]
        if settle:
            rest = records[:1].copy()
            rest["samples"] = np.uint32(stimulus.trigger[0]) * ((1 << lanes) - 1)
            self._set(rest, "banks", 0)
            self.simulation.run(rest, hold=SETTLE_CLOCKS)
        outputs = self.simulation.run(records)
        levels = words_to_ticks(outputs["levels"], lanes=lanes, signals=self.config.channels)
        return Outcome(levels[:, latency * lanes :])

    @property
    def banks_layout(self) -> data.Layout:
        """Layout of the generator's port `banks`."""
        return data.ArrayLayout(self.config.bank_layout, 2)

    def _live(self, stimulus: Stimulus, bank: int) -> int:
        return bits(
            LIVE_LAYOUT,
            {
                "source": TriggerSource.EXTERNAL,
                "restart": int(stimulus.restart),
                "falling": int(stimulus.falling),
                "bank": bank,
                "period": 256,
                "filter": stimulus.filter_width,
            },
        )

    def _set(self, records: np.ndarray, name: str, value: int) -> None:
        part = records[name]
        if part.ndim == 1:
            part[:] = value
        else:
            part[:] = [value >> 32 * i & 0xFFFFFFFF for i in range(part.shape[1])]


def bits(layout: data.Layout, value: object) -> int:
    """Return a constant of a layout as the bits of a port."""
    return layout.const(value).as_value().value


def schedule_constants(banks: Sequence[Schedule]) -> list[dict[str, object]]:
    """Return schedules as constants of `PulseConfig.bank_layout`."""
    return [
        {
            "period": bank.period,
            "enable": bank.enable,
            "pulses": [
                [{"delay": pulse.delay, "width": pulse.width} for pulse in channel]
                for channel in bank.pulses
            ],
        }
        for bank in banks
    ]
