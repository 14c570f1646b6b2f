# SPDX-License-Identifier: Apache-2.0
"""The camera model against the protocol's own encoder and parser, with a clock of the test's."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight as hf
from hueflight.devices import Camera, DeviceError, WrongDeviceError
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.frame_template import Template, empty_headers, stamp_all
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport
from hueflight_protocol import (
    Event,
    EventCode,
    Frame,
    FrameFlags,
    PacketParser,
    Status,
    TestPattern,
    decode_frame,
    encode_frame,
)
from hueflight_protocol.typed_registers import camera as registers

WORD, LONG = st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def camera_of(
    instrument: hf.Instrument, clock: Clock, **options: int
) -> tuple[Camera, CameraModel]:
    bank = FrameBank.random(instrument.sensor, occupancy=0.4, frames=7)
    model = CameraModel(instrument.sensor, bank, now_s=clock, **options)
    camera = Camera(SimulatedTransport(model.handle), lambda size: SimulatedStream(model, size))
    return camera, model


@given(WORD, LONG, LONG, WORD, WORD, WORD, st.integers(0, 65535), st.integers(0, 2**32))
@settings(max_examples=60)
def test_a_stamped_template_is_what_the_encoder_writes(
    sequence: int, timestamp: int, frame: int, dropped: int, capture: int, clock_hz: int,
    step: int, seed: int,
) -> None:  # fmt: skip
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 512, (5, 16)) * (rng.random((5, 16)) < rng.random())
    numbers = {
        "sequence": sequence, "timestamp": timestamp, "frame": frame, "dropped": dropped,
        "capture": capture, "clock_hz": clock_hz,
    }  # fmt: skip
    options = {"step": step, "flags": FrameFlags.SIMULATED, "periods": 9}
    template = Template(encode_frame(codes, sequence=1, frame=2, timestamp=3, **options))
    assert template.stamp(**numbers) == encode_frame(codes, **numbers, **options)


@given(st.lists(st.tuples(LONG, LONG, WORD, st.integers(0, 4)), min_size=1, max_size=20))
@settings(max_examples=30)
def test_frames_stamped_together_are_what_the_encoder_writes(
    frames: list[tuple[int, int, int, int]],
) -> None:
    """Of several sizes, each with numbers of its own."""
    rng = np.random.default_rng(len(frames))
    shown = [rng.integers(0, 512, (5, 16)) * (rng.random((5, 16)) < n / 4) for n in range(5)]
    templates = [Template(encode_frame(codes, sequence=1, frame=2, timestamp=3)) for codes in shown]
    numbers = empty_headers(len(frames))
    for header, (timestamp, frame, sequence, _) in zip(numbers, frames, strict=True):
        header["timestamp"], header["frame"], header["sequence"] = timestamp, frame, sequence
    wanted = b"".join(
        encode_frame(shown[which], sequence=sequence, frame=frame, timestamp=timestamp)
        for timestamp, frame, sequence, which in frames
    )
    assert stamp_all([templates[which] for *_, which in frames], numbers) == wanted


def test_the_order_of_a_bank_changes_from_pass_to_pass_and_ends_with_its_step() -> None:
    packets = [
        encode_frame(np.full((1, 8), number), sequence=0, frame=0, timestamp=0, step=step)
        for step in (0, 1)
        for number in range(1, 6)
    ]
    bank = FrameBank(packets, frames_per_step=13)
    shown = [
        (found.header.step, int(found.codes[0, 0]))
        for found in (
            decode_frame(bank.template(frame).stamp(sequence=0, timestamp=0, frame=frame))
            for frame in range(40)
        )
    ]
    assert [step for step, _ in shown] == [0] * 13 + [1] * 27
    passes = [[code for _, code in shown[at : at + 5]] for at in (0, 5, 15, 20, 25, 30)]
    assert all(sorted(codes) == [1, 2, 3, 4, 5] for codes in passes)
    assert len({tuple(codes) for codes in passes}) > 1


def test_settings_of_the_paper() -> None:
    """320 ns at 100 MHz, 1 ms of light, 480 frames a second."""
    instrument = hf.Instrument.load("paper")
    bank = FrameBank.random(instrument.sensor, occupancy=0.0, frames=1)
    model = CameraModel(instrument.sensor, bank)
    camera = Camera(SimulatedTransport(model.handle), lambda size: SimulatedStream(model, size))
    found = camera.configure(instrument)
    assert (found.period_clocks, found.exposure_periods) == (32, 3125)
    assert 1 / model.frame_s == pytest.approx(480, rel=1e-5)


def test_settings_that_the_clock_cannot_make(fast: hf.Instrument) -> None:
    camera, _ = camera_of(fast, Clock())
    timing = hf.Instrument.load("paper").timing
    odd = fast.replace(timing=type(timing)(period_ns=317.3))
    with pytest.raises(WrongDeviceError, match=r"317\.3.* the nearest is 320"):
        camera.configure(odd)
    sensor = type(fast.sensor)(rows=7, cols=8, code_bits=9, bin_width_ns=0.642)
    with pytest.raises(WrongDeviceError, match="6 × 8 pixels of 9 bits"):
        camera.require(fast.replace(sensor=sensor))


def test_a_rate_that_readouts_leave_no_time_for(fast: hf.Instrument) -> None:
    camera, _ = camera_of(fast, Clock())
    sensor = msgspec.structs.replace(fast.sensor, frame_rate_hz=9000.0)
    with pytest.raises(WrongDeviceError, match=r"give 50\d\d frames per second; lower the rate"):
        camera.configure(fast.replace(sensor=sensor))


def test_the_mask_reaches_the_registers(fast: hf.Instrument) -> None:
    camera, model = camera_of(fast, Clock())
    mask = np.zeros((6, 8), bool)
    mask[0, 3] = mask[5, 7] = True
    camera.mask(mask)
    assert [model.registers.get("pixel_mask", i) for i in (0, 1)] == [1 << 3, 1 << 15]
    assert model.registers.get("filters") == 1
    with pytest.raises(DeviceError, match="shape"):
        camera.mask(mask.T)


def test_a_limited_run(fast: hf.Instrument) -> None:
    clock = Clock()
    camera, _ = camera_of(fast, clock)
    camera.configure(fast)
    camera.start(capture=9, frame_limit=25)
    parser, packets = PacketParser(), []
    for _ in range(100):
        clock.now_s += 0.001
        packets += parser.feed(camera.read(0.0))
    contents = [packet.content for packet in packets]
    frames = [content for content in contents if isinstance(content, Frame)]
    assert [frame.header.frame for frame in frames] == list(range(25))
    assert all(frame.header.capture == 9 for frame in frames)
    events = [content for content in contents if isinstance(content, Event)]
    assert [(event.code, event.value) for event in events] == [
        (EventCode.RUN_STARTED, 9), (EventCode.RUN_STOPPED, 25),
    ]  # fmt: skip
    assert parser.report.missing == parser.report.damaged == 0
    assert not camera.running()


def test_status_and_test_packets(fast: hf.Instrument) -> None:
    clock = Clock()
    camera, _ = camera_of(fast, clock)
    camera.board.write(registers.StatusInterval(10))
    camera.board.write(registers.TestPacket(words=100, pattern=1))
    camera.board.write(registers.TestSend(1))
    camera.start(frame_limit=30)
    clock.now_s += 1
    contents = [packet.content for packet in PacketParser().feed(camera.read(0.0))]
    assert [s.frames_sent for s in contents if isinstance(s, Status)] == [10, 20, 30]
    patterns = [content for content in contents if isinstance(content, TestPattern)]
    assert [(p.words.size, p.errors()) for p in patterns] == [(100, 0)]


@given(st.lists(st.tuples(st.floats(0, 0.02), st.integers(1, 5000)), min_size=5, max_size=60))
@settings(max_examples=60)
def test_every_frame_is_sent_or_counted_as_dropped(pulls: list[tuple[float, int]]) -> None:
    """Whatever the link takes and when, F14 holds, and packets are never cut."""
    paper = hf.Instrument.load("paper").sensor
    sensor = type(paper)(rows=4, cols=8, code_bits=9, bin_width_ns=0.642, frame_rate_hz=5000.0)
    clock = Clock()
    bank = FrameBank.random(sensor, occupancy=0.5, frames=5)
    model = CameraModel(sensor, bank, buffer_bytes=3000, now_s=clock)
    model.registers.store(registers.Exposure(625))
    model.registers.set("run", start=1)
    model._start()
    parser = PacketParser()
    for wait_s, size in pulls:
        clock.now_s += wait_s
        parser.feed(model.pull(size))
    model._stop()
    while data := model.pull(1 << 20):
        parser.feed(data)
    report = parser.report
    assert report.damaged == report.missing == report.skipped_bytes == 0
    assert report.frames + model.sent.dropped == model.sent.frames
    assert report.dropped + report.dropped_before <= model.sent.dropped


def test_power_loss_forgets_everything(fast: hf.Instrument) -> None:
    clock = Clock()
    camera, model = camera_of(fast, clock)
    camera.start(capture=5)
    clock.now_s += 0.1
    model.reset()
    assert camera.board.read(registers.Capture).value == 0
    assert not camera.running()
    assert camera.counters().frames_sent == 0
    assert camera.board.read(registers.Map).value == camera.board.registers.fingerprint


def test_a_read_waits_for_data_while_frames_that_are_due_send_none(
    fast: hf.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, model = camera_of(fast, Clock())
    sent = [b"", b"", b"sums"]
    monkeypatch.setattr(CameraModel, "ready_bytes", property(lambda _: 1))
    monkeypatch.setattr(model, "pull", lambda _: sent.pop(0))
    assert SimulatedStream(model, 100).read(60.0) == b"sums"
