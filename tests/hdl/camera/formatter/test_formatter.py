# SPDX-License-Identifier: Apache-2.0
"""The formatter against the protocol's encoder, bit for bit."""

import numpy as np
import pytest
from amaranth.sim import Simulator

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.formatter.formatter import FrameFormatter
from hueflight_hdl.camera.formatter.reference import SensorFrame, expected_packets
from hueflight_hdl.camera.frame_format import BANKS, LANES, FormatError, FrameFormat
from hueflight_protocol import FrameFlags

OCCUPANCIES = (0.0, 1.0, 0.3, 0.7, 0.02, 0.93)

CORNERS = [
    FrameFormat(rows=1, cols=1, code_bits=1, lanes=1, run=8),
    FrameFormat(rows=1, cols=1, code_bits=16, lanes=8, run=4096, banks=2),
    FrameFormat(rows=3, cols=5, code_bits=16, lanes=8, run=8, banks=16),
    FrameFormat(rows=7, cols=3, code_bits=1, lanes=4, run=16),
    FrameFormat(rows=9, cols=1, code_bits=9, lanes=2, run=8, banks=2),
    FrameFormat(rows=1, cols=130, code_bits=9, lanes=8, run=64),
    FrameFormat(rows=5, cols=16, code_bits=8, lanes=8, run=72),
    FrameFormat(rows=4, cols=32, code_bits=9, lanes=8, run=64),
    FrameFormat(rows=4, cols=32, code_bits=9, lanes=4, run=64, geometry=255),
    FrameFormat(rows=4, cols=32, code_bits=9, lanes=2, run=64, clock_hz=0xFFFF_FFFF),
    FrameFormat(rows=4, cols=32, code_bits=9, lanes=1, run=64),
    FrameFormat(rows=11, cols=17, code_bits=15, lanes=8, run=104, banks=4),
]
"""Shortest and longest codes, runs and frames; runs of one group; last chunks of all kinds."""


def draw_frames(rng, form, draw_codes, occupancies=OCCUPANCIES):
    return [
        SensorFrame(
            draw_codes(rng, form, occupancy),
            {
                "timestamp": int(rng.integers(1 << 63)),
                "frame": int(rng.integers(1 << 63)),
                "periods": int(rng.integers(1 << 32)),
                "dropped": int(rng.integers(1 << 32)),
                "flags": int(FrameFlags.TEST_PATTERN | FrameFlags.TRIGGER_LOST),
                "step": int(rng.integers(1 << 16)),
                "capture": int(rng.integers(1 << 32)),
            },
        )
        for occupancy in occupancies
    ]


@pytest.mark.parametrize("number", range(len(CORNERS)))
def test_equals_encoder(number, step_through, draw_codes):
    form = CORNERS[number]
    frames = draw_frames(np.random.default_rng(number), form, draw_codes)
    expected = expected_packets(form, frames)
    got = step_through(
        form,
        frames,
        words=len(expected) // 8,
        sensor_pause=(0, 0.5, 0)[number % 3],
        link_pause=(0, 0, 0.6)[number % 3],
    )
    assert got == expected


def draw_format(rng):
    return FrameFormat(
        rows=int(rng.integers(1, 14)),
        cols=int(rng.integers(1, 20)),
        code_bits=int(rng.integers(1, 17)),
        lanes=int(rng.choice(LANES)),
        run=8 * int(rng.integers(1, 10)),
        banks=int(rng.choice(BANKS)),
        geometry=int(rng.integers(256)),
    )


def check_random(seed, step_through, draw_codes):
    """A random format; filters, aborts, pauses on both sides and a change of filters at will."""
    rng = np.random.default_rng(seed)
    form = draw_format(rng)
    mask = rng.random((form.rows, form.cols)) < 0.2
    frames = []
    for frame in draw_frames(rng, form, draw_codes, rng.permutation(OCCUPANCIES)):
        filters = {
            "mask": int(rng.integers(2)),
            "roi": int(rng.integers(2)),
            "gate": int(rng.integers(2)),
            "rows": draw_window(rng, form.rows),
            "cols": draw_window(rng, form.cols),
            "codes": draw_window(rng, 1 << form.code_bits),
        }
        aborts = form.beats > 1 and rng.random() < 0.3
        abort_after = int(rng.integers(1, form.beats)) if aborts else None
        frames.append(SensorFrame(frame.codes, frame.info, filters, abort_after))
    expected = expected_packets(form, frames, mask)
    got = step_through(
        form,
        frames,
        words=len(expected) // 8,
        seed=seed,
        sensor_pause=rng.choice([0, 0.4]),
        link_pause=rng.choice([0, 0.4, 0.8]),
        mask=mask,
    )
    assert got == expected, form


def draw_window(rng, count):
    """Mostly a window inside; now and then one that is void, or reaches beyond."""
    first, last = (int(value) for value in np.sort(rng.integers(0, count, 2)))
    kind = rng.integers(6)
    if kind == 0:
        return {"first": min(last + 1, 0xFFFF), "last": first}
    if kind == 1:
        return {"first": first, "last": 0xFFFF}
    if kind == 2:
        return {"first": 0xFFFF, "last": 0xFFFF}
    return {"first": first, "last": last}


@pytest.mark.parametrize("seed", range(6))
def test_random_formats_and_filters(seed, step_through, draw_codes):
    check_random(seed, step_through, draw_codes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 160))
def test_many_random_formats_and_filters(seed, step_through, draw_codes):
    check_random(seed, step_through, draw_codes)


@pytest.mark.parametrize("lanes", LANES)
def test_abort_after_every_beat(lanes, step_through, draw_codes):
    form = FrameFormat(rows=3, cols=8, code_bits=9, lanes=lanes, run=16, banks=2)
    rng = np.random.default_rng(lanes)
    frames = [
        SensorFrame(draw_codes(rng, form, 0.6), abort_after=abort_after)
        for beat in range(1, form.beats)
        for abort_after in (beat, None)
    ]
    expected = expected_packets(form, frames)
    got = step_through(form, frames, words=len(expected) // 8, link_pause=0.3)
    assert got == expected


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"lanes": 3}, "lanes = 3"),
        ({"banks": 5}, "banks = 5"),
        ({"run": 12}, "run = 12"),
        ({"code_bits": 17}, "code_bits = 17"),
        ({"rows": 1024, "cols": 1024, "run": 8}, "chunks"),
        ({"geometry": 300}, "geometry"),
    ],
)
def test_impossible_formats_are_refused(wrong, message):
    with pytest.raises(FormatError, match=message):
        FrameFormat(**wrong)


@pytest.mark.parametrize(("run", "banks"), [(32, 4), (32, 8), (64, 2), (64, 4)])
def test_an_empty_frame_waits_for_banks_where_a_camera_is_refused(run, banks):
    form = FrameFormat(rows=24, cols=16, code_bits=6, lanes=8, run=run, banks=banks)
    dut, waits = FrameFormatter(form), []

    async def sensor(ctx):
        ctx.set(dut.o.ready, 1)
        ctx.set(dut.beats.valid, 1)
        while sum(not wait for wait in waits) < form.beats:
            _, _, ready = await ctx.tick().sample(dut.beats.ready)
            waits.append(not ready)

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(sensor)
    simulator.run()
    if not any(waits):
        CameraConfig(form=form)
        return
    with pytest.raises(FormatError, match=f"banks = {banks}: must be"):
        CameraConfig(form=form)
