# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording besides packets, and the names of its files.

This module is the only place that knows how the files of a recording are named: ask `segment_path`,
`part_path`, `segment_files` and `split_segment_path`.
"""

from __future__ import annotations

from glob import escape
from pathlib import Path

import msgspec
import numpy as np
from mcap.records import Channel

from hueflight_protocol import VERSION

PROFILE = "hueflight"
FORMAT = 1  #: version of the layout described here
INSTRUMENT, DESCRIPTION, CALIBRATION = "instrument.json", "recording.json", "calibration"
INDEX, CLOSING = "frames.index", "segment.json"
#: attachments that the writer makes; attachments of a user must have other names
OWN_NAMES = (INSTRUMENT, DESCRIPTION, INDEX, CLOSING)

SUFFIX = ".mcap"  #: file extension of a recording
DIGITS = 6  #: of a segment's number: at 256 MiB each, a year of the fastest camera
PART = ".part"  #: appended to the name of a segment while it is being written

CHANNEL = Channel(
    id=1,
    topic="/camera/packets",
    message_encoding=f"hueflight-packets-v{VERSION}",
    metadata={"content": "whole packets of the camera, one after another, as received"},
    schema_id=0,  # none: the packets describe themselves
)

#: one entry per chunk: all that reading a slice needs, so that other chunks need not be read
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


class Description(msgspec.Struct, frozen=True, kw_only=True):
    """Identity of a recording, stored in each of its segments.

    Attributes
    ----------
    format : int
        Version of the layout of recordings.
    recording : str
        Identifier of the recording, the same in all its segments.
    segment : int
        Number of the segment, from 0.
    started : str
        Time at which the recording started, ISO 8601 in UTC.
    metadata : dict of str
        Notes of the user about the capture.
    """

    format: int
    recording: str
    segment: int
    started: str
    metadata: dict[str, str]


class Closing(msgspec.Struct, frozen=True, kw_only=True):
    """Totals that are known once a segment is finished.

    Attributes
    ----------
    first : int
        Frames of the recording before this segment.
    frames : int
        Frames in this segment.
    last : bool
        True if the recording ends with this segment.
    report : dict of int
        Totals of the whole stream up to the end of this segment, with the field names of
        `hueflight.ingest.IngestReport`.
    """

    first: int
    frames: int
    last: bool
    report: dict[str, int]


def segment_path(path: Path, number: int, /) -> Path:
    """Return the path of a segment of a recording.

    Parameters
    ----------
    path : Path
        First file of the recording, which is segment 0.
    number : int
        Number of the segment.

    Returns
    -------
    Path
        Path of that segment's finished file.

    Examples
    --------
    >>> [segment_path(Path("run.mcap"), number).name for number in range(3)]
    ['run.mcap', 'run.000001.mcap', 'run.000002.mcap']
    """
    return path if number == 0 else path.with_suffix(f".{number:0{DIGITS}d}{path.suffix}")


def split_segment_path(file: Path, /) -> tuple[Path, int]:
    """Return the first file and the segment number that the name of a file stands for.

    This is the inverse of `segment_path`, for finished files and for files still being written.

    Parameters
    ----------
    file : Path
        Any file of a recording.

    Returns
    -------
    tuple of (Path, int)
        First file of the recording and number of the segment.

    Examples
    --------
    >>> path, number = split_segment_path(Path("run.000002.mcap.part"))
    >>> path.name, number
    ('run.mcap', 2)
    """
    finished = file.with_suffix("") if file.suffix == PART else file
    stem, _, digits = finished.stem.rpartition(".")
    if stem and len(digits) == DIGITS and digits.isascii() and digits.isdecimal():
        return finished.with_name(stem + finished.suffix), int(digits)
    return finished, 0


def part_path(path: Path, /) -> Path:
    """Return the name that a segment's file has while it is being written.

    Parameters
    ----------
    path : Path
        Path of the finished file.

    Returns
    -------
    Path
        Path of the unfinished file.
    """
    return path.with_name(path.name + PART)


def segment_files(path: Path, /) -> tuple[list[Path], list[Path]]:
    """Return the files of a recording that exist.

    Parameters
    ----------
    path : Path
        First file of the recording.

    Returns
    -------
    tuple of (list of Path, list of Path)
        Finished files and unfinished files, each in the order of their segments.
    """
    number = "[0-9]" * DIGITS
    later = path.parent.glob(f"{escape(path.stem)}.{number}{path.suffix}")
    parts = path.parent.glob(f"{escape(path.stem)}.{number}{path.suffix}{PART}")
    finished = [each for each in (path, *sorted(later)) if each.exists()]
    unfinished = [each for each in (part_path(path), *sorted(parts)) if each.exists()]
    return finished, unfinished
