# SPDX-License-Identifier: Apache-2.0
"""A sensor that stops is a fault, and the camera goes on."""

import pytest
from amaranth.sim import Simulator

from hueflight_hdl.camera.exposure.frame_guard import FrameGuard
from hueflight_hdl.camera.frame_format import FrameFormat

FORM = FrameFormat(rows=4, cols=8, lanes=8, run=8, code_bits=4)
PATIENCE = 6


def run(beats: int, form: FrameFormat = FORM, *, clocks: int = 40) -> dict[str, list[int]]:
    """Ask for a frame and send so many beats of it; return the clocks of each output."""
    dut = FrameGuard(form, patience=PATIENCE)
    seen: dict[str, list[int]] = {
        name: [] for name in ("passed", "dropped", "aborted", "over", "fault")
    }

    async def drive(ctx):
        taken = 0
        ctx.set(dut.admit, 1)
        ctx.set(dut.beats.ready, 1)
        for clock in range(clocks):
            ctx.set(dut.read, clock == 1)
            sends = clock >= 3 and taken < beats
            ctx.set(dut.sensor.valid, sends)
            ctx.set(dut.sensor.payload.first, taken == 0)
            ctx.set(dut.sensor.payload.row, 1)
            ctx.set(dut.sensor.payload.last, taken == form.beats - 1)
            ctx.set(dut.ends, taken == form.beats - 1)
            for name, found in seen.items():
                if ctx.get(getattr(dut, name)):
                    found.append(clock)
            taken += sends
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(drive)
    simulator.run()
    return seen


@pytest.mark.parametrize("form", [FORM, FrameFormat(rows=1, cols=8, lanes=8, run=8, code_bits=4)])
def test_a_whole_frame_is_no_fault(form: FrameFormat):
    """Also one that is a single beat."""
    seen = run(form.beats, form)
    assert len(seen["passed"]) == len(seen["over"]) == 1
    assert not seen["fault"] + seen["dropped"] + seen["aborted"]


@pytest.mark.parametrize("beats", [1, 2, 3])
def test_a_sensor_that_stops_within_a_frame_is_a_fault(beats: int):
    seen = run(beats)
    assert seen["fault"] == [3 + beats + PATIENCE]
    assert len(seen["aborted"]) == len(seen["over"]) == 1
    assert not seen["passed"] + seen["dropped"]


def test_a_sensor_that_sends_nothing_is_a_fault():
    seen = run(0)
    assert len(seen["fault"]) == 1
    assert seen["fault"] == seen["dropped"] == seen["over"]
