# SPDX-License-Identifier: Apache-2.0
"""The reduction core against its twin, bit for bit, in Amaranth's simulator."""

from dataclasses import dataclass, field, replace
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


@dataclass
class Part:
    """A block of a picture, as the core gives it."""

    picture: int
    first: int
    frames: int
    missed: int
    photons: int
    flags: int
    sums: np.ndarray


@dataclass
class Trial:
    """What a core is given, and how fast it is read."""

    frames: np.ndarray
    per_picture: int
    pause: float = 0.0  # probability of a clock without a beat
    gap: int = 0  # clocks between frames
    slow: int = 0  # clocks before a block is fetched
    slow_blocks: int = 1000  # blocks that are fetched so late
    cut: dict[int, int] = field(default_factory=dict)  # frame: beats after which it ends
    lost: dict[int, int] = field(default_factory=dict)  # frame: frames that are lost before it
    clear: int = -1  # frame before which all begins anew
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))


def run(dut, tables, offsets, trial: Trial) -> list[Part]:
    """Return the blocks that the core gives."""
    lanes, rng, parts = dut.lanes, trial.rng, []

    async def load(ctx: Any) -> None:
        ctx.set(dut.frames_per_picture, trial.per_picture)
        ctx.set(dut.first, tables.first)
        ctx.set(dut.last, tables.last)
        ctx.set(dut.kept, -1)
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

    async def pulse(ctx: Any, signal: Any) -> None:
        ctx.set(signal, 1)
        await ctx.tick()
        ctx.set(signal, 0)

    async def drain(ctx: Any) -> None:
        await ctx.tick().repeat(20)
        ctx.set(dut.finish, 1)
        await ctx.tick()
        for _ in range(20_000):
            if ctx.get(dut.drained):
                break
            await ctx.tick()
        else:
            raise AssertionError("it never ends")
        ctx.set(dut.finish, 0)

    async def sensor(ctx: Any) -> None:
        await load(ctx)
        await pulse(ctx, dut.clear)
        for number, codes in enumerate(trial.frames):
            if number == trial.clear:
                await ctx.tick().repeat(20)
                await pulse(ctx, dut.clear)
            for _ in range(trial.lost.get(number, 0)):
                await pulse(ctx, dut.lost)
            ctx.set(dut.flags, 1 << number % 5)
            for group in range(trial.cut.get(number, dut.groups)):
                while rng.random() < trial.pause:
                    ctx.set(dut.valid, 0)
                    await ctx.tick()
                ctx.set(dut.valid, 1)
                ctx.set(dut.codes, [int(c) for c in codes[group * lanes :][:lanes]])
                ctx.set(dut.first_beat, group == 0)
                ctx.set(dut.last_beat, group == dut.groups - 1)
                await ctx.tick()
            ctx.set(dut.valid, 0)
            ctx.set(dut.last_beat, 0)
            if number in trial.cut:
                await pulse(ctx, dut.discard)
            for _ in range(trial.gap):
                await ctx.tick()
        await drain(ctx)

    async def reader(ctx: Any) -> None:
        while True:
            while not ctx.get(dut.ready):
                await ctx.tick()
            await ctx.tick().repeat(1 + (trial.slow if len(parts) < trial.slow_blocks else 0))
            found, block = [], ctx.get(dut.block)
            for number in range(block["groups"] * lanes):
                ctx.set(dut.read_group, number // lanes)
                ctx.set(dut.read_lane, number % lanes)
                await ctx.tick().repeat(dut.read_clocks)
                found.append([ctx.get(dut.pixel)[f"sum{k}"] for k in range(tables.sums)])
            window = block["window"]
            parts.append(Part(
                block["picture"], block["first_group"] * lanes, window["frames"],
                block["missed"], window["photons"], window["flags"], np.array(found, np.uint64),
            ))  # fmt: skip
            await pulse(ctx, dut.done)
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(sensor)
    simulator.add_testbench(reader, background=True)
    simulator.run()
    return parts


def check(parts: list[Part], trial: Trial, tables, offsets) -> None:
    """Compare blocks with the definition, each over the frames that its own numbers name."""
    size = trial.frames.shape[1]
    came: list[tuple[bool, int]] = []  # of each that came: whether it is whole, and its number
    for number in range(len(trial.frames)):
        came += [(False, -1)] * trial.lost.get(number, 0) + [(number not in trial.cut, number)]
    numbers = {part.first: 0 for part in parts}
    starts = dict.fromkeys(numbers, 0)
    for part in parts:
        here = slice(part.first, part.first + len(part.sums))
        assert part.picture == numbers[part.first]
        numbers[part.first] += 1
        start = starts[part.first]
        stop = starts[part.first] = start + part.frames + part.missed
        window = came[start:stop]
        assert len(window) == part.frames + part.missed
        # those after the last one that ended early
        early = [n for n, (whole, number) in enumerate(window) if not whole and number >= 0]
        added = [number for whole, number in window[early[-1] + 1 if early else 0 :] if whole]
        assert len(added) == part.frames
        codes = trial.frames[added][:, here]
        expected = reduce_codes(codes, tables, offsets=offsets[here])
        np.testing.assert_array_equal(part.sums, expected)
        assert part.photons == ((codes >= tables.first) & (codes <= tables.last)).sum()
        assert part.flags == sum({1 << number % 5 for number in added})
    pixels = {part.first: len(part.sums) for part in parts}
    assert sum(pixels.values()) == size
    assert set(starts.values()) == {len(came)}, "all that came is told"


CASES = [
    # seed, lanes, widths, entry bits, groups of a block, options
    (0, 1, (4, 9, 6), 4, 1, {}),
    (1, 2, (12, 5), 8, 3, {"pause": 0.3, "slow": 3}),
    (2, 4, (1, 32, 7, 10), 6, 4, {"slow": 90, "gap": 2}),
    (3, 8, (10, 10, 10), 3, 2, {"pause": 0.6, "slow": 40}),
    (4, 2, (8, 9), 3, 99, {"gap": 30}),
    (5, 2, (8, 9), 3, 3, {"cut": {4: 3, 9: 5, 10: 1, 11: 0, 30: 7}, "gap": 3}),
    (6, 1, (8, 9), 3, 3, {"cut": {4: 4, 20: 2}, "gap": 60, "lost": {0: 2, 5: 1, 7: 4, 20: 1}}),
    (11, 1, (8, 9), 3, 3, {"pause": 0.93, "cut": {8: 5}}),  # sums are looked at between frames only
    (7, 4, (8, 9), 3, 2, {"cut": {4: 4, 20: 6}, "pause": 0.2, "lost": {5: 1, 20: 1}, "slow": 20}),
]


def made(seed, lanes, widths, entry_bits, block_groups, options):
    rng = np.random.default_rng(seed)
    code_bits = 4 + seed % 3
    tables = random_tables(rng, code_bits, widths, entry_bits)
    pixels = lanes * int(rng.integers(8, 14))
    dut = ReductionCore(pixels=pixels, lanes=lanes, code_bits=code_bits, widths=widths,
                        entry_bits=entry_bits, block_groups=block_groups)  # fmt: skip
    frames = rng.integers(0, 1 << code_bits, (37, pixels))
    reach = min(127, tables.last - tables.first)
    offsets = rng.integers(-reach, reach + 1, pixels)
    per_picture = dut.plan.blocks + int(rng.integers(0, 6))
    return dut, tables, offsets, Trial(frames, per_picture, rng=rng, **options)


@pytest.mark.parametrize("case", CASES)
def test_sums_are_those_of_the_definition(case):
    dut, tables, offsets, trial = made(*case)
    parts = run(dut, tables, offsets, trial)
    check(parts, trial, tables, offsets)
    firsts = list(dict.fromkeys(part.first for part in parts))
    assert firsts == sorted(firsts)
    assert [part.first for part in parts] == firsts * (len(parts) // len(firsts))


def test_windows_are_as_long_as_asked_where_they_are_fetched_in_time():
    dut, tables, offsets, trial = made(8, 2, (6, 7), 3, 3, {"gap": 40})
    trial.per_picture = 2 * dut.plan.blocks + 1
    parts = run(dut, tables, offsets, trial)
    check(parts, trial, tables, offsets)
    last = max(part.picture for part in parts)
    whole = [part.frames for part in parts if 0 < part.picture < last - 1]
    assert whole
    assert set(whole) == {trial.per_picture}
    assert max(part.frames for part in parts) == trial.per_picture


def test_windows_go_on_until_they_are_fetched():
    dut, tables, offsets, trial = made(
        9, 2, (6, 7), 3, 3, {"slow": 60, "slow_blocks": 3, "gap": 20}
    )
    trial.per_picture = dut.plan.blocks
    parts = run(dut, tables, offsets, trial)
    check(parts, trial, tables, offsets)
    last = max(part.picture for part in parts)
    some = [part.frames for part in parts if 0 < part.picture < last - 1]
    assert some
    assert trial.per_picture <= min(some) < max(some)


def test_a_capture_begins_anew():
    dut, tables, offsets, trial = made(10, 2, (6, 7), 3, 3, {"gap": 3})
    trial.clear = 20
    parts = run(dut, tables, offsets, trial)
    again = max(number for number, part in enumerate(parts) if part.picture == part.first == 0)
    assert again > 0
    check(parts[again:], replace(trial, frames=trial.frames[20:]), tables, offsets)


@pytest.mark.parametrize("pixels", [20, 26])
def test_too_few_groups_are_refused(pixels):
    with pytest.raises(HueflightError, match=f"{pixels} pixels in 4 lanes"):
        groups_of(pixels, 4)
