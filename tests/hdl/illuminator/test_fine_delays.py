# SPDX-License-Identifier: Apache-2.0
"""The control of the fine delay lines: pulses that bring each line from 0 to its target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from amaranth.sim import Simulator, SimulatorContext

from hueflight_hdl.boards.target import Options, TargetError
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.illuminator.fine_delays import FineDelays
from hueflight_hdl.illuminator.gearing.ecp5 import Ecp5Gearing
from hueflight_hdl.illuminator.pulse_generator.config import PulseConfig
from hueflight_hdl.testbench.illuminator import IlluminatorTestbench
from hueflight_protocol import RegisterError, encode_request, serial_frame
from hueflight_protocol.control import write
from hueflight_protocol.illuminator_map import ARM_KEY, illuminator_map

from .conftest import SMALL

STEPS = 6
CLOCKS = 16 * STEPS  # to load the lines, and to move them by all but one of their settings


class Lines:
    """Delay lines as the vendor describes them: loaded with 0, moved by the end of a pulse."""

    def __init__(self, dut: FineDelays) -> None:
        self.dut = dut
        self.settings = [3] * dut.channels  # before the first load, anything
        self.longest = [0] * dut.channels
        self.clocks = 0

    async def run(self, ctx: SimulatorContext, clocks: int) -> None:
        before = [0] * self.dut.channels
        for _ in range(clocks):
            await ctx.tick()
            move = [ctx.get(self.dut.move) >> k & 1 for k in range(self.dut.channels)]
            for k, (was, now) in enumerate(zip(before, move, strict=True)):
                self.settings[k] += was and not now
                if ctx.get(self.dut.load):
                    self.settings[k] = 0
            before = move
            self.clocks += ctx.get(self.dut.moving)


def simulate(dut: FineDelays, testbench) -> None:
    simulator = Simulator(dut)
    simulator.add_clock(1e-6)
    simulator.add_testbench(testbench)
    simulator.run()


@pytest.mark.parametrize("targets", [(0, 1, 5), (5, 4, 0), (2, 127, 3)])
def test_lines_come_to_their_targets_and_stay(targets: tuple[int, ...]):
    dut = FineDelays(3, STEPS)

    async def testbench(ctx: SimulatorContext) -> None:
        lines = Lines(dut)
        for k, target in enumerate(targets):
            ctx.set(dut.targets[k], target)
        await lines.run(ctx, CLOCKS - 2)
        assert ctx.get(dut.moving)
        await lines.run(ctx, 2)
        assert not ctx.get(dut.moving)
        assert lines.settings == [min(target, STEPS - 1) for target in targets]
        await lines.run(ctx, 2 * CLOCKS)
        assert lines.settings == [min(target, STEPS - 1) for target in targets]

    simulate(dut, testbench)


@pytest.mark.parametrize("clocks", [1, 9, 25, 40, CLOCKS + 5])
def test_a_change_on_the_way_begins_anew(clocks: int):
    dut = FineDelays(3, STEPS)

    async def testbench(ctx: SimulatorContext) -> None:
        lines = Lines(dut)
        for k in range(3):
            ctx.set(dut.targets[k], 5 - k)
        await lines.run(ctx, clocks)
        ctx.set(dut.targets[0], 1)
        ctx.set(dut.restart, 1)
        await lines.run(ctx, 1)
        ctx.set(dut.restart, 0)
        assert ctx.get(dut.moving)
        await lines.run(ctx, CLOCKS)
        assert not ctx.get(dut.moving)
        assert lines.settings == [1, 4, 3]

    simulate(dut, testbench)


def test_registers_are_there_only_with_lines_and_bits_stay_in_place():
    plain, fine = illuminator_map(), illuminator_map(fine_steps=128)
    assert {r.name for r in fine} - {r.name for r in plain} == {"fine_step", "fine_delay"}
    with_clock = illuminator_map(fine_steps=128, external_clock=True)
    places = [r["features"].fields["fine_delay"].shift for r in (fine, with_clock)]
    assert places == [3, 3]
    with pytest.raises(RegisterError, match="fine_steps = 129: must be 0, or from 2 to 128"):
        illuminator_map(fine_steps=129)


@pytest.mark.slow
def test_leds_stay_dark_until_the_lines_have_moved(simulator: None):
    """The board is armed while lines move; LEDs may fire when these have stopped."""
    config = replace(SMALL, pulse=PulseConfig(channels=1, pulses=1, steps=1), fine_steps=128)
    bench = IlluminatorTestbench(config, Ecp5Gearing())
    registers = config.registers()
    ends = []
    bench.advance(10_000)  # the lines move after configuration too
    bench.record()
    for number, (name, word) in enumerate((("fine_delay", 90), ("arm", ARM_KEY))):
        request = write(number, registers[name].address, [word])
        bench.write(serial_frame(encode_request(request)))
        ends.append(len(bench._pending))
    bench.advance(ends[1] + 6000)
    lit = np.flatnonzero(bench.recorded()["armed"])
    moved = ends[0] + 2048 * config.clock_ratio
    assert ends[1] < moved - 1000  # armed on the way
    assert moved <= lit[0] < moved + 200
    assert len(lit) == len(bench.recorded()) - lit[0]
    bench.write(serial_frame(encode_request(write(2, registers["fine_delay"].address, [1]))))
    bench.record()
    bench.advance(6000)
    assert bench.recorded()["armed"].all()  # refused: the lines do not move


def test_boards_without_lines_refuse_them():
    with pytest.raises(TargetError, match="hx8k has no fine delay lines behind its outputs"):
        find_target("illuminator", "hx8k", Options(settings={"fine_delay": 1}))
