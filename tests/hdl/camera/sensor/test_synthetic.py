# SPDX-License-Identifier: Apache-2.0
"""The synthetic sensor against its model, and its model against what it promises."""

from itertools import islice

import numpy as np
import pytest
from amaranth.sim import Simulator

from hueflight_hdl.camera.frame_format import FormatError, FrameFormat
from hueflight_hdl.camera.sensor.reference import synthetic_frames
from hueflight_hdl.camera.sensor.scene import Scene, default_scene
from hueflight_hdl.camera.sensor.synthetic import LATENCY, SyntheticSensor
from hueflight_protocol.camera_map import SyntheticSource

FORMATS = [
    FrameFormat(rows=16, cols=24, lanes=8, run=64),
    FrameFormat(rows=5, cols=7, lanes=4, run=8, code_bits=16),
    FrameFormat(rows=9, cols=3, lanes=8, run=8, code_bits=7),
    FrameFormat(rows=2, cols=9, lanes=1, run=8, code_bits=4),
]
FRAMES = 3


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: f"{form.rows}x{form.cols}x{form.lanes}")
@pytest.mark.parametrize("source", SyntheticSource, ids=lambda source: source.name)
def test_equals_model(form, source):
    scene = default_scene(form)
    dut = SyntheticSensor(form, scene)
    codes, marks = [], []

    async def camera(ctx):
        settings = {"source": source, "occupancy": 30000, "seed": 0xDEADBEEF}
        ctx.set(dut.settings, settings | {"delay_start": 9, "delay_step": 0x10000 - 5})
        for _ in range(2):  # a second capture begins again with the same frames
            ctx.set(dut.began, 1)
            await ctx.tick()
            ctx.set(dut.began, 0)
            for _ in range(FRAMES):
                ctx.set(dut.port.read, 1)
                await ctx.tick()
                ctx.set(dut.port.read, 0)
                await ctx.tick().repeat(form.beats + LATENCY)

    async def formatter(ctx):
        beats = dut.port.beats
        async for _, _, valid, beat in ctx.tick().sample(beats.valid, beats.payload):
            if valid:
                codes.append(list(beat.codes))
                marks.append((beat.first, beat.row, beat.last))

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_process(formatter)
    simulator.add_testbench(camera)
    simulator.run()

    got = np.array(codes).reshape(2, FRAMES, -1)[:, :, : form.pixels]
    model = synthetic_frames(
        form, source, seed=0xDEADBEEF, occupancy=30000, delay_start=9, delay_step=-5, scene=scene
    )
    expected = np.array(list(islice(model, FRAMES))).reshape(FRAMES, -1)
    np.testing.assert_array_equal(got[0], expected)
    np.testing.assert_array_equal(got[1], expected)

    pixel = np.arange(form.beats * form.lanes).reshape(form.beats, -1)
    begins_row = ((pixel % form.cols == 0) & (pixel < form.pixels)).any(axis=1)
    first, row, last = np.array(marks).reshape(2 * FRAMES, form.beats, 3).transpose(2, 0, 1)
    assert (first == (np.arange(form.beats) == 0)).all()
    assert (last == (np.arange(form.beats) == form.beats - 1)).all()
    assert (row == begins_row).all()


@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.7, 1.0])
def test_random_codes_have_the_occupancy_asked_for(share):
    form = FrameFormat()
    occupancy = min(round(share * 65536), 65535)
    codes = np.array(list(islice(synthetic_frames(form, 1, seed=3, occupancy=occupancy), 20)))
    lit = (codes != 0).mean()
    # a fixed seed; for independent bits four standard deviations are 1 in 16 000
    assert abs(lit - occupancy / 65536) < 4 * np.sqrt(0.25 / codes.size)
    if share > 0:
        # all codes come; 0 is taken as 1, so that 1 comes twice as often
        counts = np.bincount(codes[codes != 0], minlength=512)[1:]
        expected = counts.sum() / 512 * np.array([2, *[1] * 510])
        chi = ((counts - expected) ** 2 / expected).sum()
        assert chi < 510 + 5 * np.sqrt(2 * 510)


def test_counter_counts():
    form = FrameFormat(rows=3, cols=5, run=8, code_bits=3)
    frames = list(islice(synthetic_frames(form, 0), 2))
    np.testing.assert_array_equal(frames[1].reshape(-1), (np.arange(15) + 1) % 8)


def test_scene_has_bands_and_depth():
    form = FrameFormat()
    scene = default_scene(form)
    counts = np.zeros((2, 512))
    regions = (slice(0, 24), slice(48, 128)), (slice(96, 104), slice(64, 72))  # wall, ball
    for frame in islice(synthetic_frames(form, 2, scene=scene), 25):
        for count, region in zip(counts, regions, strict=True):
            count += np.bincount(frame[region].reshape(-1), minlength=512)
    counts[:, 0] = 0
    wall, ball = counts

    smooth = np.convolve(np.tile(wall, 3), np.ones(9) / 9, "same")[512:1024]
    high = smooth > smooth.max() / 2
    assert np.count_nonzero(high & ~np.roll(high, 1)) == 9  # white: every band is there

    nearer = scene.depth[0, 8] - scene.depth[12, 8]
    assert np.argmax([np.dot(np.roll(ball, -k), wall) for k in range(48)]) == nearer


def test_scenes_that_do_not_fit_are_refused():
    form = FrameFormat()
    scene = default_scene(form)
    with pytest.raises(FormatError, match="blocks"):
        scene.check(FrameFormat(rows=8, cols=8, run=8))
    with pytest.raises(FormatError, match="does not fit 8 bits"):
        scene.check(FrameFormat(code_bits=8))
    with pytest.raises(FormatError, match="depth"):
        Scene(scene.material, scene.depth + np.uint8(60), scene.outcomes)
