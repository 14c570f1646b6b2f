# SPDX-License-Identifier: Apache-2.0
"""A camera of full size on a link that stalls: what is lost is lost whole, and counted."""

import numpy as np
import pytest

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.testbench.camera import SimulatedCamera
from hueflight_hdl.testbench.formatter_rate import random_codes
from hueflight_protocol import Event, EventCode, Frame, PacketParser

CONFIG = CameraConfig(form=FrameFormat(), sensor=True)
LONGEST_STALL = 2_000_000  # clocks: 20 ms at 100 MHz
FRAMES = 4000
SCENES = 61


class StallingLink:
    """Takes words and stalls in turn, each for 10 clocks to 20 ms, evenly in their logarithm."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.takes, self.left = True, 0
        self.stalled = self.longest = 0

    def __call__(self, clocks):
        taking = np.empty(clocks, bool)
        at = 0
        while at < clocks:
            if not self.left:
                self.takes = not self.takes
                first = self.longest == 0  # the longest is sure to be among them
                drawn = LONGEST_STALL if first else 10 ** self.rng.uniform(1, 6.3)
                self.left = min(int(drawn), LONGEST_STALL)
                if not self.takes:
                    self.stalled += 1
                    self.longest = max(self.longest, self.left)
            now = min(self.left, clocks - at)
            taking[at : at + now] = self.takes
            self.left -= now
            at += now
        return taking


@pytest.mark.slow
def test_delivered_and_dropped_add_up_to_what_was_read(simulator):
    link = StallingLink(seed=3)
    camera = SimulatedCamera(CONFIG, taking=link)
    rng = np.random.default_rng(4)
    occupancies = rng.choice([0, 0.05, 0.3, 0.7, 1], SCENES)
    scenes = [random_codes(rng, CONFIG.form, occupancy) for occupancy in occupancies]
    readouts = [camera.readout(codes) for codes in scenes]
    camera.taking = None  # while requests are answered
    camera.write("synthetic", enable=0)
    camera.write("exposure", value=8)  # no readout is asked for while a request is answered
    camera.write("frame_limit", value=FRAMES)
    camera.write("run", start=1)
    camera.packets()
    camera.taking = link
    received = bytearray()
    for number in range(FRAMES):
        camera.run_to_read()
        camera.run(readouts[number % SCENES])
        received += camera.packets()
    camera.taking = None
    camera.run(clocks=20_000)
    received += camera.packets()
    assert not camera.read("state")["running"]
    assert link.longest == LONGEST_STALL
    assert link.stalled > 20

    counted = {
        name: camera.read(name)["value"]
        for name in ("frame", "frames_sent", "frames_dropped", "frames_aborted")
    }
    camera.close()
    parser = PacketParser()
    packets = [*parser.feed(received), *parser.finish()]
    report = parser.report
    assert report.damaged == report.missing == report.skipped_bytes == report.repeated == 0
    frames = [packet for packet in packets if isinstance(packet.content, Frame)]

    # the camera's counts, the host's, and what the sensor was asked for are the same
    assert counted["frame"] == FRAMES
    assert counted["frames_sent"] == len(frames) == report.frames
    assert counted["frames_aborted"] == report.aborted
    assert counted["frames_dropped"] + report.aborted + report.frames == FRAMES
    assert counted["frames_dropped"] > FRAMES // 10
    assert report.aborted > 10
    assert report.frames > FRAMES // 10

    # delivered frames are intact, and each announces all that was dropped before it
    aborted = at = 0
    for before, packet in enumerate(frames):
        header = packet.content.header
        np.testing.assert_array_equal(packet.content.codes, scenes[header.frame % SCENES])
        between = PacketParser()
        between.feed(bytes(received[at : packet.offset]))
        aborted += between.report.aborted
        at = packet.offset + len(packet.data)
        assert header.dropped == header.frame - before - aborted
    ends = [p.content for p in packets if isinstance(p.content, Event)]
    assert [e.value for e in ends if e.code == EventCode.RUN_STOPPED] == [FRAMES]
