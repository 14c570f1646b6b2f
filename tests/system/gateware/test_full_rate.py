# SPDX-License-Identifier: Apache-2.0
"""The driver's settings on the gateware: frames come at the rate that an instrument states."""

from itertools import islice

import numpy as np
import pytest

import hueflight as hf
from hueflight.devices.camera_settings import CameraSettings
from hueflight.devices.errors import WrongDeviceError
from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.reference import synthetic_frames
from hueflight_hdl.testbench.camera import SimulatedCamera
from hueflight_protocol import Frame, PacketParser

FORM = FrameFormat()
FRAMES = 12


def settings_of(preset, *, can_overlap):
    instrument = hf.Instrument.load(preset)
    return CameraSettings.of(
        instrument, clock_hz=FORM.clock_hz, lanes=FORM.lanes, can_overlap=can_overlap
    )


@pytest.mark.slow
def test_full_rate_of_the_chip_is_held(compiler):
    settings = settings_of("fullrate", can_overlap=True)
    assert (settings.overlap, settings.exposure_periods) == (True, 168)
    camera = SimulatedCamera(CameraConfig(form=FORM, sensor=True))
    assert camera.read("features")["overlap"] == 1
    camera.write("synthetic", enable=1, source=1, occupancy=65535)
    camera.write("period", value=settings.period_clocks)
    camera.write("exposure", value=settings.exposure_periods)
    camera.write("gap", value=settings.gap_clocks)
    camera.write("readout", overlap=settings.overlap)
    camera.write("frame_limit", value=FRAMES)
    camera.write("run", start=1)
    camera.run(clocks=(FRAMES + 2) * 5400)
    parser = PacketParser()
    found = [packet.content for packet in parser.feed(camera.packets())]
    camera.close()
    frames = [content for content in found if isinstance(content, Frame)]
    assert [frame.header.frame for frame in frames] == list(range(FRAMES))
    assert parser.report.aborted == parser.report.dropped == parser.report.damaged == 0

    spacing = np.diff([frame.header.timestamp for frame in frames])
    # 168 periods of 32 clocks, and three clocks from one exposure to the next
    assert set(spacing) == {168 * 32 + 3}
    assert FORM.clock_hz / spacing[0] > 0.9995 * 18_600
    expected = islice(synthetic_frames(FORM, 1, seed=1, occupancy=65535), FRAMES)
    for frame, codes in zip(frames, expected, strict=True):
        assert frame.header.periods == 168
        np.testing.assert_array_equal(frame.codes, codes)


def test_without_overlap_the_full_rate_is_refused():
    with pytest.raises(WrongDeviceError, match="reads out for"):
        settings_of("fullrate", can_overlap=False)


def test_overlap_is_used_only_where_it_is_needed():
    assert not settings_of("paper", can_overlap=True).overlap
