# SPDX-License-Identifier: Apache-2.0
"""Runs, gaps, recordings and stop rules on a rig in memory whose cable can be pulled."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hueflight as hf
from hueflight.acquisition import recorder
from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.snapshot import LiveBlock
from hueflight.acquisition.thread_priority import ThreadPriority
from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceGoneError
from hueflight.files.room import Room
from hueflight.recording import open_recording
from hueflight.recording.segment import Segment
from hueflight_protocol.typed_registers import camera as registers
from support.faulty_rig import FaultyRig

WAIT_S = 60.0
LIVE = RunPlan(live=True)
Begin = Callable[..., Acquisition]


@pytest.fixture
def begin(rig: FaultyRig, fast: hf.Instrument) -> Iterator[Begin]:
    opened: list[Acquisition] = []

    def make(**options: Any) -> Acquisition:
        opened.append(Acquisition(rig.connect, fast, **options))
        return opened[-1]

    yield make
    for acquisition in opened:
        acquisition.close()


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.01)


def test_a_run_brings_every_frame(begin: Begin, rig: FaultyRig) -> None:
    result = begin().run(RunPlan(frames=500, keep=True)).result(WAIT_S)
    assert (result.totals.exposed, result.totals.delivered) == (500, 500)
    assert result.totals.losses.undelivered == 0
    assert (result.histograms[0].sum(axis=-1) == 500).all()
    assert result.photons == result.histograms[0][..., 1:].sum()
    assert result.simulated
    assert rig.kept_alive.is_set()


def test_acquisition_and_recording_ask_to_come_first(
    begin: Begin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, told = [], []

    def set_thread_priority(priority: ThreadPriority) -> str:
        asked.append((threading.current_thread().name, priority))
        return "as asked"

    for module in ("runner", "recorder"):
        monkeypatch.setattr(
            f"hueflight.acquisition.{module}.set_thread_priority", set_thread_priority
        )
    acquisition = begin(on_event=lambda name, details: told.append((name, details)))
    acquisition.run(RunPlan(frames=10, path=tmp_path / "run.mcap")).result(WAIT_S)
    assert asked == [
        ("acquisition", ThreadPriority.ACQUISITION),
        ("recorder", ThreadPriority.RECORDING),
    ]
    assert told[0] == ("acquisition", {"scheduled": "as asked"})


def test_a_recording_is_the_run(begin: Begin, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    plan = RunPlan(frames=300, path=path, keep=True, metadata={"note": "hello"})
    result = begin(live=LIVE).run(plan).result(WAIT_S)
    assert result.recorded_frames == 300
    assert not result.failure
    with open_recording(path) as recording:
        assert (recording.histogram() == result.histograms[0]).all()
        info = recording.info().as_dict()
    assert info["report"]["damaged"] == info["report"]["missing"] == 0


def test_stop_rules(begin: Begin) -> None:
    acquisition = begin()
    by_photons = acquisition.run(RunPlan(photons_per_pixel=50.0)).result(WAIT_S)
    assert by_photons.photons / 48 >= 50
    by_time = acquisition.run(RunPlan(seconds=0.2)).result(WAIT_S)
    assert by_time.totals.delivered >= 200  # of 400 in 0.2 s, if the machine is half asleep
    with pytest.raises(CaptureError, match="for each LED"):
        acquisition.run(RunPlan(kind="bands"))
    with pytest.raises(CaptureError, match="finite number above 0"):
        acquisition.run(RunPlan(seconds=-1.0))


def test_a_live_run_makes_way_and_comes_back(begin: Begin, rig: FaultyRig) -> None:
    blocks: list[str] = []

    def look(block: LiveBlock) -> None:
        blocks.append(block.kind)
        block.give_back()

    acquisition = begin(live=LIVE, on_block=look)
    until(lambda: acquisition.snapshot.kind == "live", "the live run is on")
    acquisition.run(RunPlan(kind="reference", frames=200)).result(WAIT_S)
    until(lambda: acquisition.snapshot.kind == "live", "it is on again")
    assert "reference" in blocks
    assert [kind for kind, _ in rig.prepared] == ["scene", "reference", "scene"]
    acquisition.set_live(None)
    until(lambda: acquisition.snapshot.state == "idle", "it has ended")
    totals = acquisition.snapshot.totals
    assert totals.exposed == totals.delivered == rig.model.sent.frames


@pytest.mark.parametrize("late_reads", [0, 3])
def test_unplugged_and_back(begin: Begin, rig: FaultyRig, late_reads: int) -> None:
    """The camera kept its power, so the number of frames lost is exact.

    What it had ready before the gap is lost too, even where it arrives when the next run is on.
    """
    rig.faults.late_reads = late_reads
    acquisition = begin(live=LIVE)
    until(lambda: acquisition.snapshot.totals.delivered > 100, "frames come")
    rig.faults.plugged = False
    until(lambda: acquisition.snapshot.state == "disconnected", "the loss is noticed")
    assert "unplugged" in acquisition.snapshot.problem or "plugged" in acquisition.snapshot.problem
    time.sleep(0.1)
    rig.faults.plugged = True
    until(lambda: acquisition.snapshot.state == "running", "it is back")
    acquisition.set_live(None)
    until(lambda: acquisition.snapshot.state == "idle", "it has ended")
    totals, gaps = acquisition.snapshot.totals, acquisition.snapshot.gaps
    assert totals.exposed == totals.delivered + totals.losses.undelivered == rig.model.sent.frames
    assert totals.losses.usb > 0
    assert [gap.frames_lost for gap in gaps] == [totals.losses.usb]
    assert gaps[0].ended > gaps[0].started


def test_unplugged_amid_a_start(
    begin: Begin, rig: FaultyRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera has the next run's label, but still the counters of the run before."""
    acquisition = begin(live=LIVE)
    until(lambda: acquisition.snapshot.totals.delivered > 100, "frames come")
    whole, cut = Camera.start, iter([True])

    def start(self: Camera, *, capture: int = 0, frame_limit: int = 0) -> None:
        if next(cut, False):
            self.board.write(registers.Capture(capture))
            raise DeviceGoneError("test rig: unplugged amid a start")
        whole(self, capture=capture, frame_limit=frame_limit)

    monkeypatch.setattr(Camera, "start", start)
    rig.faults.plugged = False
    until(lambda: acquisition.snapshot.state == "disconnected", "the loss is noticed")
    rig.faults.plugged = True
    until(lambda: acquisition.snapshot.connections == 3, "it is opened a third time")
    until(lambda: acquisition.snapshot.state == "running", "it is back")
    acquisition.set_live(None)
    until(lambda: acquisition.snapshot.state == "idle", "it has ended")
    totals, gaps = acquisition.snapshot.totals, acquisition.snapshot.gaps
    assert totals.exposed == totals.delivered + totals.losses.undelivered == rig.model.sent.frames
    assert [gap.frames_lost for gap in gaps] == [totals.losses.usb, 0]


def test_power_loss_leaves_an_unknown(begin: Begin, rig: FaultyRig) -> None:
    acquisition = begin(live=LIVE)
    until(lambda: acquisition.snapshot.totals.delivered > 100, "frames come")
    rig.power_loss()
    until(lambda: acquisition.snapshot.state == "disconnected", "the loss is noticed")
    rig.faults.plugged = True
    until(lambda: acquisition.snapshot.state == "running", "it is back")
    assert [gap.frames_lost for gap in acquisition.snapshot.gaps] == [None]


def test_a_reset_without_unplugging_is_noticed(begin: Begin, rig: FaultyRig) -> None:
    acquisition = begin(live=LIVE)
    until(lambda: acquisition.snapshot.totals.delivered > 100, "frames come")
    rig.model.reset()
    until(lambda: acquisition.snapshot.connections == 2, "it is opened again")
    assert "forgotten its run" in acquisition.snapshot.gaps[0].reason


def test_a_recording_goes_on_after_a_gap(begin: Begin, rig: FaultyRig, tmp_path: Path) -> None:
    acquisition = begin()
    future = acquisition.run(RunPlan(frames=1500, path=tmp_path / "gap.mcap"))
    until(lambda: acquisition.snapshot.run_frames > 100, "frames come")
    rig.faults.plugged = False
    until(lambda: acquisition.snapshot.state == "disconnected", "the loss is noticed")
    rig.faults.plugged = True
    result = future.result(WAIT_S)
    assert len(result.gaps) == 1
    assert result.recorded_frames == result.totals.delivered
    assert result.totals.exposed == result.totals.delivered + result.totals.losses.undelivered
    assert result.totals.losses.disk == 0
    with open_recording(tmp_path / "gap.mcap") as recording:
        assert recording.histogram()[..., 1:].sum() == result.photons


def test_damage_on_the_way_is_counted_there(begin: Begin, rig: FaultyRig) -> None:
    rig.faults.damage = 0.3
    result = begin().run(RunPlan(frames=1000)).result(WAIT_S)
    losses = result.totals.losses
    assert result.totals.exposed == 1000
    assert losses.usb == 1000 - result.totals.delivered > 0
    assert losses.fpga == losses.host == losses.sensor == 0


def test_a_viewer_that_hangs_holds_up_nothing_else(begin: Begin, rig: FaultyRig) -> None:
    """Blocks that nobody gives back cost memory of their own, never a frame."""
    kept: list[LiveBlock] = []
    result = begin(on_block=kept.append).run(RunPlan(frames=1000)).result(WAIT_S)
    assert result.totals.delivered == 1000
    assert sum(live.block.frames for live in kept) == 1000


def test_a_full_disk_is_said_at_once_and_costs_the_recording_only(
    begin: Begin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = threading.Event()
    original = Segment.append_chunk

    def append(self: Segment, *args: Any, **options: Any) -> None:
        if full.is_set():
            raise OSError(28, "No space left on device")
        original(self, *args, **options)

    monkeypatch.setattr(Segment, "append_chunk", append)
    acquisition = begin()
    path = tmp_path / "full.mcap"
    future = acquisition.run(RunPlan(frames=8000, path=path))
    until(lambda: acquisition.snapshot.recorded_frames > 0, "something is on disk")
    full.set()
    until(lambda: bool(acquisition.snapshot.recording_failure), "the failure is shown")
    result = future.result(WAIT_S)
    assert result.totals.delivered == 8000
    assert "No space left" in result.failure
    assert result.recorded_frames + result.totals.losses.disk == 8000
    assert 0 < result.recorded_frames < 8000
    with open_recording(path) as recording:
        frames = int(recording.histogram().sum(axis=-1)[0, 0])
    assert frames == result.recorded_frames


def test_a_slow_disk_loses_pieces_and_says_so(
    rig: FaultyRig, fast: hf.Instrument, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dataclasses import replace

    from hueflight.acquisition.run_settings import RunSettings
    from hueflight.recording import RecordingWriter

    original = RecordingWriter.write

    def write(self: RecordingWriter, *packets: bytes) -> None:
        time.sleep(0.05)
        original(self, *packets)

    monkeypatch.setattr(RecordingWriter, "write", write)
    settings = replace(RunSettings.of(fast), recorder_queue_bytes=4096)
    acquisition = Acquisition(rig.connect, fast, settings=settings)
    try:
        plan = RunPlan(frames=2000, path=tmp_path / "slow.mcap")
        result = acquisition.run(plan).result(WAIT_S)
    finally:
        acquisition.close()
    assert result.totals.delivered == 2000
    assert result.totals.losses.disk == 2000 - result.recorded_frames > 0
    assert "too slow" in result.failure


def test_no_room_is_refused_before_the_run(
    rig: FaultyRig, fast: hf.Instrument, tmp_path: Path
) -> None:
    from dataclasses import replace

    from hueflight.acquisition.run_settings import RunSettings

    settings = replace(RunSettings.of(fast), min_free_bytes=1 << 60)
    acquisition = Acquisition(rig.connect, fast, settings=settings)
    try:
        future = acquisition.run(RunPlan(frames=10, path=tmp_path / "no.mcap"))
        with pytest.raises(hf.HueflightError, match="MiB are free"):
            future.result(WAIT_S)
    finally:
        acquisition.close()


def test_room_is_looked_for_again_before_half_of_what_was_left_is_used(
    fast: hf.Instrument, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[int] = []

    def require(_: Room, size: int, *, reserve: int) -> int:
        looks.append(size)
        return 1000

    monkeypatch.setattr(Room, "require", require)
    monkeypatch.setattr(recorder, "ROOM_S", 1e9)
    writing = recorder.Recorder(RunPlan(frames=10, path=tmp_path / "room.mcap"), fast)
    try:
        looks.clear()
        margin = recorder.CHUNK_BYTES + recorder.INDEX_BYTES
        for size in (7, 300, 200, 1):
            writing._suspend_without_room(size)
        assert looks == [7 + margin, 1 + margin]
        monkeypatch.setattr(recorder, "ROOM_S", 0.0)
        writing._suspend_without_room(501)
        writing._suspend_without_room(1)
        assert looks[2:] == [501 + margin, 1 + margin]
    finally:
        writing.close()


def test_the_end_of_a_stream_that_comes_late_is_not_lost(
    rig: FaultyRig, fast: hf.Instrument
) -> None:
    """A busy machine may bring the last frames of a run a second after its end."""
    acquisition = Acquisition(rig.connect, fast)
    try:
        future = acquisition.run(RunPlan())
        until(lambda: acquisition.snapshot.run_frames > 20, "frames come")
        rig.faults.held = True
        time.sleep(0.1)
        acquisition.stop()
        time.sleep(1.0)
        rig.faults.held = False
        result = future.result(WAIT_S)
    finally:
        acquisition.close()
    assert result.totals.losses.undelivered == 0
    assert result.totals.delivered == rig.model.sent.frames


@pytest.mark.parametrize(
    "seeds",
    [range(8), pytest.param(range(8, 208), marks=pytest.mark.slow)],
    ids=["8", "200"],
)
def test_faults_at_random(seeds: range, fast: hf.Instrument, tmp_path: Path) -> None:
    """Whatever happens, in whatever order: no frame is counted twice or forgotten."""

    def run(seed: int) -> None:
        _random_run(seed, fast, tmp_path / f"{seed}.mcap")

    with ThreadPoolExecutor(4) as several:  # they mostly wait
        list(several.map(run, seeds))


def _random_run(seed: int, instrument: hf.Instrument, path: Path) -> None:
    rng = np.random.default_rng(seed)
    rig = FaultyRig(instrument, occupancy=float(rng.random()), seed=seed)
    powered = True
    acquisition = Acquisition(rig.connect, instrument)
    try:
        future = acquisition.run(RunPlan(seconds=0.6, path=path))
        until(lambda: acquisition.snapshot.run_frames > 0 or future.done(), "it begins")
        for _ in range(rng.integers(1, 5)):
            fault = rng.choice(["unplug", "power", "damage", "silence", "none"])
            if fault == "unplug":
                rig.faults.plugged = False
            elif fault == "power":
                rig.power_loss()
                powered = False
            elif fault == "damage":
                rig.faults.damage = float(rng.random())
            elif fault == "silence":
                rig.faults.silent = True
            time.sleep(float(rng.random()) * 0.08)
            rig.faults.plugged, rig.faults.damage, rig.faults.silent = True, 0.0, False
            time.sleep(float(rng.random()) * 0.08)
        result = future.result(WAIT_S)
    finally:
        acquisition.close()
    totals = result.totals
    assert totals.exposed == totals.delivered + totals.losses.undelivered, seed
    if all(gap.frames_lost is not None for gap in result.gaps):
        assert totals.exposed == rig.model.sent.frames, seed
    else:
        # unknown only after a loss of power, or where the run ended with the cable pulled
        assert result.failure or not powered, seed
    assert result.recorded_frames + totals.losses.disk == totals.delivered, seed
    with open_recording(path) as recording:
        assert recording.histogram()[..., 1:].sum() == result.photons, seed


def test_a_camera_that_is_found_is_not_looked_for_any_more(
    rig: FaultyRig, fast: hf.Instrument
) -> None:
    """With nothing to run, or while the lights take long to be ready, no old problem is shown."""
    rig.faults.plugged = False
    acquisition = Acquisition(rig.connect, fast)
    try:
        until(lambda: "not plugged in" in acquisition.snapshot.problem, "it is looked for")
        rig.faults.plugged = True
        until(lambda: acquisition.snapshot.state == "idle", "it is found")
        assert acquisition.snapshot.problem == ""
    finally:
        acquisition.close()
