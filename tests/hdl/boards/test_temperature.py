# SPDX-License-Identifier: Apache-2.0
"""The temperature of an ECP5: codes of its sensor, and what is said while none is valid."""

from __future__ import annotations

from itertools import pairwise

from amaranth.sim import Simulator, SimulatorContext

from hueflight_hdl.boards.ecp5_temperature import CELSIUS, TemperatureReader
from hueflight_protocol.wire import TEMPERATURE_UNKNOWN

CLOCK_HZ = 20e3


def test_every_code_has_its_temperature_and_none_without_a_valid_one():
    dut = TemperatureReader(CLOCK_HZ)
    answers = [*((code, 1) for code in range(64)), (25, 0), (25, 1)]
    seen, clocks = [], []

    async def sensor(ctx: SimulatorContext) -> None:
        await ctx.posedge(dut.start)
        for code, valid in answers:
            seen.append(ctx.get(dut.mdeg))
            ctx.set(dut.valid, 0)
            await ctx.tick().repeat(50)
            ctx.set(dut.code, code)
            ctx.set(dut.valid, valid)
            clocks.append(50)
            while not ctx.get(dut.start):
                await ctx.tick()
                clocks[-1] += 1
        seen.append(ctx.get(dut.mdeg))

    simulator = Simulator(dut)
    simulator.add_clock(1 / CLOCK_HZ)
    simulator.add_testbench(sensor)
    simulator.run()
    assert seen[0] == TEMPERATURE_UNKNOWN
    assert seen[1:] == [*(1000 * celsius for celsius in CELSIUS), TEMPERATURE_UNKNOWN, 25_000]
    assert set(clocks) == {dut.period}


def test_the_table_of_the_vendor():
    """Codes rise with the temperature, and are whole degrees about room temperature."""
    assert len(CELSIUS) == 64
    assert all(early <= late for early, late in pairwise(CELSIUS))
    assert CELSIUS[21:30] == tuple(range(21, 30))
    assert (CELSIUS[0], CELSIUS[-1]) == (-58, 132)
