# SPDX-License-Identifier: Apache-2.0
"""Programs: every unit of every step, in order, whatever units are and however often."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from hueflight_hdl.illuminator.pulse_generator.config import PulseConfig
from hueflight_hdl.illuminator.pulse_generator.generator import (
    LIVE_LAYOUT,
    STROBE_LAYOUT,
    PulseGenerator,
)
from hueflight_hdl.illuminator.pulse_generator.reference import (
    Choice,
    Pulse,
    Schedule,
    Step,
    program_units,
)
from hueflight_hdl.testbench.cxxrtl import Simulation
from hueflight_hdl.testbench.pulse_generator import PulseTestbench, bits, schedule_constants
from hueflight_protocol.illuminator_map import TriggerSource
from support.illuminator_stimuli import small_config

Make = Callable[[PulseConfig], PulseTestbench]
PERIOD_CLOCKS = 20
# each channel's pulse is short and of its own bank, so that a word tells bank and mask
BANKS = tuple(
    [[Pulse(8 * channel + 4 * bank, 4), Pulse(0, 0)] for channel in range(3)] for bank in range(2)
)


@dataclass
class Run:
    """A sequencer at work: trains as they came out."""

    trains: list[Choice]
    running: np.ndarray
    started: int


def write_program(simulation: Simulation, program: list[Step]) -> None:
    records = simulation.inputs(len(program) * 8)
    records["program_write"] = 1
    for number, step in enumerate(program):
        words = (
            step.choice.bank | step.choice.marker << 8,
            step.choice.mask,
            step.count,
            step.idle,
        )
        for word, value in enumerate(words):
            at = slice(number * 8 + word * 2, number * 8 + word * 2 + 2)  # one clock of `sync`
            records["program_address"][at] = number * 4 + word
            records["program_word"][at] = value
    simulation.run(records)


def play(
    bench: PulseTestbench,
    program: list[Step],
    *,
    clocks: int,
    by_frame: bool = False,
    loop: bool = False,
    start: int = 100,
    stop: int | None = None,
    frames: tuple[int, ...] = (),
    trigger_clocks: int = PERIOD_CLOCKS,
) -> Run:
    simulation = bench.simulation
    # stopped and dark, whatever the test before left running
    quiet = simulation.inputs(1)
    quiet["strobes"] = bits(STROBE_LAYOUT, {"stop": 1})
    simulation.run(quiet, hold=2000)
    write_program(simulation, program)
    records = simulation.inputs(clocks)
    schedules = [Schedule(min(PERIOD_CLOCKS, trigger_clocks) * 4, 7, bank) for bank in BANKS]
    banks = bits(bench.banks_layout, schedule_constants(schedules))
    records["banks"][:] = [banks >> 32 * i & 0xFFFFFFFF for i in range(records["banks"].shape[1])]
    live = {
        "source": TriggerSource.INTERNAL,
        "period": trigger_clocks * 4,
        "by_frame": int(by_frame),
        "loop": int(loop),
        "length": len(program),
    }
    records["live"] = bits(LIVE_LAYOUT, live)
    records["armed"] = 1
    records["strobes"][start] = bits(STROBE_LAYOUT, {"start": 1})
    if stop is not None:
        records["strobes"][stop] = bits(STROBE_LAYOUT, {"stop": 1})
    for frame in frames:
        records["frame_sync"][frame : frame + 5] = 1
    outputs = simulation.run(records)
    return Run(read_trains(outputs, trigger_clocks), outputs["running"], start)


def read_trains(outputs: np.ndarray, trigger_clocks: int) -> list[Choice]:
    """Trains at the internal period, told by what channels fire where; dark ones too."""
    levels = outputs["levels"]
    first = int(np.flatnonzero(levels)[0]) if levels.any() else 0
    # the program is not running in the beginning, so the first train is a manual one
    trains = []
    for clock in range(first, len(levels) - 6, trigger_clocks):
        word = levels[clock : clock + 6].reshape(3, 2)  # [channel][bank], one clock each
        masks = [0, 0]
        for channel in range(3):
            for bank in range(2):
                field = int(word[channel][bank]) >> 4 * channel & 0xF
                assert field in (0, 0xF)
                masks[bank] |= (field == 0xF) << channel
        assert not (masks[0] and masks[1]), "a train of two banks"
        marker = int(outputs["marker"][clock])
        trains.append(Choice(1 if masks[1] else 0, masks[0] | masks[1], marker))
    return trains


MANUAL = Choice(0, 7, 0)
REFERENCE_CAPTURES = [
    *(Step(2, 1, Choice(0, 1 << channel, channel + 1)) for channel in range(3)),
    Step(3, 0, Choice(0, 7, 4)),
    Step(2, 0, Choice(0, 0, 5)),
]
ALTERNATING = [Step(3, 0, Choice(0, 7, 1)), Step(3, 0, Choice(1, 7, 2))]
SINGLE = [Step(1, 0, Choice(number % 2, 1 + number % 7, number + 1)) for number in range(8)]
SKIPPING = [
    Step(0, 3, Choice(0, 7, 9)),
    Step(1, 2, Choice(1, 2, 1)),
    Step(0, 0, Choice(0, 7, 9)),
    Step(2, 0, Choice(0, 4, 2)),
    Step(0, 1, Choice(1, 7, 9)),
]
PROGRAMS = {
    "reference captures": REFERENCE_CAPTURES,
    "two schedules": ALTERNATING,
    "a step for each train": SINGLE,
    "empty steps": SKIPPING,
}


def program_part(trains: list[Choice], program: list[Step]) -> list[Choice]:
    """Trains from the program's first on; before it are manual ones, and dark ones."""
    units = program_units(program)
    begin = next(i for i, train in enumerate(trains) if train.marker == units[0].marker)
    assert all(train in (MANUAL, Choice(0, 0, 0)) for train in trains[:begin])
    assert trains[:begin].count(Choice(0, 0, 0)) <= 1  # the step is found within a train
    return trains[begin:]


def same(found: list[Choice], wanted: list[Choice]) -> bool:
    """A train without light has no bank to be told by."""
    return [(t.mask, t.marker, t.bank if t.mask else 0) for t in found] == [
        (t.mask, t.marker, t.bank if t.mask else 0) for t in wanted
    ]


@pytest.mark.parametrize("name", PROGRAMS)
def test_each_train_is_of_its_step(bench: Make, name: str):
    program = PROGRAMS[name]
    units = program_units(program)
    run = play(bench(small_config(4)), program, clocks=PERIOD_CLOCKS * (len(units) + 15))
    trains = program_part(run.trains, program)
    assert same(trains[: len(units)], units)
    # when the program has ended, the manual setting is back
    assert all(train == MANUAL for train in trains[len(units) + 1 :])
    assert len(trains) > len(units) + 3
    assert not run.running[-1]


def test_frame_syncs_change_nothing_where_triggers_are_counted(bench: Make):
    units = program_units(REFERENCE_CAPTURES)
    clocks = PERIOD_CLOCKS * (len(units) + 10)
    frames = tuple(range(90, clocks, 13))
    run = play(bench(small_config(4)), REFERENCE_CAPTURES, clocks=clocks, frames=frames)
    assert same(program_part(run.trains, REFERENCE_CAPTURES)[: len(units)], units)


@pytest.mark.parametrize("name", ["reference captures", "two schedules", "empty steps"])
def test_a_loop_has_no_gap(bench: Make, name: str):
    program = PROGRAMS[name]
    units = program_units(program) * 4
    clocks = PERIOD_CLOCKS * (len(units) + 10)
    run = play(bench(small_config(4)), program, clocks=clocks, loop=True)
    assert same(program_part(run.trains, program)[: len(units)], units)
    assert run.running[-1]


@pytest.mark.parametrize("trigger_clocks", [16, 17, 31, 200])
def test_steps_of_one_train_at_any_period(bench: Make, trigger_clocks: int):
    run = play(
        bench(small_config(4)),
        SINGLE,
        clocks=trigger_clocks * 30,
        loop=True,
        start=200,
        trigger_clocks=trigger_clocks,
    )
    found = program_part(run.trains, SINGLE)
    units = (program_units(SINGLE) * 4)[: len(found)]
    assert same(found, units)


def test_every_step_of_memories_made_of_luts():
    """They are as deep as one LUT each: 32 steps are in two of them."""
    program = [Step(1, 0, Choice(number % 2, 1 + number % 7, number + 1)) for number in range(32)]
    config = replace(small_config(4), steps=len(program))
    run = play(PulseTestbench(config, memory_style="distributed"), program, clocks=16 * 50,
               trigger_clocks=16)  # fmt: skip
    units = program_units(program)
    assert same(program_part(run.trains, program)[: len(units)], units)


def test_leds_are_dark_while_the_next_step_is_looked_for():
    """Behind many empty steps it comes late; the step that has ended does not go on meanwhile."""
    empty = [Step(0, 0, Choice(0, 7, 9))] * 28
    program = [Step(2, 0, Choice(0, 1, 1)), *empty, Step(3, 0, Choice(0, 2, 2))]
    bench = PulseTestbench(replace(small_config(4), steps=32))
    found = program_part(play(bench, program, clocks=16 * 30, trigger_clocks=16).trains, program)
    dark = next(i for i, train in enumerate(found[2:]) if train.mask)
    assert 0 < dark < 10
    assert same(found[: 2 + dark + 3], program_units(program[:1]) + [Choice(0, 0, 0)] * dark
                + program_units(program[-1:]))  # fmt: skip


def test_frame_syncs_step_the_program(bench: Make):
    """Steps last from one frame sync to another; the first sync begins."""
    frames = tuple(range(300, 2300, 137))
    run = play(bench(small_config(4)), REFERENCE_CAPTURES, clocks=2400, by_frame=True,
               frames=frames)  # fmt: skip
    markers = [train.marker for train in run.trains]
    units = program_units(REFERENCE_CAPTURES)
    # markers in the order of the units, each for about 137 / 20 trains
    changes = [m for i, m in enumerate(markers) if i == 0 or m != markers[i - 1]]
    wanted = [m for i, m in enumerate([0, *(u.marker for u in units)])
              if i == 0 or m != [0, *(u.marker for u in units)][i - 1]]  # fmt: skip
    assert changes[: len(wanted)] == wanted
    for marker, step in zip((1, 2, 3, 4, 5), REFERENCE_CAPTURES, strict=True):
        trains = markers.count(marker)
        assert abs(trains - step.count * 137 / PERIOD_CLOCKS) <= 1


def test_a_frame_sync_too_soon_after_another_is_one(bench: Make):
    """Syncs closer than eight clocks are one; so a bouncing line does not skip steps."""
    frames = tuple(f for base in (300, 500, 700) for f in (base, base + 6))
    program = [
        Step(1, 0, Choice(0, 1, 1)),
        Step(1, 0, Choice(0, 2, 2)),
        Step(1, 0, Choice(0, 4, 3)),
    ]
    simulation = bench(small_config(4))
    run = play(simulation, program, clocks=900, by_frame=True, frames=frames)
    markers = [train.marker for train in run.trains]
    assert {1, 2, 3} <= set(markers)
    assert abs(markers.count(1) - 10) <= 1


def test_stop_ends_the_program_and_start_begins_again(bench: Make):
    program = REFERENCE_CAPTURES
    clocks = 100 + PERIOD_CLOCKS * 20
    run = play(bench(small_config(4)), program, clocks=clocks, stop=100 + PERIOD_CLOCKS * 5)
    assert run.trains[-1] == MANUAL
    assert not run.running[-1]
    again = play(bench(small_config(4)), program, clocks=clocks)
    units = program_units(program)
    assert same(program_part(again.trains, program)[: len(units)], units)


def test_a_program_of_nothing_stays_dark_until_stopped(bench: Make):
    program = [Step(0, 0, Choice(0, 7, 1))] * 3
    run = play(bench(small_config(4)), program, clocks=1200, loop=True, stop=800)
    middle = run.trains[10:30]
    assert all(train.mask == 0 for train in middle)
    assert run.running[700]
    assert run.trains[-1] == MANUAL


def test_a_program_without_steps_ends_at_once(bench: Make):
    run = play(bench(small_config(4)), [], clocks=600)
    assert all(train == MANUAL for train in run.trains[5:])
    assert not run.running[-1]
    assert PulseGenerator.latency > 0
