# SPDX-License-Identifier: Apache-2.0
"""Sums of the emulated camera against the codes that it sends beside them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight as hf
import hueflight_protocol as hp
from hueflight.devices import Camera, DeviceError
from hueflight.devices.camera_controls import CameraControls
from hueflight.devices.reduction import Reduction, load_reduction
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport
from hueflight.ingest.picture_totals import PictureTotals
from hueflight_protocol.reduction import ReductionTables, offsets_hash, reduce_codes
from hueflight_protocol.typed_registers import camera as registers


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def camera_of(instrument: hf.Instrument, **options: int) -> tuple[Camera, CameraModel, Clock]:
    clock = Clock()
    bank = FrameBank.random(instrument.sensor, occupancy=0.4, frames=7)
    model = CameraModel(instrument.sensor, bank, now_s=clock, **options)
    camera = Camera(SimulatedTransport(model.handle), lambda size: SimulatedStream(model, size))
    return camera, model, clock


def tables_of(seed: int, sums: int, *, bits: int = 8, widths: int = 24) -> ReductionTables:
    rng = np.random.default_rng(seed)
    entries = rng.integers(0, 1 << bits, (sums, 512))
    entries[:, :3] = entries[:, 500:] = 0
    return ReductionTables(entries, tuple(rng.integers(4, widths, sums).tolist()), 3, 499)


@pytest.mark.parametrize(
    ("sums", "left_out"),
    [(1, {}), (7, {"masked": ((0, 1), (5, 7)), "gate": (40, 300)}), (32, {"rows": (1, 3)})],
)
def test_sums_are_those_of_the_codes_sent_beside_them(
    fast: hf.Instrument, sums: int, left_out: dict
) -> None:
    camera, _, clock = camera_of(fast)
    tables = tables_of(sums, sums)
    offsets = np.random.default_rng(1).integers(-127, 128, (6, 8))
    controls = CameraControls(reduction=Reduction(tables, 10, offsets, with_codes=True), **left_out)
    camera.configure(fast, controls)
    camera.start(capture=3, frame_limit=25)
    clock.now_s += 1
    parser, assembler = hp.PacketParser(), hp.PictureAssembler()
    contents = [packet.content for packet in parser.feed(camera.read(0.0))]
    frames = [one for one in contents if isinstance(one, hp.Frame)]
    parts = [one for one in contents if isinstance(one, hp.Sums)]
    pictures = [picture for part in parts if (picture := assembler.feed(part)) is not None]
    assert [frame.header.frame for frame in frames] == list(range(25))
    assert [picture.first.frames for picture in pictures] == [10, 10, 5]
    assert [picture.first.picture for picture in pictures] == [0, 1, 2]
    codes = np.array([frame.codes.reshape(-1) for frame in frames])
    for picture, first in zip(pictures, (0, 10, 20), strict=True):
        there = codes[first : first + 10]
        expected = reduce_codes(there, tables, offsets=offsets.reshape(-1))
        np.testing.assert_array_equal(picture.values.reshape(48, -1), expected)
        assert picture.first.photons == ((there >= 3) & (there <= 499)).sum()
        assert picture.first.tables == tables.hash
        assert picture.first.offsets == offsets_hash(offsets.reshape(-1))
        assert picture.first.header.capture == 3
        assert picture.first.flags == frames[0].header.flags
        assert picture.first.periods == frames[0].header.periods
    assert parser.report.missing == parser.report.damaged == 0


def test_kept_pictures_are_sent_in_turn(fast: hf.Instrument) -> None:
    """Whole ones; the last frames of a run are added up as always."""
    found: list[list[hp.SumsPicture]] = []
    for kept in (0, 2):
        camera, _, clock = camera_of(fast, kept_pictures=kept)
        camera.configure(fast, CameraControls(reduction=Reduction(tables_of(1, 3), 10)))
        camera.start(frame_limit=55)
        clock.now_s += 1
        parser, assembler = hp.PacketParser(), hp.PictureAssembler()
        contents = [one.content for one in parser.feed(camera.read(0.0))]
        parts = [assembler.feed(one) for one in contents if isinstance(one, hp.Sums)]
        found.append([picture for picture in parts if picture is not None])
        assert parser.report.missing == parser.report.damaged == 0
    made, sent = found
    assert [(one.first.picture, one.first.frames) for one in sent] == [
        (one.first.picture, one.first.frames) for one in made
    ]
    values = [one.values.tolist() for one in sent]
    assert [values.index(value) for value in values] == [0, 1, 0, 1, 0, 5]
    for number in (0, 1, 5):
        assert values[number] == made[number].values.tolist()


def test_the_next_run_sends_codes_again(fast: hf.Instrument) -> None:
    camera, _, clock = camera_of(fast)
    camera.configure(fast, CameraControls(reduction=Reduction(tables_of(1, 3), 4)))
    camera.start(frame_limit=8)
    clock.now_s += 1
    contents = [one.content for one in hp.PacketParser().feed(camera.read(0.0))]
    kinds = [type(one) for one in contents if not isinstance(one, hp.Status)]
    assert kinds == [hp.Event, hp.Sums, hp.Sums, hp.Event]
    assert camera.counters().frames_sent == 8
    camera.configure(fast)
    camera.start(frame_limit=2)
    clock.now_s += 1
    contents = [one.content for one in hp.PacketParser().feed(camera.read(0.0))]
    kinds = [type(one) for one in contents if not isinstance(one, hp.Status)]
    assert kinds == [hp.Event, hp.Frame, hp.Frame, hp.Event]


@given(st.lists(st.tuples(st.floats(0, 0.02), st.integers(1, 4000)), min_size=5, max_size=40))
@settings(max_examples=40, deadline=None)
def test_every_frame_is_in_a_picture_or_counted_as_missed(pulls: list[tuple[float, int]]) -> None:
    paper = hf.Instrument.load("paper").sensor
    sensor = type(paper)(rows=4, cols=8, code_bits=9, bin_width_ns=0.642, frame_rate_hz=5000.0)
    clock = Clock()
    bank = FrameBank.random(sensor, occupancy=0.5, frames=5)
    model = CameraModel(sensor, bank, buffer_bytes=3000, now_s=clock)
    camera = Camera(SimulatedTransport(model.handle), lambda size: SimulatedStream(model, size))
    load_reduction(camera.board, Reduction(tables_of(2, 5), 12), pixels=32)
    model.registers.store(registers.Exposure(625))
    model.registers.set("run", start=1)
    model._start()
    parser, packets = hp.PacketParser(), []
    for wait_s, size in pulls:
        clock.now_s += wait_s
        packets += parser.feed(model.pull(size))
    model._stop()
    while data := model.pull(1 << 20):
        packets += parser.feed(data)
    assert parser.report.damaged == parser.report.missing == parser.report.skipped_bytes == 0
    parts = [packet.content for packet in packets if isinstance(packet.content, hp.Sums)]
    gathered, missed = sum(part.frames for part in parts), sum(part.missed for part in parts)
    assert gathered + missed == model.sent.frames
    assert missed == model.sent.dropped


def test_a_picture_counts_when_all_its_packets_came(small: Callable[..., hf.Instrument]) -> None:
    instrument = small(rows=64, cols=64, frame_rate_hz=2000.0, exposure_ms=0.2)
    camera, _, clock = camera_of(instrument)
    tables = ReductionTables(np.full((32, 512), 1), (32,) * 32, 0, 511)
    camera.configure(instrument, CameraControls(reduction=Reduction(tables, 20)))
    camera.start(frame_limit=60)
    clock.now_s += 1
    data = b""
    while more := camera.read(0.0):
        data += more
    found = hp.PacketParser().feed(data)
    ends = [*(packet.offset for packet in found[1:]), len(data)]
    parts = [
        data[packet.offset : end]
        for packet, end in zip(found, ends, strict=True)
        if isinstance(packet.content, hp.Sums)
    ]
    assert len(parts) == 3 * 8  # of 8 rows each
    for lost, frames in ((None, 60), (0, 40), (11, 40), (23, 40)):
        totals = PictureTotals()
        for number, part in enumerate(parts):
            if number != lost:
                totals.feed(part)
        assert (totals.frames, totals.pictures) == (frames, frames // 20)
    totals = PictureTotals()
    for part in (*parts[:3], parts[2], *parts[4:]):  # as many pixels, but not all
        totals.feed(part)
    assert (totals.frames, totals.pictures) == (40, 2)
    totals = PictureTotals()
    for part in parts:
        totals.feed(part)
        if part is parts[20]:
            totals.interrupt()
    assert totals.frames == 40


def test_what_a_camera_cannot_do_is_refused(fast: hf.Instrument) -> None:
    camera, model, _ = camera_of(fast)
    model.registers.store(registers.ReductionRoom(sums=8, entry_bits=8, sum_bits=24, group=64))
    for tables, message in (
        (tables_of(1, 9), "need 9 sums per pixel, the camera has room for 8"),
        (tables_of(1, 3, bits=10), "need 10 bits of a table entry"),
        (ReductionTables(np.zeros((1, 512), int), (25,), 0, 9), "need 25 bits of a sum"),
    ):
        with pytest.raises(DeviceError, match=message):
            camera.configure(fast, CameraControls(reduction=Reduction(tables, 10)))
    plain = hp.RegisterFile(hp.camera_map(rows=6, cols=8))
    old = Camera(SimulatedTransport(plain.handle), lambda _: None)
    assert not old.can_reduce
    assert camera.can_reduce
    with pytest.raises(DeviceError, match="can't reduce codes to sums"):
        load_reduction(old.board, Reduction(tables_of(1, 3), 1), pixels=48)
