# SPDX-License-Identifier: Apache-2.0
"""What a recording is and holds, and whether its files are whole."""

from __future__ import annotations

from pathlib import Path

from hueflight.files.ages import age
from hueflight.files.inspection import FileDescription
from hueflight.recording.reader import open_recording
from hueflight.recording.recovery import Outcome, check_recording


def describe_recording(path: Path, *, check: bool = False) -> FileDescription:
    """Describe a recording.

    Parameters
    ----------
    path : Path
        First file of the recording.
    check : bool, default False
        Whether to read all files and to compare them with their checksums.

    Returns
    -------
    FileDescription
        Frames, times, metadata, and what the camera's stream had lost when it was recorded.

    Raises
    ------
    RecordingError
        If there is no such recording, it can't be opened, or it was not finished.
    """
    with open_recording(path) as recording:
        facts = recording.info().as_dict()
    facts["age"] = age(facts["started"])
    # that it was ended does not mean that its packets are intact
    facts["ended"] = facts.pop("complete")
    if not check:
        return FileDescription(kind="recording of packets", facts=facts)
    found = check_recording(path)
    problems = [
        f"{number} {what}"
        for number, what in (
            (found.damaged_bytes, "bytes belong to no intact record"),
            (found.missing_segments, "segments are missing"),
            (found.cut, "files have lost their end"),
        )
        if number
    ]
    whole = found.outcome == Outcome.WHOLE
    evidence = (
        "packets, attachments and index were compared with their checksums"
        if whole
        else f"{'; '.join(problems)}: hueflight recover saves what is intact"
    )
    return FileDescription(kind="recording of packets", facts=facts, whole=whole, evidence=evidence)
