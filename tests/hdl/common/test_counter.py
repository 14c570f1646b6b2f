# SPDX-License-Identifier: Apache-2.0
"""The plain counter saturates, says so, and starts again when it is cleared."""

from amaranth.sim import Simulator

from hueflight_hdl.common.counter import SaturatingCounter


def test_it_stays_at_its_largest_value():
    dut = SaturatingCounter(3)
    seen = []

    async def count(ctx):
        ctx.set(dut.event, 1)
        for _ in range(20):
            seen.append((ctx.get(dut.value), ctx.get(dut.saturated)))
            await ctx.tick()
        ctx.set(dut.event, 0)
        ctx.set(dut.clear, 1)
        await ctx.tick()
        ctx.set(dut.clear, 0)
        assert (ctx.get(dut.value), ctx.get(dut.saturated)) == (0, 0)
        ctx.set(dut.event, 1)
        await ctx.tick()
        assert ctx.get(dut.value) == 1

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(count)
    simulator.run()
    assert seen == [(min(events, 7), int(events > 7)) for events in range(20)]
