"""Ingest: packets from the camera to histograms, at the rate of the sensor chip."""

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
