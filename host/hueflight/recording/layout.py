"""What is in a recording besides packets, and how its files are called."""

from __future__ import annotations

from glob import escape
from pathlib import Path

import msgspec
import numpy as np
from mcap.records import Channel

from hueflight_protocol import VERSION

PROFILE = "hueflight"
FORMAT = 1  # version of what is said here
INSTRUMENT, DESCRIPTION, CALIBRATION = "instrument.json", "recording.json", "calibration"
INDEX, CLOSING = "frames.index", "segment.json"
"""Names of attachments; those of a user must be others."""
OWN_NAMES = (INSTRUMENT, DESCRIPTION, INDEX, CLOSING)

DIGITS = 6  # of a segment's number: at 256 MiB each, a year of the fastest camera
PART = ".part"  # ends the name of a segment that is being written

CHANNEL = Channel(
    id=1,
    topic="/camera/packets",
    message_encoding=f"hueflight-packets-v{VERSION}",
    metadata={"content": "whole packets of the camera, one after another, as received"},
    schema_id=0,  # none: the packets describe themselves
)

FRAME_INDEX = np.dtype(
    [
        ("offset", "<u8"),  # of the packets in the file
        ("size", "<u8"),  # bytes of packets
        ("first", "<u8"),  # frames of the recording before this chunk
        ("frames", "<u4"),
        ("sequence", "<u4"),  # of the packet before this chunk
        ("has_sequence", "<u4"),  # whether there was one
        ("clock_hz", "<u4"),
        ("tick", "<u8"),  # device clock of the chunk's first frame
        ("log_time", "<u8"),  # host clock, ns since 1970
    ]
)
"""One entry per chunk: what reading a slice needs, without reading the rest."""


class Description(msgspec.Struct, frozen=True, kw_only=True):
    """What each segment says about the recording that it belongs to.

    Attributes
    ----------
    format : version of the layout of recordings.
    recording : identity of the recording, the same in all its segments.
    segment : number of the segment, from 0.
    started : when the recording started, ISO 8601 in UTC.
    metadata : what the user said about the capture.
    """

    format: int
    recording: str
    segment: int
    started: str
    metadata: dict[str, str]


class Closing(msgspec.Struct, frozen=True, kw_only=True):
    """What is known when a segment is finished.

    Attributes
    ----------
    first, frames : frames of the recording before the segment, and in it.
    last : whether the recording ends with it.
    report : totals of the whole stream up to here, as `IngestReport` names them.
    """

    first: int
    frames: int
    last: bool
    report: dict[str, int]


def segment_path(path: Path, number: int, /) -> Path:
    """File of a segment: run.mcap, run.000001.mcap, run.000002.mcap, …"""
    return path if number == 0 else path.with_suffix(f".{number:0{DIGITS}d}{path.suffix}")


def part_path(path: Path, /) -> Path:
    """Name of a segment's file while it is being written."""
    return path.with_name(path.name + PART)


def segment_files(path: Path, /) -> tuple[list[Path], list[Path]]:
    """Files of the recording at `path` that are finished, and those that are not, in order."""
    number = "[0-9]" * DIGITS
    later = path.parent.glob(f"{escape(path.stem)}.{number}{path.suffix}")
    parts = path.parent.glob(f"{escape(path.stem)}.{number}{path.suffix}{PART}")
    finished = [each for each in (path, *sorted(later)) if each.exists()]
    unfinished = [each for each in (part_path(path), *sorted(parts)) if each.exists()]
    return finished, unfinished
