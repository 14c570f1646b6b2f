"""hueflight info"""

from __future__ import annotations

from pathlib import Path

from hueflight.cli.app import app
from hueflight.cli.output import show
from hueflight.recording import open_recording


@app.command
def info(recording: Path, *, json: bool = False) -> None:
    """What a recording holds and whether all of it can be read.

    Parameters
    ----------
    recording
        A recording (.mcap).
    json
        Print as JSON.
    """
    with open_recording(recording) as opened:
        facts = opened.info().as_dict()
    if not json:
        # people want what is not as it should be, not thirty zeros
        facts["report"] = {name: count for name, count in facts["report"].items() if count}
    show(f"Recording {recording}", facts, json_wanted=json)
