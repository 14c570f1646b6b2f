# SPDX-License-Identifier: Apache-2.0
"""Drives a formatter clock by clock, in Amaranth's simulator."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from amaranth.sim import Simulator

from hueflight_hdl.camera.formatter.formatter import FrameFormatter
from hueflight_hdl.camera.formatter.pixel_filter import MASK_WORD
from hueflight_hdl.camera.formatter.reference import SensorFrame, frame_beats
from hueflight_hdl.camera.frame_format import FrameFormat

Message = Sequence[tuple[int, int, int]]
"""Words of 64 bits, each with its marks: check, last."""


@pytest.fixture(scope="session")
def step_through() -> Callable[..., bytes]:
    """Function that runs frames through a formatter and returns the bytes of `words` words."""
    return _step_through


@pytest.fixture(scope="session")
def draw_codes() -> Callable[..., np.ndarray]:
    """Function that draws a frame of which a share of pixels has a code other than 0."""

    def draw(rng: np.random.Generator, form: FrameFormat, occupancy: float) -> np.ndarray:
        shape = form.rows, form.cols
        codes = rng.integers(1, 1 << form.code_bits, shape, np.uint16)
        return np.where(rng.random(shape) < occupancy, codes, np.uint16(0))

    return draw


def _step_through(
    form: FrameFormat,
    frames: Sequence[SensorFrame],
    *,
    words: int,
    seed: int = 0,
    sensor_pause: float = 0.0,
    link_pause: float = 0.0,
    mask: np.ndarray | None = None,
    messages: Sequence[Message] = (),
) -> bytes:
    dut = FrameFormatter(form, buffer_words=32)
    rng = np.random.default_rng(seed)
    received: list[int] = []
    pixels = np.zeros(-(-form.pixels // MASK_WORD) * MASK_WORD, np.uint8)
    if mask is not None:
        pixels[: form.pixels] = mask.reshape(-1)
    memory = np.packbits(pixels, bitorder="little").view("<u4")

    async def sensor(ctx: Any) -> None:
        for frame in frames:
            ctx.set(dut.info, frame.info)
            ctx.set(dut.filters, frame.filters)
            await ctx.tick()  # filters are taken over one clock before the first beat
            for codes in frame_beats(form, frame.codes)[: frame.abort_after]:
                while rng.random() < sensor_pause:
                    await ctx.tick()
                ctx.set(dut.beats.payload, codes.tolist())
                ctx.set(dut.beats.valid, 1)
                await ctx.tick().until(dut.beats.ready)
                ctx.set(dut.beats.valid, 0)
                # what comes after the first beat must not matter
                ctx.set(dut.info, {"frame": 0xBAD, "capture": 0xBAD})
                ctx.set(dut.filters, {"gate": 1, "roi": 1, "mask": 1})
            if frame.abort_after is not None:
                ctx.set(dut.abort, 1)
                await ctx.tick()
                ctx.set(dut.abort, 0)

    async def mask_memory(ctx: Any) -> None:
        async for _, _, address in ctx.tick().sample(dut.mask_address):
            ctx.set(dut.mask_data, int(memory[address]))

    async def others(ctx: Any) -> None:
        for message in messages:
            for data, check, last in message:
                ctx.set(dut.messages.payload, {"data": data, "check": check, "last": last})
                ctx.set(dut.messages.valid, 1)
                await ctx.tick().until(dut.messages.ready)
                ctx.set(dut.messages.valid, 0)

    async def link(ctx: Any) -> None:
        idle = 0
        held = None
        while len(received) < words:
            ready = int(rng.random() >= link_pause)
            ctx.set(dut.o.ready, ready)
            _, _, valid, word = await ctx.tick().sample(dut.o.valid, dut.o.payload)
            assert held is None or (valid and word.data == held), "changed while it waited"
            held = word.data if valid and not ready else None
            idle += 1
            if valid and ready:
                received.append(word.data)
                idle = 0
            assert idle < 10_000, f"{len(received)} of {words} words came"
        ctx.set(dut.o.ready, 1)
        for _ in range(50):
            _, _, valid = await ctx.tick().sample(dut.o.valid)
            assert not valid, "more words than expected"

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    for process in (sensor, mask_memory, others):
        simulator.add_testbench(process, background=True)
    simulator.add_testbench(link)
    simulator.run()
    return np.array(received, "<u8").tobytes()
