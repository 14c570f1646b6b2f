"""hueflight recover"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hueflight.cli.app import app
from hueflight.cli.output import show
from hueflight.model.instrument import Instrument
from hueflight.recording import recover as recover_recording


@app.command
def recover(
    recording: Path,
    *,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    instrument: str | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Save what is left of a damaged or unfinished recording. The old files stay as they are.

    Exit codes: 0 all of it was whole, 3 something was lost, 1 nothing could be recovered.

    Parameters
    ----------
    recording
        First file of the recording, NAME.mcap.
    out
        The new recording; by default NAME.recovered.mcap.
    instrument
        Preset or TOML file; needed only where no file says any more which one it was.
    overwrite
        Replace a recording of that name.
    json
        Print the result as JSON.
    """
    known = None if instrument is None else Instrument.load(instrument)
    recovery = recover_recording(recording, out, instrument=known, overwrite=overwrite)
    show(f"Recovered from {recording}", recovery.as_dict(), json_wanted=json)
    return int(recovery.outcome)
