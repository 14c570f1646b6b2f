# SPDX-License-Identifier: Apache-2.0
"""The reduction at the sensor's size, 192×128, compiled: bit-exactness and rate."""

from functools import lru_cache

import numpy as np
import pytest

from hueflight_hdl.camera.formatter.reference import filter_codes
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.reduction.reducer import offset_group
from hueflight_hdl.testbench.formatter_rate import OCCUPANCIES, random_codes
from hueflight_hdl.testbench.reducer import SimulatedReducer
from hueflight_protocol import PacketParser, ReductionRoom
from support.sums_reference import SumsReference, draw_offsets, draw_tables

LEAST_RATE = 18_600  # frames/s of the sensor
SCENES = 12  # frames that are drawn; each capture sends them in any order


def room(lanes):
    return ReductionRoom(sums=4, entry_bits=8, sum_bits=13, group=offset_group(lanes))


@pytest.fixture
def start(simulator):
    running = []

    def make(lanes):
        running.append(SimulatedReducer(FrameFormat(lanes=lanes), room(lanes)))
        return running[-1]

    yield make
    for reducer in running:
        reducer.close()


@lru_cache
def scenes(form, seed):
    """Frames of any occupancy, with bright and dark parts."""
    rng = np.random.default_rng(seed)
    shares = [0.0, 1.0, 0.05, 0.3, 0.9, *rng.random(SCENES - 5)]
    return [random_codes(rng, form, share) for share in shares]


def run(reducer, *, seed, frames):
    """Send a capture with everything at random and compare all packets; return its pictures."""
    rng = np.random.default_rng(seed)
    form, space = reducer.form, reducer.room
    tables = draw_tables(
        rng, code_bits=form.code_bits, sums=int(rng.integers(1, space.sums + 1)),
        entry_bits=space.entry_bits, sum_bits=space.sum_bits,
    )  # fmt: skip
    offsets = draw_offsets(rng, tables, form.pixels)
    filters, mask = {}, rng.random((form.rows, form.cols)) < 0.02
    if rng.random() < 0.5:
        filters = {
            "mask": 1,
            "gate": 1,
            "codes": {"first": 20, "last": int(rng.integers(400, 600))},
        }
    drawn = scenes(form, seed % 3)
    order = rng.integers(0, SCENES, frames)
    reducer.load(tables, offsets)
    reducer.begin(tables, offsets, frames=int(rng.integers(1, 60)), filters=filters, mask=mask)
    added = reducer.added
    at = 0
    while at < frames:  # long and short pauses of the sensor and of the link, in turn
        some = order[at : at + int(rng.integers(5, 40))]
        at += len(some)
        reducer.feed(
            (drawn[number] for number in some), rng=rng,
            sensor_pause=float(rng.choice([0, 0, 0.2, 0.6])),
            link_pause=float(rng.choice([0, 0.3, 0.9, 1])),
        )  # fmt: skip
    reducer.finish()
    assert reducer.added - added == frames

    left = [filter_codes(codes, filters, mask)[0].reshape(-1) for codes in drawn]
    reference = SumsReference(
        tables, offsets, [left[number] for number in order], (form.rows, form.cols)
    )
    parser = PacketParser()
    packets = [*parser.feed(reducer.packets()), *parser.finish()]
    report = parser.report
    assert report.damaged == report.skipped_bytes == 0
    reference.check_packets(packets)
    reference.check_end()
    assert reference.held == frames
    return reference.pictures


@pytest.mark.slow
@pytest.mark.parametrize(("lanes", "captures", "frames"), [(8, 5, 320), (4, 2, 120), (2, 2, 90)])
def test_thousands_of_frames_equal_the_twin(start, lanes, captures, frames):
    reducer = start(lanes)
    pictures = [run(reducer, seed=lanes + 10 * seed, frames=frames) for seed in range(captures)]
    assert min(pictures) >= 2


@pytest.mark.slow
def test_every_frame_is_added_at_the_full_rate(start):
    """Frames without a pause, at any occupancy, while pictures are read out."""
    reducer = start(8)
    rng = np.random.default_rng(1)
    tables = draw_tables(rng, code_bits=9, sums=4, entry_bits=8, sum_bits=13)
    offsets = draw_offsets(rng, tables, reducer.form.pixels)
    reducer.load(tables, offsets)
    reducer.begin(tables, offsets, frames=8)
    for occupancy in OCCUPANCIES:
        codes = random_codes(rng, reducer.form, occupancy)
        clocks, added = reducer.clocks, reducer.added
        reducer.feed([codes] * 30, rng=rng)
        rate = (reducer.added - added) * reducer.form.clock_hz / (reducer.clocks - clocks)
        assert rate >= LEAST_RATE
        assert rate == pytest.approx(32_500, rel=0.01)
    reducer.finish()
    assert reducer.added == 30 * len(OCCUPANCIES)
