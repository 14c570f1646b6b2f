"""Recordings: the camera's packets exactly as received, in MCAP files that outlive a crash."""

from hueflight.recording.reader import Recording, RecordingInfo, open_recording
from hueflight.recording.recover import Outcome, Recovery, recover
from hueflight.recording.writer import RecordingWriter

__all__ = [
    "Outcome",
    "Recording",
    "RecordingInfo",
    "RecordingWriter",
    "Recovery",
    "open_recording",
    "recover",
]
