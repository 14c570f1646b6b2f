# SPDX-License-Identifier: Apache-2.0
"""Frames of a run that sends sums: each is delivered or lost in one place, whatever is lost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hueflight as hf
from hueflight.acquisition.plan import RunPlan
from hueflight.acquisition.run import Run
from hueflight.acquisition.run_settings import RunSettings
from hueflight.devices import Camera
from hueflight.devices.camera_controls import CameraControls
from hueflight.devices.reduction import Reduction
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport
from hueflight.ingest.picture_totals import PictureTotals
from hueflight.recording import RecordingWriter
from hueflight_protocol import PacketHeader, PacketParser, Sums, encode_sums
from hueflight_protocol.reduction import ReductionTables

FRAMES, PER_PICTURE = 70, 20
TABLES = ReductionTables(np.tile(np.arange(512) > 0, (32, 1)).astype(int), (32,) * 32, 1, 511)


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def instrument(small: Callable[..., hf.Instrument]) -> hf.Instrument:
    return small(rows=64, cols=64, frame_rate_hz=2000.0, exposure_ms=0.2)


def run_of(instrument: hf.Instrument, **options: int) -> tuple[Run, Camera, CameraModel, bytes]:
    """A run that has ended, and what its link delivered."""
    clock = Clock()
    bank = FrameBank.random(instrument.sensor, occupancy=0.3, frames=7)
    model = CameraModel(instrument.sensor, bank, now_s=clock, **options)
    camera = Camera(SimulatedTransport(model.handle), lambda size: SimulatedStream(model, size))
    controls = CameraControls(reduction=Reduction(TABLES, PER_PICTURE))
    camera.configure(instrument, controls)
    camera.start(capture=5, frame_limit=FRAMES)
    clock.now_s += 1
    data = b""
    while more := camera.read(0.0):
        data += more
    settings = RunSettings.of(instrument)
    return Run(RunPlan(), instrument, settings, label=5, controls=controls), camera, model, data


def parts_of(data: bytes) -> list[tuple[int, int]]:
    """Start and end of each packet of sums."""
    found = PacketParser().feed(data)
    ends = [*(packet.offset for packet in found[1:]), len(data)]
    return [
        (packet.offset, end)
        for packet, end in zip(found, ends, strict=True)
        if isinstance(packet.content, Sums)
    ]


@pytest.mark.parametrize(("lost", "delivered"), [(None, 70), (0, 50), (13, 50), (31, 60)])
def test_frames_of_a_picture_with_a_lost_packet_are_lost_to_the_link(
    instrument: hf.Instrument, lost: int | None, delivered: int
) -> None:
    run, camera, _, data = run_of(instrument)
    if lost is not None:
        start, end = parts_of(data)[lost]
        data = data[:start] + data[end:]
    run.take(data, 1.0, StreamStatistics())
    run.reconcile_with_camera(camera, away=False)
    totals = run.update_totals()
    assert (totals.exposed, totals.delivered) == (FRAMES, delivered)
    assert totals.losses.as_dict() == {
        "sensor": 0, "fpga": 0, "usb": FRAMES - delivered, "host": 0, "disk": 0,
    }  # fmt: skip
    assert run.ended
    assert (run.photons > 0) == (delivered > 0)


def test_frames_without_room_for_a_picture_are_dropped_by_the_camera(
    instrument: hf.Instrument,
) -> None:
    size = 64 * 64 * 32 * 4  # bytes of a picture
    run, camera, model, data = run_of(instrument, buffer_bytes=int(2.5 * size))
    run.take(data, 1.0, StreamStatistics())
    run.reconcile_with_camera(camera, away=False)
    totals = run.update_totals()
    assert totals.exposed == FRAMES
    assert totals.losses.as_dict() == {
        "sensor": 0, "fpga": model.sent.dropped, "usb": 0, "host": 0, "disk": 0,
    }  # fmt: skip
    assert totals.delivered + model.sent.dropped == FRAMES
    assert model.sent.dropped > 0


@pytest.mark.parametrize(("lost", "usb"), [(None, 0), (0, PER_PICTURE), (8, 0)])
def test_frames_after_the_last_picture_are_accounted_for_without_the_camera(
    instrument: hf.Instrument, lost: int | None, usb: int
) -> None:
    """The camera is gone when the run is over, so that its counters can't be asked."""
    run, _, model, data = run_of(instrument, buffer_bytes=64 * 64 * 32 * 4 + 4000)
    parts = parts_of(data)
    assert len(parts) == 2 * 8  # a picture of 20 frames, and one that tells of 50 that were missed
    if lost is not None:
        start, end = parts[lost]
        data = data[:start] + data[end:]
    blocks = run.take(data, 1.0, StreamStatistics())
    assert [block.frames for block in blocks] == [PER_PICTURE] * len(blocks)
    totals = run.update_totals()
    assert model.sent.dropped == FRAMES - PER_PICTURE == 50
    assert (totals.exposed, totals.delivered) == (FRAMES, PER_PICTURE - usb)
    seen = 50 if lost != 8 else 44  # an eighth of the pixels tell nothing
    assert totals.losses.as_dict() == {
        "sensor": 0, "fpga": seen, "usb": usb + 50 - seen, "host": 0, "disk": 0,
    }  # fmt: skip


@given(
    st.lists(st.lists(st.integers(0, 9), min_size=3, max_size=3), min_size=1, max_size=9),
    st.integers(0, 40),
    st.integers(0, 99),
)
def test_windows_of_any_length_add_up_to_the_frames_of_the_capture(
    held: list[list[int]], missed: int, lost: int
) -> None:
    """Each block of a picture holds other frames, and the last pictures tell of the others."""
    exposed = max(map(sum, zip(*held, strict=True))) + missed
    left = [exposed - sum(frames) for frames in zip(*held, strict=True)]
    totals = [PictureTotals(), PictureTotals()]
    pixels = (5, 2, 4)
    for picture, windows in enumerate([*held, [0, 0, 0]]):
        for block, frames in enumerate(windows):
            part = Sums(
                header=PacketHeader(sequence=0), values=np.zeros((pixels[block], 1), np.uint32),
                widths=(8,), picture=picture, first_pixel=sum(pixels[:block]), rows=1, cols=11,
                frames=frames, missed=left[block] if picture == len(held) else 0, tables=1,
            )  # fmt: skip
            packet = encode_sums(part)
            totals[0].feed(packet)
            if 3 * picture + block != lost:
                totals[1].feed(packet)
    whole, cut = totals
    assert whole.frames + whole.missed == exposed
    assert cut.frames + cut.missed <= exposed


def test_the_writer_counts_frames_of_whole_pictures(instrument: hf.Instrument, tmp_path) -> None:
    *_, data = run_of(instrument)
    start, end = parts_of(data)[9]  # of the second picture
    with RecordingWriter(tmp_path / "whole.mcap", instrument) as writer:
        writer.write(data)
        writer.flush()
        assert (writer.frames, writer.picture_frames) == (0, FRAMES)
    with RecordingWriter(tmp_path / "part.mcap", instrument) as writer:
        writer.write(data[:start] + data[end:])
        writer.flush()
        assert (writer.picture_frames, writer.lost_picture_frames) == (FRAMES - PER_PICTURE, 0)
