# SPDX-License-Identifier: Apache-2.0
"""A camera with an external clock: what a failure does to a capture, and the common time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
import pytest

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.exposure.time_sync import PULSE_CLOCKS
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.reference import synthetic_frames
from hueflight_hdl.testbench.camera import CompiledCamera, SimulatedCamera, compile_camera
from hueflight_protocol import Event, EventCode, Frame, PacketParser, ParserReport, control

CONFIG = CameraConfig(
    form=FrameFormat(rows=16, cols=20, code_bits=9, lanes=8, run=64, banks=8),
    buffer_words=64,
    admit_words=16,
    reference_hz=10_000_000,
)
SEED, OCCUPANCY = 77, 30_000
FRAME = 4 * 32 + CONFIG.form.beats  # clocks of exposure and readout, and some between
RECOVERY = 20  # clocks for which the boards say that the clock fails
LATENCY = 4  # clocks from the input to the device clock

Start = Callable[[], SimulatedCamera]


@pytest.fixture(scope="module")
def compiled(simulator: None) -> CompiledCamera:
    return compile_camera(CONFIG)


@pytest.fixture
def start(compiled: CompiledCamera) -> Iterator[Start]:
    running = []

    def begin() -> SimulatedCamera:
        running.append(SimulatedCamera(CONFIG, compiled=compiled))
        return running[-1]

    yield begin
    for camera in running:
        camera.close()


def parse(camera: SimulatedCamera) -> tuple[list[Frame], list[Event], ParserReport]:
    parser = PacketParser()
    data = camera.packets()
    packets = [packet.content for packet in [*parser.feed(data), *parser.finish()]]
    report = parser.report
    assert report.damaged == report.missing == report.skipped_bytes == 0
    frames = [packet for packet in packets if isinstance(packet, Frame)]
    return frames, [packet for packet in packets if isinstance(packet, Event)], report


def begin_capture(camera: SimulatedCamera, *, frames: int = 0, overlap: int = 0) -> None:
    camera.write("synthetic", enable=1, source=1, occupancy=OCCUPANCY)
    camera.write("synthetic_seed", value=SEED)
    camera.write("exposure", value=4)
    camera.write("readout", overlap=overlap)
    camera.write("frame_limit", value=frames)
    camera.write("run", start=1)


def fail(camera: SimulatedCamera, clocks: int = RECOVERY) -> None:
    inputs = camera.inputs(clocks)
    inputs["clock_failed"] = 1
    camera.run(inputs)


def write(camera: SimulatedCamera, name: str, levels: dict[str, int], **fields: int) -> np.ndarray:
    """Write a register while inputs are at some levels; return the outputs."""
    register = camera.registers[name]
    message = control.encode_request(
        control.write(1, register.address, [register.encode(**fields)])
    )
    inputs = camera.inputs(len(message) + 201)
    for level, value in levels.items():
        inputs[level] = value
    inputs["request_valid"][: len(message) + 1] = 1
    inputs["request_data"][: len(message)] = np.frombuffer(message, np.uint8)
    inputs["request_end"][len(message)] = 1
    return camera.run(inputs)


def edge(camera: SimulatedCamera) -> int:
    """Give an edge; return the camera's clock in which it came."""
    came = camera.clocks
    inputs = camera.inputs(PULSE_CLOCKS)
    inputs["time_sync"] = 1
    camera.run(inputs)
    camera.run(clocks=LATENCY)
    return came


def test_what_the_build_says_of_itself(start: Start):
    camera = start()
    assert camera.read("features")["external_clock"] == 1
    assert camera.read("reference_hz") == {"value": CONFIG.reference_hz}
    assert camera.read("clock_state") == {"external": 0, "present": 0, "lost": 0}
    assert camera.read("faults")["clock_failed"] == 0
    plain = CameraConfig(form=CONFIG.form).registers()
    names = {register.name for register in camera.registers} - {r.name for r in plain}
    assert names == {
        "clock_source", "clock_state", "reference_hz", "clock_failures", "time_sync", "time_state",
    }  # fmt: skip


def test_the_clock_is_asked_for_and_a_loss_is_a_fault(start: Start):
    camera = start()
    assert not camera.run(clocks=1)["reference_wanted"].any()
    camera.write("clock_source", external=1)
    assert camera.run(clocks=1)["reference_wanted"].all()
    inputs = camera.inputs(100)
    inputs["reference_state"][:50] = 0b011
    inputs["reference_state"][50:] = 0b110
    camera.run(inputs[:50])
    camera.run(inputs[50:])
    assert camera.read("faults")["reference_lost"] == 1


@pytest.mark.parametrize("overlap", [0, 1])
def test_a_failure_ends_the_capture_at_any_phase(start: Start, overlap: int):
    """Frames before it are whole, the one under way is counted, the next capture is clean."""
    camera = start()
    rng = np.random.default_rng(3)
    expected = list(islice(synthetic_frames(CONFIG.form, 1, seed=SEED, occupancy=OCCUPANCY), 50))
    aborted = 0
    for failure in range(1, 41):
        begin_capture(camera, overlap=overlap)
        camera.run(clocks=FRAME + int(rng.integers(2 * FRAME)))
        fail(camera)
        camera.run(clocks=FRAME)
        frames, events, report = parse(camera)
        assert not camera.read("state")["running"]
        assert events[-1].code == EventCode.RUN_STOPPED
        counted = {
            name: camera.read(name)["value"]
            for name in ("frame", "frames_sent", "frames_dropped", "frames_aborted")
        }
        assert counted["frames_sent"] == len(frames)
        assert counted["frames_aborted"] == report.aborted
        assert counted["frame"] == sum(list(counted.values())[1:])
        aborted += report.aborted
        for frame in frames:
            np.testing.assert_array_equal(frame.codes, expected[frame.header.frame])
        assert camera.read("faults")["clock_failed"] == 1
        assert camera.read("clock_failures")["value"] == failure
        camera.write("faults", clock_failed=1, aborted=1, dropped=1)
        assert not any(camera.read("faults").values())
    assert aborted >= 5

    begin_capture(camera, frames=3, overlap=overlap)
    camera.run(clocks=5 * FRAME)
    frames, _, _ = parse(camera)
    for frame, codes in zip(frames, expected[:3], strict=True):
        np.testing.assert_array_equal(frame.codes, codes)


def test_no_capture_begins_while_the_clock_fails(start: Start):
    camera = start()
    write(camera, "run", {"clock_failed": 1}, start=1)
    assert not camera.read("state")["running"]
    write(camera, "run", {}, start=1)
    assert camera.read("state")["running"]


def test_the_edge_sets_the_time(start: Start):
    camera = start()
    camera.run(clocks=12_345)
    came = edge(camera)
    assert camera.read("time_state") == {"armed": 0, "done": 0, "level": 0}
    assert camera.read("timestamp")["value"] > 12_345  # nobody had armed it
    camera.write("time_sync", arm=1)
    assert camera.read("time_state") == {"armed": 1, "done": 0, "level": 0}
    came = edge(camera)
    edge(camera)  # of no effect
    assert camera.read("time_state") == {"armed": 0, "done": 1, "level": 0}
    begin_capture(camera, frames=2)
    began = camera.run(clocks=4 * FRAME)
    frames, _, _ = parse(camera)
    # the frame sync comes out of its register two clocks after the exposure's first
    rises = np.flatnonzero(np.diff(began["frame_sync"].astype(int)) > 0) + 1
    syncs = camera.clocks - len(began) + rises
    assert frames[-1].header.timestamp == syncs[-1] - 2 - came - LATENCY


def test_an_edge_must_be_seen_to_rise(start: Start):
    """A level that is high when the camera is armed is none."""
    camera = start()
    high = {"time_sync": 1}
    write(camera, "time_sync", high, arm=1)
    assert camera.read("time_state")["armed"] == 1
    write(camera, "scratch", high)
    assert camera.read("time_state")["done"] == 1


@pytest.mark.parametrize("armed", [True, False])
def test_time_stamps_of_two_cameras_agree_to_the_clock(start: Start, armed: bool):
    """Configured 977 clocks apart, given one edge: frames of one moment have one stamp."""
    stamps = []
    for apart in (0, 977):
        camera = start()
        camera.run(clocks=apart)
        if armed:
            camera.write("time_sync", arm=1)
        else:
            camera.write("scratch")
        edge(camera)
        begin_capture(camera, frames=4)
        camera.run(clocks=8 * FRAME)
        frames, _, _ = parse(camera)
        stamps.append(np.array([frame.header.timestamp for frame in frames]))
        assert len(frames) == 4
    assert set(stamps[1] - stamps[0]) == {0 if armed else 977}


def test_a_failure_ends_the_common_time(start: Start):
    camera = start()
    camera.write("time_sync", arm=1)
    fail(camera)
    assert camera.read("time_state")["armed"] == 0
    camera.write("time_sync", arm=1)
    edge(camera)
    assert camera.read("time_state")["done"] == 1
    fail(camera)
    assert camera.read("time_state")["done"] == 0


def test_the_output_sends_an_edge(start: Start):
    """One pulse from a register; with itself as the receiver, the time begins with it."""
    camera = start()
    sent = write(camera, "time_sync", {}, send=1)["time_sync_out"].astype(int)
    assert sent.sum() == PULSE_CLOCKS
    assert np.flatnonzero(np.diff(sent)).size == 2
    assert not write(camera, "time_sync", {}, arm=1)["time_sync_out"].any()
