# SPDX-License-Identifier: Apache-2.0
"""Ingest: count the packets of the camera into histograms, at the full rate of the sensor.

>>> import hueflight as hf
>>> from hueflight import simulator
>>> paper = hf.Instrument.load("paper")
>>> packets = b"".join(simulator.simulate_packets("reference", paper, frames=20))
>>> counts, report = accumulate(packets, paper)
>>> counts.shape, report.frames, report.missing
((192, 128, 512), 20, 0)

Live, in blocks of frames, however the bytes are split into pieces:

>>> stream = HistogramStream(paper, block_frames=8)
>>> blocks = stream.feed(packets[:100_000]) + stream.feed(packets[100_000:]) + stream.finish()
>>> [block.frames for block in blocks]
[8, 8, 4]
"""

from hueflight.ingest.accumulate import accumulate, accumulate_by_step, accumulate_codes
from hueflight.ingest.report import IngestReport
from hueflight.ingest.stream import Block, HistogramStream

__all__ = [
    "Block",
    "HistogramStream",
    "IngestReport",
    "accumulate",
    "accumulate_by_step",
    "accumulate_codes",
]
