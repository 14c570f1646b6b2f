# SPDX-License-Identifier: Apache-2.0
"""The loop closed: simulated photons through the gateware's camera to an image."""

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight import simulator
from hueflight.ingest import HistogramStream, accumulate_codes
from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.ddr.link_format import LinkFormat
from hueflight_hdl.testbench.camera import SimulatedCamera
from hueflight_hdl.testbench.ddr_sensor import PinnedCamera, SensorPins, frame_words

FRAMES = 600
PIN_FRAMES = 100


def run_through_gateware(codes, camera):
    """Have the sensor's port carry frames; yield the bytes that the link takes."""
    camera.write("synthetic", enable=0)
    camera.write("exposure", value=8)  # no readout is asked for while a request is answered
    camera.write("frame_limit", value=FRAMES)
    camera.write("run", start=1)
    for frame in codes:
        camera.run_to_read()
        camera.run(camera.readout(frame))
        yield camera.packets()
    camera.run(clocks=5000)
    yield camera.packets()
    assert camera.read("frames_sent")["value"] == FRAMES


@pytest.mark.slow
def test_photons_through_pins_give_the_same_image(compiler):
    """Photons, serial lanes of the sensor, packets and image, bit for bit."""
    instrument = hf.Instrument.load("paper")
    scene = simulator.scene("fig1", instrument)
    blocks = simulator.simulate_codes(scene, instrument, frames=PIN_FRAMES, seed=5)
    codes = np.concatenate(list(blocks))

    form = FrameFormat(rows=instrument.sensor.rows, cols=instrument.sensor.cols)
    link = LinkFormat(form=form)
    pins = SensorPins(link, [7, 0, 12, 3, 9, 1, 11, 5, 4])
    words = (frame_words(link, frame) for frame in codes)
    camera = PinnedCamera(CameraConfig(form=form, sensor=True), link, pins, words)
    camera.write("synthetic", enable=0)
    camera.write("exposure", value=8)
    camera.write("frame_limit", value=PIN_FRAMES)
    camera.write("run", start=1)
    stream = HistogramStream(instrument)
    while camera.read("state")["running"]:
        camera.run(clocks=1000)
        assert stream.feed(camera.packets()) == []
    camera.run(clocks=5000)
    assert stream.feed(camera.packets()) == []
    camera.close()
    (block,) = stream.finish()
    assert stream.report.frames == PIN_FRAMES
    assert stream.report.lossless

    expected = accumulate_codes(codes, instrument)
    np.testing.assert_array_equal(block.histogram, expected)
    reference = simulator.simulate_capture("reference", instrument, frames=2000)
    calibration = hf.calibrate(reference, instrument, distance=0.40)
    image = hf.reconstruct(block.histogram, calibration, method="paper")
    xr.testing.assert_identical(image, hf.reconstruct(expected, calibration, method="paper"))


@pytest.mark.slow
def test_image_is_the_same_as_without_the_gateware(compiler):
    instrument = hf.Instrument.load("paper")
    scene = simulator.scene("fig1", instrument)
    blocks = simulator.simulate_codes(scene, instrument, frames=FRAMES, seed=4)
    codes = np.concatenate(list(blocks))

    form = FrameFormat(rows=instrument.sensor.rows, cols=instrument.sensor.cols)
    camera = SimulatedCamera(CameraConfig(form=form, sensor=True))
    stream = HistogramStream(instrument)
    for piece in run_through_gateware(codes, camera):
        assert stream.feed(piece) == []
    camera.close()
    (block,) = stream.finish()
    report = stream.report
    assert report.frames == block.frames == FRAMES
    assert report.lossless
    assert report.miscounted == report.foreign == report.skipped_bytes == 0
    assert report.photons == np.count_nonzero(codes)

    expected = accumulate_codes(codes, instrument)
    np.testing.assert_array_equal(block.histogram, expected)

    reference = simulator.simulate_capture("reference", instrument, frames=2000)
    calibration = hf.calibrate(reference, instrument, distance=0.40)
    for method, limit in (("paper", 0.15), ("joint", 0.10)):
        image = hf.reconstruct(block.histogram, calibration, method=method)
        xr.testing.assert_identical(image, hf.reconstruct(expected, calibration, method=method))
        # the image that is the same is one of the scene, too, as far as 600 exposures go
        error = image.depth.values - scene.truth(instrument).depth
        assert np.nanmedian(np.abs(error)) < limit

    # a single frame less is noticed
    less = hf.reconstruct(accumulate_codes(codes[:-1], instrument), calibration, method="paper")
    assert not less.identical(hf.reconstruct(expected, calibration, method="paper"))
