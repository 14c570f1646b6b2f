# SPDX-License-Identifier: Apache-2.0
"""The loop closed with sums: simulated photons, the gateware's reduction, and the image of it."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight import simulator
from hueflight.ingest import accumulate_codes
from hueflight.reconstruction import code_offsets
from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.testbench.camera import SimulatedCamera
from hueflight_hdl.testbench.camera_sums import (
    choose_sums,
    load_offsets,
    load_tables,
    pictures_of,
)
from hueflight_protocol import PacketParser, ReductionRoom
from hueflight_protocol.reduction import reduce_histogram
from support.sums_reference import SumsReference

SMALL = Path(__file__).parents[3] / "docs" / "tutorials" / "small.toml"
FRAMES = 1200
PICTURE_FRAMES = 300
MOST_TIMES_HISTOGRAM = 1.08
"""Deviation of depth from sums, as a multiple of that from histograms."""


def capture(camera, codes, tables, offsets):
    """Have the sensor's port carry frames; return the packets."""
    load_tables(camera, tables)
    load_offsets(camera, offsets.ravel())
    choose_sums(camera, tables, frames=PICTURE_FRAMES)
    camera.write("synthetic", enable=0)
    camera.write("exposure", value=16)  # no readout is asked for while a request is answered
    camera.write("frame_limit", value=len(codes))
    camera.write("run", start=1)
    for frame in codes:
        camera.run_to_read()
        camera.run(camera.readout(frame))
    camera.run(clocks=100_000)
    parser = PacketParser()
    packets = [*parser.feed(camera.packets()), *parser.finish()]
    assert parser.report.damaged == parser.report.missing == parser.report.skipped_bytes == 0
    return packets


def depth_deviation(image, truth):
    """Root mean square of the error in depth, m, where there is a depth; outliers are few."""
    error = image.depth.values - truth
    near = np.abs(error) < 0.5
    assert near[np.isfinite(truth)].mean() > 0.8
    return np.sqrt(np.mean(error[near] ** 2))


def make(instrument):
    scene = simulator.scene("fig1", instrument)
    blocks = simulator.simulate_codes(scene, instrument, frames=FRAMES, seed=4)
    reference = simulator.simulate_capture("reference", instrument, frames=2000)
    calibration = hf.calibrate(reference, instrument, distance=0.40)
    return np.concatenate(list(blocks)), calibration, scene.truth(instrument).depth


@pytest.mark.slow
def test_image_is_that_of_the_twin_s_sums(compiler):
    instrument = hf.Instrument.load(SMALL)
    codes, calibration, truth = make(instrument)
    design = hf.design_sums(calibration, entry_bits=8)
    tables, offsets = design.tables, code_offsets(calibration)

    form = FrameFormat(rows=instrument.sensor.rows, cols=instrument.sensor.cols, lanes=2)
    room = ReductionRoom(sums=tables.sums, entry_bits=8, sum_bits=max(tables.widths), group=4)
    camera = SimulatedCamera(CameraConfig(form=form, sensor=True, reduction=room))
    packets = capture(camera, codes, tables, offsets)
    camera.close()
    reference = SumsReference(
        tables, offsets.ravel(), list(codes.reshape(FRAMES, -1)), codes.shape[1:]
    )
    parts = reference.check_packets(packets)
    reference.check_end()
    # blocks end one after another, so that what is left of some is a picture more
    assert (reference.held, reference.pictures) == (FRAMES, FRAMES // PICTURE_FRAMES + 1)

    def image_of(sums):
        shaped = sums.reshape(*codes.shape[1:], -1).astype(np.uint32)
        return hf.reconstruct_sums(shaped, design, calibration, offsets=offsets, frames=FRAMES)

    pictures = list(pictures_of(parts))
    image = image_of(sum(picture.values.astype(np.uint64) for picture in pictures))
    counts = accumulate_codes(codes, instrument)
    twin = reduce_histogram(counts.reshape(-1, counts.shape[-1]), tables, offsets=offsets.ravel())
    xr.testing.assert_identical(image, image_of(twin))

    # the image that is the same is nearly as good as that of the histogram
    joint = hf.reconstruct(counts, calibration, method="joint")
    times = depth_deviation(image, truth) / depth_deviation(joint, truth)
    assert times < MOST_TIMES_HISTOGRAM
    # a single frame less is noticed
    less = accumulate_codes(codes[:-1], instrument).reshape(-1, counts.shape[-1])
    assert not image.identical(image_of(reduce_histogram(less, tables, offsets=offsets.ravel())))
