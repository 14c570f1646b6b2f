"""The command `hueflight info`."""

from __future__ import annotations

from pathlib import Path

from hueflight.cli.output import show
from hueflight.recording import open_recording


def info(recording: Path, *, json: bool = False) -> None:
    """Show what a recording holds.

    Frames, times, metadata, and what the stream from the camera had lost when it was recorded.
    Packets are not read: use `hueflight recover` to find damage in them.

    Parameters
    ----------
    recording : Path
        First file of the recording, NAME.mcap.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    with open_recording(recording) as opened:
        facts = opened.info().as_dict()
    if not json:
        # people want what is not as it should be, not thirty zeros
        facts["report"] = {name: count for name, count in facts["report"].items() if count}
    show(f"Recording {recording}", facts, json_wanted=json)
