# SPDX-License-Identifier: Apache-2.0
"""A sensor with serial lanes: frames bit for bit whatever the skews, faults never delivered."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.formatter.reference import frame_beats, pack_beats
from hueflight_hdl.camera.frame_format import FormatError, FrameFormat
from hueflight_hdl.camera.sensor.ddr.link_format import LinkFormat
from hueflight_hdl.camera.sensor.ddr.receiver import DdrReceiver
from hueflight_hdl.testbench.camera import frame_marks
from hueflight_hdl.testbench.cxxrtl import Simulation, compile_design
from hueflight_hdl.testbench.ddr_sensor import (
    PinnedCamera,
    SensorPins,
    compile_pinned_camera,
    frame_words,
    pin_records,
)
from hueflight_protocol import Frame, PacketParser

FORM = FrameFormat(rows=6, cols=20, code_bits=9, lanes=4, run=64)
CONFIG = CameraConfig(form=FORM, sensor=True, patience=4000)
LINKS = {gear: LinkFormat(form=FORM, gear=gear) for gear in (2, 4)}
LINK = LINKS[4]
ALIGN_CLOCKS = 1000  # more than the longest search
ALIGN_WORDS = 80  # what docs/sensor-pins.md states
MAX_SKEW = 12  # bits between any two lanes: the word that the gateware makes up for
ALL_LOCKED = (1 << LINK.lanes) - 1

Start = Callable[..., PinnedCamera]


@pytest.fixture(scope="module")
def receive(simulator: None) -> Callable[..., list[tuple[int, int]]]:
    """Function that runs pins through a receiver; returns codes and marks of each beat."""
    compiled = {
        gear: compile_design(DdrReceiver(link), clocks={"sync": 1, "sensor": 1})
        for gear, link in LINKS.items()
    }

    def run(pins: SensorPins, clocks: int) -> list[tuple[int, int]]:
        with Simulation(*compiled[pins.link.gear]) as simulation:
            inputs = simulation.inputs(clocks)
            inputs["samples"] = pin_records(pins.take(clocks), inputs["samples"])
            outputs = simulation.run(inputs)
        beats = outputs["port__beats__payload"][outputs["port__beats__valid"] == 1]
        width = FORM.lanes * FORM.code_bits
        return [(int(beat) & (1 << width) - 1, int(beat) >> width) for beat in beats]

    return run


@pytest.fixture(scope="module")
def start(simulator: None) -> Iterator[Start]:
    """Function that returns a camera with a sensor on its pins.

    To compile it takes most of a minute, so tests with it are slow ones.
    """
    compiled = compile_pinned_camera(CONFIG, LINK)
    running = []

    def make(
        skews: Sequence[int], frames: Sequence[np.ndarray], kind: type[SensorPins] = SensorPins
    ) -> PinnedCamera:
        camera = PinnedCamera(CONFIG, LINK, kind(LINK, skews), frames, compiled=compiled)
        running.append(camera)
        return camera

    yield make
    for camera in running:
        camera.close()


class SlippingPins(SensorPins):
    """A sensor that loses a bit of a lane, before a word, in each of its first frames."""

    slips: list[tuple[int, int]]

    def send_frame(self, words: np.ndarray) -> None:
        if not self.slips:
            super().send_frame(words)
            return
        lane, place = self.slips.pop(0)
        self.send(words[:place])
        self.slip_after(lane)
        self.send(words[place:])
        self.train(ALIGN_CLOCKS // 3)


def draw(rng: np.random.Generator) -> np.ndarray:
    """A frame with all kinds of codes, those that look like training among them."""
    codes = rng.integers(0, 1 << FORM.code_bits, (FORM.rows, FORM.cols)).astype(np.uint16)
    codes[rng.random(codes.shape) < 0.3] = LINK.training & 0x1FF
    return codes


def expected_beats(codes: np.ndarray) -> list[tuple[int, int]]:
    """Codes and marks of a frame's beats, as integers."""
    packed = pack_beats(FORM, frame_beats(FORM, codes))
    numbers = [int.from_bytes(row.tobytes(), "little") for row in packed]
    return list(zip(numbers, frame_marks(FORM).tolist(), strict=True))


def capture(camera: PinnedCamera, *, frames: int) -> list[np.ndarray]:
    """Run a capture of so many readouts; return the codes of the frames that were delivered."""
    camera.write("synthetic", enable=0)
    camera.write("period", value=64)
    camera.write("exposure", value=1)
    camera.write("frame_limit", value=frames)
    camera.run(clocks=ALIGN_CLOCKS)
    camera.write("run", start=1)
    for _ in range(400):
        camera.run(clocks=500)
        if not camera.read("state")["running"]:
            break
    camera.run(clocks=2000)
    parser = PacketParser()
    contents = [packet.content for packet in [*parser.feed(camera.packets()), *parser.finish()]]
    return [content.codes for content in contents if isinstance(content, Frame)]


@pytest.mark.parametrize("gear", [2, 4])
def test_beats_are_exact_over_random_skews_slips_and_frames_back_to_back(receive, gear: int):
    """150 random sensors: any phase of words, any skew up to a word, one word between frames."""
    link = LINKS[gear]
    for seed in range(150):
        rng = np.random.default_rng(1000 * gear + seed)
        skews = rng.integers(0, 100) + rng.integers(0, MAX_SKEW + 1, link.lanes)
        pins = SensorPins(link, skews.tolist())
        pins.train(ALIGN_CLOCKS * gear // link.word_bits)
        frames = [draw(rng) for _ in range(4)]
        for codes in frames:
            pauses = np.sort(rng.integers(0, FORM.beats, rng.integers(0, 5)))
            pins.send(frame_words(link, codes, pauses=pauses.tolist()))
        beats = receive(pins, 2 * ALIGN_CLOCKS)
        assert beats == [beat for codes in frames for beat in expected_beats(codes)], seed


@pytest.mark.parametrize("gear", [2, 4])
def test_lanes_are_aligned_80_words_after_silence(receive, gear: int):
    """Whatever place the search has reached: it tries another every five words, of twelve."""
    link, codes = LINKS[gear], draw(np.random.default_rng(gear))
    for silent in range(5 * link.word_bits):
        pins = SensorPins(link, [0] * link.lanes)
        pins.send(np.zeros((silent, link.lanes), np.int64))
        pins.train(ALIGN_WORDS)
        pins.send(frame_words(link, codes))
        assert receive(pins, 2 * ALIGN_CLOCKS) == expected_beats(codes), silent


@pytest.mark.parametrize("late", [0, FORM.lanes])
def test_each_skew_of_a_lane_loses_no_frame(receive, late: int):
    codes = draw(np.random.default_rng(3))
    for skew in range(MAX_SKEW + 1):
        skews = [0] * LINK.lanes
        skews[late] = skew
        pins = SensorPins(LINK, skews)
        pins.train(ALIGN_CLOCKS // 3)
        pins.send(frame_words(LINK, codes))
        assert receive(pins, 2 * ALIGN_CLOCKS) == expected_beats(codes), skew


@pytest.mark.slow
def test_frames_pass_through_the_camera(start: Start):
    rng = np.random.default_rng(7)
    codes = [draw(rng) for _ in range(8)]
    camera = start([3, 0, 11, 6, 12], [frame_words(LINK, frame) for frame in codes])
    np.testing.assert_array_equal(capture(camera, frames=len(codes)), codes)
    assert camera.run(clocks=1)["locked"][0] == ALL_LOCKED
    assert not camera.read("faults")["sensor"]


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [False, True], ids=["any codes", "even codes"])
@pytest.mark.parametrize("lane", [0, FORM.lanes])
def test_a_lane_that_slips_within_a_frame_is_no_image(start: Start, lane: int, hidden: bool):
    """Wherever a bit is lost, that frame is a fault, and frames are exact once it is aligned.

    Even codes stay in range when they are shifted; only the word behind the frame gives the slip
    away.
    """
    rng = np.random.default_rng(lane)
    good = draw(rng)
    good = good & 0x1FE if hidden else good | 0x100
    words = frame_words(LINK, good)
    for place in range(1, len(words) - 1, 9):
        camera = start([0] * LINK.lanes, [words, words], kind=SlippingPins)
        camera.pins.slips = [(lane, place)]
        delivered = capture(camera, frames=2)
        np.testing.assert_array_equal(delivered, [good])
        assert camera.read("faults")["sensor"]
        assert camera.read("frames_aborted")["value"] + camera.read("frames_dropped")["value"] == 1


@pytest.mark.slow
def test_a_damaged_control_word_is_a_fault(start: Start):
    codes = draw(np.random.default_rng(5))
    for bit in range(LINK.word_bits):
        words = frame_words(LINK, codes)
        words[12, -1] ^= 1 << bit
        camera = start([0] * LINK.lanes, [words, frame_words(LINK, codes)])
        np.testing.assert_array_equal(capture(camera, frames=2), [codes])
        assert camera.read("faults")["sensor"], bit


@pytest.mark.slow
@pytest.mark.parametrize("skew", [25, 30, 36])
def test_lanes_too_far_apart_deliver_nothing(start: Start, skew: int):
    rng = np.random.default_rng(skew)
    camera = start([0, 0, skew, 0, 0], [frame_words(LINK, draw(rng)) for _ in range(3)])
    assert capture(camera, frames=3) == []
    assert camera.read("faults")["sensor"]


@pytest.mark.slow
def test_a_dead_lane_is_a_fault(start: Start):
    words = frame_words(LINK, draw(np.random.default_rng(1)))
    camera = start([0] * LINK.lanes, [words])
    camera.pins.dead.add(2)
    assert capture(camera, frames=1) == []
    assert camera.run(clocks=1)["locked"][0] == ALL_LOCKED & ~(1 << 2)
    assert camera.read("faults")["sensor"]


@pytest.mark.parametrize("word_bits", [12, 16, 20])
def test_the_training_word_is_itself_at_one_place_only(word_bits: int):
    link = LinkFormat(form=FORM, word_bits=word_bits)
    mask = (1 << word_bits) - 1
    turned = {
        (link.training << shift | link.training >> word_bits - shift) & mask
        for shift in range(1, word_bits)
    }
    assert len(turned) == word_bits - 1
    assert link.training not in turned
    assert link.start not in turned


@pytest.mark.parametrize(
    "options",
    [{"word_bits": 14}, {"word_bits": 8}, {"gear": 3}, {"form": FrameFormat(code_bits=12)}],
)
def test_links_that_cannot_be_are_refused(options):
    with pytest.raises(FormatError, match="must be"):
        LinkFormat(**{"form": FORM, **options})
