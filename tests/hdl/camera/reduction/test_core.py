# SPDX-License-Identifier: Apache-2.0
"""The reduction core against its twin, bit for bit, in Amaranth's simulator."""

from typing import Any

import numpy as np
import pytest
from amaranth.sim import Simulator

from hueflight_hdl.camera.reduction.core import ReductionCore, groups_of
from hueflight_protocol.errors import HueflightError
from hueflight_protocol.reduction import ReductionTables, reduce_codes


def random_tables(rng, code_bits: int, widths: tuple[int, ...], entry_bits: int):
    codes = 1 << code_bits
    first, last = 1, codes - 1 - int(rng.integers(0, codes // 4))
    entries = np.zeros((len(widths), codes), np.uint16)
    entries[:, first : last + 1] = rng.integers(0, 1 << entry_bits, (len(widths), last - first + 1))
    return ReductionTables(entries, widths, first, last)


def run(dut, tables, offsets, frames, *, per_picture: int, pause: float, slow: int, rng):
    """Pictures (frames that they hold, sums) that the core gives, read `slow` clocks late."""
    lanes, pictures = dut.lanes, []

    async def sensor(ctx: Any) -> None:
        ctx.set(dut.frames_per_picture, per_picture)
        ctx.set(dut.first, tables.first)
        ctx.set(dut.last, tables.last)
        ctx.set(dut.limits, {f"sum{k}": int(limit) for k, limit in enumerate(tables.limits)})
        for code in range(1 << dut.code_bits):
            ctx.set(dut.table_code, code)
            ctx.set(dut.table_entries, [int(e) for e in tables.entries[:, code]])
            ctx.set(dut.table_write, 1)
            await ctx.tick()
        ctx.set(dut.table_write, 0)
        for group in range(dut.groups):
            ctx.set(dut.offset_group, group)
            ctx.set(dut.offsets, [int(o) for o in offsets[group * lanes :][:lanes]])
            ctx.set(dut.offset_write, 1)
            await ctx.tick()
        ctx.set(dut.offset_write, 0)
        for codes in frames:
            for group in range(dut.groups):
                while rng.random() < pause:
                    ctx.set(dut.valid, 0)
                    await ctx.tick()
                ctx.set(dut.valid, 1)
                ctx.set(dut.codes, [int(c) for c in codes[group * lanes :][:lanes]])
                ctx.set(dut.first_beat, group == 0)
                ctx.set(dut.last_beat, group == dut.groups - 1)
                await ctx.tick()
        ctx.set(dut.valid, 0)
        await ctx.tick().repeat(20 + slow + 2 * dut.groups)

    async def reader(ctx: Any) -> None:
        while True:
            while not ctx.get(dut.ready):
                await ctx.tick()
            await ctx.tick().repeat(slow + 1)
            assert ctx.get(dut.picture) == len(pictures)
            found = []
            for group in range(dut.groups):
                ctx.set(dut.read_group, group)
                await ctx.tick()
                sums = ctx.get(dut.sums)
                found += [[sums[n][f"sum{k}"] for k in range(tables.sums)] for n in range(lanes)]
            pictures.append((ctx.get(dut.frames), np.array(found, np.uint64)))
            ctx.set(dut.done, 1)
            await ctx.tick()
            ctx.set(dut.done, 0)
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(sensor)
    simulator.add_testbench(reader, background=True)
    simulator.run()
    return pictures


@pytest.mark.parametrize(
    ("seed", "lanes", "widths", "entry_bits", "pause", "slow"),
    [
        (0, 1, (4, 9, 6), 4, 0.0, 0),
        (1, 2, (12, 5), 8, 0.3, 3),
        (2, 4, (1, 32, 7, 10), 6, 0.0, 90),
        (3, 8, (10, 10, 10), 3, 0.6, 40),
    ],
)
def test_sums_are_those_of_the_twin(seed, lanes, widths, entry_bits, pause, slow):
    rng = np.random.default_rng(seed)
    code_bits = 4 + seed % 3
    tables = random_tables(rng, code_bits, widths, entry_bits)
    pixels = lanes * int(rng.integers(6, 12))
    dut = ReductionCore(pixels=pixels, lanes=lanes, code_bits=code_bits, widths=widths,
                        entry_bits=entry_bits)  # fmt: skip
    frames = rng.integers(0, 1 << code_bits, (37, pixels))
    reach = min(127, tables.last - tables.first)
    offsets = rng.integers(-reach, reach + 1, pixels)
    pictures = run(dut, tables, offsets, frames, per_picture=5, pause=pause, slow=slow, rng=rng)
    assert len(pictures) >= 2
    start = 0
    for count, sums in pictures:
        assert count >= 5
        expected = reduce_codes(frames[start : start + count], tables, offsets=offsets)
        np.testing.assert_array_equal(sums, expected)
        start += count
    assert slow < 80 or max(count for count, _ in pictures) > 5, (
        "a late reader was to be waited for"
    )
    if slow == 0:
        assert len(pictures) == 7


@pytest.mark.parametrize("pixels", [20, 26])
def test_too_few_groups_are_refused(pixels):
    with pytest.raises(HueflightError, match=f"{pixels} pixels in 4 lanes"):
        groups_of(pixels, 4)
