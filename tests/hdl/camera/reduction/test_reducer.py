# SPDX-License-Identifier: Apache-2.0
"""The reduction from the sensor's beats to finished packets, in Amaranth's simulator."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped
from amaranth.sim import Simulator

from hueflight_hdl.camera.formatter.reference import frame_beats
from hueflight_hdl.camera.formatter.trailer import TrailerWriter
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.reduction.picture_writer import plan_blocks
from hueflight_hdl.camera.reduction.reducer import Reducer, check_room, offset_group
from hueflight_hdl.link.packet_word import WORD_LAYOUT
from hueflight_hdl.testbench.camera import frame_marks
from hueflight_hdl.testbench.camera_sums import packets_of, pictures_of
from hueflight_protocol import FrameFlags, ReductionMode, ReductionRoom, encode_sums
from hueflight_protocol.errors import HueflightError
from hueflight_protocol.reduction import ReductionTables, offsets_hash, reduce_codes


class Bench(wiring.Component):
    """A reducer whose packets are completed; `take` lets a word go."""

    def __init__(self, form, room, packet_words):
        self.reducer = Reducer(form, room, patience=50, packet_words=packet_words)
        super().__init__(
            {"take": In(1), "o": Out(stream.Signature(WORD_LAYOUT, always_ready=True))}
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.reducer = reducer = self.reducer
        m.submodules.trailer = trailer = TrailerWriter()
        connect(m, trailer.o, flipped(self.o))
        m.d.comb += [
            reducer.o.ready.eq(self.take),
            trailer.i.valid.eq(reducer.o.valid & self.take),
            trailer.i.payload.eq(reducer.o.payload),
        ]
        return m


@dataclass
class Trial:
    """What a reducer is given: tables, frames and how beats and words come."""

    form: FrameFormat
    tables: ReductionTables
    offsets: np.ndarray
    frames: np.ndarray
    per_picture: int
    sums: int
    packet_words: int
    pause: float = 0.0
    stall: float = 0.0
    gap: int = 10
    cut: dict[int, int] = field(default_factory=dict)  # frame: beats that come of it
    mask: np.ndarray | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))


async def until(ctx: Any, holds: Any) -> None:
    for _ in range(20_000):
        if holds():
            return
        await ctx.tick()
    raise AssertionError("it never happened")


def run(trial: Trial) -> bytes:
    form, tables, rng = trial.form, trial.tables, trial.rng
    group = offset_group(form.lanes)
    room = ReductionRoom(trial.sums, tables.entry_bits, max(tables.widths), group)
    bench = Bench(form, room, trial.packet_words)
    dut, words = bench.reducer, []
    pixels = np.zeros(-(-form.pixels // 32) * 32, np.uint8)
    if trial.mask is not None:
        pixels[: form.pixels] = trial.mask
    memory = np.packbits(pixels, bitorder="little").view("<u4")

    async def load(ctx: Any) -> None:
        for code in range(1 << form.code_bits):
            entries = [*tables.entries[:, code].tolist(), *[0] * (trial.sums - tables.sums)]
            ctx.set(dut.store_code, code)
            ctx.set(dut.entries, entries)
            ctx.set(dut.store, 1)
            await ctx.tick()
        ctx.set(dut.store, 0)
        for number, some in enumerate(trial.offsets.reshape(-1, group).tolist()):
            ctx.set(dut.move_group, number)
            ctx.set(dut.offsets, [offset & 0xFF for offset in some])
            ctx.set(dut.move, 1)
            await ctx.tick()
            ctx.set(dut.move, 0)
            await ctx.tick().repeat(group // form.lanes)
        ctx.set(dut.move, 1)  # beyond the last group
        ctx.set(dut.move_group, len(trial.offsets) // group)
        ctx.set(dut.offsets, [99] * group)
        await ctx.tick()
        ctx.set(dut.move, 0)
        widths = [*tables.widths, *[0] * (trial.sums - tables.sums)]
        ctx.set(dut.asked, {
            "mode": ReductionMode.SUMS, "sums": tables.sums, "frames": trial.per_picture,
            "first": tables.first, "last": tables.last, "tables": tables.hash,
            "moved": offsets_hash(trial.offsets), "widths": widths,
        })  # fmt: skip
        ctx.set(dut.filters.mask, trial.mask is not None)
        ctx.set(dut.capture, 0xCAFE)
        await ctx.tick().repeat(4)

    async def sensor(ctx: Any) -> None:
        await load(ctx)
        ctx.set(dut.began, 1)
        await ctx.tick()
        ctx.set(dut.began, 0)
        marks = frame_marks(form).tolist()
        beats = dut.sensor.payload
        for number, codes in enumerate(trial.frames):
            ctx.set(dut.about.periods, 100 + number)
            ctx.set(dut.about.flags, FrameFlags.TRIGGER_LOST if number % 7 == 3 else 0)
            ctx.set(dut.read, 1)
            await ctx.tick()
            ctx.set(dut.read, 0)
            some = frame_beats(form, codes.reshape(form.rows, form.cols))
            for beat in range(trial.cut.get(number, form.beats)):
                while rng.random() < trial.pause:
                    await ctx.tick()
                ctx.set(beats.codes, some[beat].tolist())
                ctx.set(beats.first, marks[beat] & 1)
                ctx.set(beats.row, marks[beat] >> 1 & 1)
                ctx.set(beats.last, marks[beat] >> 2 & 1)
                ctx.set(dut.sensor.valid, 1)
                await ctx.tick()
                ctx.set(dut.sensor.valid, 0)
            await ctx.tick().repeat(60 if number in trial.cut else trial.gap)
            await until(ctx, lambda: not ctx.get(dut.busy))
        ctx.set(dut.ended, 1)
        await ctx.tick()
        ctx.set(dut.ended, 0)
        await ctx.tick()
        await until(ctx, lambda: ctx.get(dut.idle))
        await ctx.tick().repeat(10)

    async def mask_memory(ctx: Any) -> None:
        async for _, _, address in ctx.tick().sample(dut.mask_address):
            ctx.set(dut.mask_data, int(memory[address]))

    async def link(ctx: Any) -> None:
        while True:
            ctx.set(bench.take, int(rng.random() >= trial.stall))
            _, _, valid, word = await ctx.tick().sample(bench.o.valid, bench.o.payload)
            if valid:
                words.append(word.data)

    simulator = Simulator(bench)
    simulator.add_clock(1e-8)
    for process in (mask_memory, link):
        simulator.add_testbench(process, background=True)
    simulator.add_testbench(sensor)
    simulator.run()
    return np.array(words, "<u8").tobytes()


def draw(
    seed: int, *, lanes: int, rows: int, cols: int, frames: int = 12, zero: bool = False, **options
) -> Trial:
    """A trial at random; with `zero`, code 0 stands for a time as well."""
    rng = np.random.default_rng(seed)
    form = FrameFormat(rows=rows, cols=cols, code_bits=4 + seed % 2, lanes=lanes, run=8)
    codes, count = 1 << form.code_bits, int(rng.integers(1, 4))
    widths = tuple(rng.integers(1, 14, count).tolist())
    first, last = (1 + seed % 2) * (not zero), codes - 1 - seed % 3
    entries = np.zeros((count, codes), np.uint16)
    entries[:, first : last + 1] = rng.integers(0, 1 << (2 + seed % 4), (count, last - first + 1))
    entries[0, first] = 1
    reach = last - first
    return Trial(
        form, ReductionTables(entries, widths, first, last),
        rng.integers(-reach, reach + 1, form.pixels), rng.integers(0, codes, (frames, form.pixels)),
        per_picture=3, sums=count + seed % 2, packet_words=32, rng=rng, **options,
    )  # fmt: skip


def check(trial: Trial) -> list:
    """Compare all that packets say with the definition; return the pictures."""
    data = run(trial)
    parts = packets_of(data)
    assert b"".join(encode_sums(part) for part in parts) == data
    tables = trial.tables
    numbers = {part.first_pixel: 0 for part in parts}  # the next picture of each block
    starts = dict.fromkeys(numbers, 0)  # and the first frame of its window
    for part in parts:
        here = slice(part.first_pixel, part.first_pixel + len(part.values))
        assert part.picture == numbers[part.first_pixel]
        numbers[part.first_pixel] += 1
        start = starts[part.first_pixel]
        stop = starts[part.first_pixel] = start + part.frames + part.missed
        assert stop <= len(trial.frames)
        early = [n for n in range(start, stop) if trial.cut.get(n)]  # that ended early
        added = [n for n in range(early[-1] + 1 if early else start, stop) if n not in trial.cut]
        assert part.frames == len(added)
        codes = trial.frames[added][:, here]
        mask = None if trial.mask is None else trial.mask[here]
        expected = reduce_codes(codes, tables, offsets=trial.offsets[here], mask=mask)
        np.testing.assert_array_equal(part.values, expected)
        timed = (codes >= tables.first) & (codes <= tables.last)
        if mask is not None:
            timed &= mask == 0
        flags = FrameFlags.TRIGGER_LOST if any(n % 7 == 3 for n in added) else FrameFlags.NONE
        if mask is not None and added:
            flags |= FrameFlags.MASKED
        assert (part.photons, part.flags) == (timed.sum(), flags)
        assert (part.tables, part.offsets) == (tables.hash, offsets_hash(trial.offsets))
        assert part.header.capture == 0xCAFE
        if added:
            assert part.periods == 100 + added[-1]
    pictures = list(pictures_of(parts))
    assert all(picture.complete for picture in pictures)
    assert set(starts.values()) == {len(trial.frames)}, "frames are in no picture"
    return pictures


@pytest.mark.parametrize(
    ("seed", "lanes", "shape", "options"),
    [
        pytest.param(1, 1, (3, 4), {}, marks=pytest.mark.slow),
        (2, 2, (4, 5), {"pause": 0.3, "stall": 0.5}),
        pytest.param(3, 4, (6, 6), {"stall": 0.9}, marks=pytest.mark.slow),
        pytest.param(4, 8, (8, 7), {"pause": 0.5, "gap": 3}, marks=pytest.mark.slow),
    ],
)
def test_packets_are_those_of_the_definition(seed, lanes, shape, options):
    pictures = check(draw(seed, lanes=lanes, rows=shape[0], cols=shape[1], **options))
    assert len(pictures) >= 2
    assert not any(picture.missed.any() for picture in pictures)


@pytest.mark.parametrize("zero", [pytest.param(False, marks=pytest.mark.slow), True])
def test_masked_pixels_add_nothing_and_packets_say_so(zero):
    trial = draw(5, lanes=4, rows=4, cols=8, zero=zero)
    check(replace(trial, mask=(trial.rng.random(32) < 0.4).astype(np.uint8)))


@pytest.mark.slow
def test_a_frame_that_ends_early_takes_its_windows_with_it():
    # one packet a picture, which ends with each third frame; the fifth frame ends early, the
    # seventh never begins
    trial = replace(draw(6, lanes=4, rows=4, cols=7, frames=11, gap=700), cut={4: 3, 6: 0})
    assert plan_of(trial).blocks == 1
    pictures = check(trial)
    assert [int(picture.frames.max()) for picture in pictures] == [3, 2, 3]
    assert [int(picture.missed.max()) for picture in pictures] == [0, 3, 0]


def plan_of(trial: Trial):
    room = ReductionRoom(trial.sums, 1, max(trial.tables.widths), offset_group(trial.form.lanes))
    return plan_blocks(trial.form, room, trial.packet_words)


@pytest.mark.slow
@pytest.mark.parametrize("cut", [{}, {5: 3, 11: 1, 12: 40, 30: 58, 31: 59}])
@pytest.mark.parametrize(("gap", "stall"), [(3, 0.0), (400, 0.6)])
def test_pictures_of_many_packets(cut, gap, stall):
    trial = draw(7, lanes=2, rows=10, cols=12, frames=40, gap=gap, stall=stall)
    trial = replace(trial, packet_words=16, cut=cut, per_picture=8)
    assert plan_of(trial).blocks > 2
    check(trial)


@pytest.mark.parametrize(
    ("shape", "group", "words", "why"),
    [
        ((5, 5), 4, 32, "25 pixels"),
        ((8, 8), 8, 32, "group = 8: must be 4"),
        ((4, 4), 4, 32, "at least 7"),
        ((8, 8), 4, 16, "packet_words = 16"),
        ((8, 8), 4, 48, "packet_words = 48"),
    ],
)
def test_what_does_not_fit_is_refused(shape, group, words, why):
    form = FrameFormat(rows=shape[0], cols=shape[1], lanes=4, run=8)
    with pytest.raises(HueflightError, match=why):
        check_room(form, ReductionRoom(12, 8, 32, group), packet_words=words)
