# SPDX-License-Identifier: Apache-2.0
"""Recordings: the camera's packets exactly as received, in MCAP files that survive a crash.

>>> import tempfile
>>> from pathlib import Path
>>> import hueflight as hf
>>> from hueflight import simulator
>>> paper = hf.Instrument.load("paper")
>>> with tempfile.TemporaryDirectory() as folder:
...     path = Path(folder) / "scene.mcap"
...     with RecordingWriter(path, paper) as writer:
...         for packet in simulator.simulate_packets("reference", paper, frames=20):
...             writer.write(packet)
...     with open_recording(path) as recording:
...         counts = recording.histogram(5, 15)  # frames 5 to 14
>>> counts.shape, int(counts[0, 0].sum())
((192, 128, 512), 10)
"""

from hueflight.recording.finishing import finish_recording
from hueflight.recording.reader import Recording, RecordingInfo, open_recording
from hueflight.recording.recorded_sums import (
    RecordedSums,
    SumsDescription,
    SumsTotal,
    holds_recorded_sums,
    read_sums,
)
from hueflight.recording.recovery import Outcome, Recovery, recover
from hueflight.recording.sums_reader import SumsReader
from hueflight.recording.writer import RecordingWriter

__all__ = [
    "Outcome",
    "RecordedSums",
    "Recording",
    "RecordingInfo",
    "RecordingWriter",
    "Recovery",
    "SumsDescription",
    "SumsReader",
    "SumsTotal",
    "finish_recording",
    "holds_recorded_sums",
    "open_recording",
    "read_sums",
    "recover",
]
