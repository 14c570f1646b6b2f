# SPDX-License-Identifier: Apache-2.0
"""A sensor on pins that sends on while the camera's clock stands still, as in a change of clock."""

from __future__ import annotations

import numpy as np
import pytest
from amaranth.hdl import EnableInserter, Fragment
from amaranth.lib.wiring import In, Member

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.ddr.link_format import LinkFormat
from hueflight_hdl.testbench.camera import CompiledCamera
from hueflight_hdl.testbench.cxxrtl import compile_design
from hueflight_hdl.testbench.ddr_sensor import (
    PinnedCamera,
    PinnedCameraTestbench,
    SensorPins,
    frame_words,
)
from hueflight_protocol import Event, EventCode, Frame, PacketParser

FORM = FrameFormat(rows=48, cols=20, code_bits=9, lanes=4, run=64)
CONFIG = CameraConfig(form=FORM, sensor=True, patience=4000, reference_hz=10_000_000)
LINK = LinkFormat(form=FORM)
ALIGN_CLOCKS = 1000
FRAME_CLOCKS = len(frame_words(LINK, np.zeros((FORM.rows, FORM.cols), np.uint16))) * (
    LINK.clocks_per_word
)
RECOVERY = 20  # clocks for which the boards say that the clock fails, before and after the pause
PAUSES = 40
STEP = 100
COUNTERS = "frame", "frames_sent", "frames_dropped", "frames_aborted"

pytestmark = pytest.mark.slow


class PausingTestbench(PinnedCameraTestbench):
    """A camera of which nothing in `sync` changes while `stands` is high.

    To the registers, a clock that is enabled now and then is one that stands still; the domain
    `sensor`, in front of the queue, goes on.
    """

    def _sensor_members(self) -> dict[str, Member]:
        return {**super()._sensor_members(), "stands": In(1)}

    def elaborate(self, platform: object) -> Fragment:
        return EnableInserter({"sync": ~self.stands})(super().elaborate(platform))


class PausingCamera(PinnedCamera):
    """A camera whose clock can stand still."""

    def go_on(self, clocks: int) -> None:
        """Run in steps: the sensor answers a readout after the step in which it was asked."""
        for done in range(0, clocks, STEP):
            self.run(clocks=min(STEP, clocks - done))

    def pause(self, clocks: int) -> None:
        """What a board does when its clock is changed or lost."""
        for stands, count in ((0, RECOVERY), (1, clocks), (0, RECOVERY)):
            inputs = self.inputs(count)
            inputs["clock_failed"] = 1
            inputs["stands"] = stands
            self.taking = (lambda count: np.zeros(count, bool)) if stands else None
            self.run(inputs)


@pytest.fixture(scope="module")
def compiled(simulator: None) -> CompiledCamera:
    return compile_design(PausingTestbench(CONFIG, LINK), clocks={"sync": 1, "sensor": 1})


@pytest.mark.parametrize("overlap", [0, 1])
def test_no_frame_is_wrong_after_a_pause_at_any_phase(compiled: CompiledCamera, overlap: int):
    """Frames that the pause has cut are counted, and none of their codes reaches a later frame.

    Pauses of a board are 2.2 ms and more, and outlast a readout; here they may also be shorter, so
    that the sensor still sends when the next capture begins.
    """
    rng = np.random.default_rng(41 + overlap)
    codes = rng.integers(0, 1 << FORM.code_bits, (4000, FORM.rows, FORM.cols)).astype(np.uint16)
    codes[:, 0, 0] = np.arange(len(codes)) % 512  # a frame is known by its first two codes
    codes[:, 0, 1] = np.arange(len(codes)) // 512
    pins = SensorPins(LINK, [3, 0, 11, 6, 12])
    words = (frame_words(LINK, frame) for frame in codes)
    camera = PausingCamera(CONFIG, LINK, pins, words, compiled=compiled)
    camera.write("synthetic", enable=0)
    camera.write("period", value=64)
    camera.write("exposure", value=1)
    camera.write("readout", overlap=overlap)
    camera.run(clocks=ALIGN_CLOCKS)
    cut = 0
    for number in range(PAUSES):
        camera.write("capture", value=number)
        camera.write("run", start=1)
        camera.go_on(2 * FRAME_CLOCKS + int(rng.integers(2 * FRAME_CLOCKS)))
        clocks = int(rng.integers(1, 3 * FRAME_CLOCKS))
        camera.pause(clocks)
        counted = None
        if number % 2:
            assert not camera.read("state")["running"]
            counted = {name: camera.read(name)["value"] for name in COUNTERS}
            cut += counted["frames_dropped"] + counted["frames_aborted"]
        camera.write("capture", value=PAUSES)
        camera.write("run", start=1)  # where `number` is even, before the last frame has come
        camera.go_on(4 * FRAME_CLOCKS)
        camera.write("run", stop=1)
        camera.go_on(2 * FRAME_CLOCKS)

        parser = PacketParser()
        packets = [*parser.feed(camera.packets()), *parser.finish()]
        contents = [packet.content for packet in packets]
        assert parser.report.damaged == parser.report.missing == 0
        frames = [content for content in contents if isinstance(content, Frame)]
        for frame in frames:
            known = int(frame.codes[0, 0]) + 512 * int(frame.codes[0, 1])
            np.testing.assert_array_equal(frame.codes, codes[known])
        before = [frame for frame in frames if frame.header.capture == number]
        if counted:
            assert len(before) == counted["frames_sent"] >= 1
            assert counted["frame"] == sum(list(counted.values())[1:])
        after = [frame.header.frame for frame in frames if frame.header.capture == PAUSES]
        if clocks > FRAME_CLOCKS:  # nothing of before comes any more, as after those of a board
            assert after == list(range(len(after)))
            assert len(after) >= 4
        ends = [each for each in contents if isinstance(each, Event)]
        assert [end.code for end in ends].count(EventCode.RUN_STOPPED) == 2
    assert cut >= PAUSES // 4
    camera.close()
