# SPDX-License-Identifier: Apache-2.0
"""Packets to an image in one call: the same as in two, whatever memory it works in."""

import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import HistogramError
from hueflight.ingest import accumulate
from hueflight.reconstruction.entry_point import reconstruct_packets
from hueflight_protocol import encode_frame


@pytest.fixture(scope="module")
def setting(small, draw):
    instrument = small(rows=12, cols=16)
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    bins = instrument.time_bins()
    counts = draw(instrument, depth=0.9, photons=4000)
    share = counts[0, 0, bins.codes] / counts[0, 0, bins.codes].sum()
    codes = np.random.default_rng(4).choice(bins.codes, (700, 12, 16), p=share)
    codes[np.random.default_rng(5).random(codes.shape) < 0.3] = 0
    packets = b"".join(
        encode_frame(frame.astype(np.uint16), sequence=i, frame=i, timestamp=i, code_bits=9)
        for i, frame in enumerate(codes)
    )
    return instrument, calibration, packets


def test_one_call_gives_what_two_give(setting):
    instrument, calibration, packets = setting
    counts, _ = accumulate(packets, instrument)
    expected = hf.reconstruct(counts, calibration)
    work = np.full(instrument.histogram_shape, 7, np.uint16)
    for out, threads in ((None, 1), (work, 2), (work, 2)):
        image, report = reconstruct_packets(packets, calibration, out=out, threads=threads)
        assert report.frames == 700
        for name in ("depth", "depth_std", "reflectance", "photons", "quality"):
            np.testing.assert_array_equal(image[name], expected[name])


def test_no_frame_is_an_error(setting):
    _, calibration, _ = setting
    with pytest.raises(HistogramError, match="not one frame"):
        reconstruct_packets(b"", calibration)
