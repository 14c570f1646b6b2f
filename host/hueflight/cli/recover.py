# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight recover`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hueflight.cli.output import show
from hueflight.errors import RecordingError
from hueflight.model.instrument import Instrument
from hueflight.recognition import what_is
from hueflight.recording import recover as recover_recording
from hueflight.recording.layout import SUFFIX
from hueflight.recording.recovery import Outcome


def recover(
    recording: Path,
    *,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    instrument: str | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Save what is left of a damaged or unfinished recording.

    The old files stay as they are. Exit codes: 0 if all of the recording was intact, 3 if some of
    it was lost, 1 if nothing could be recovered.

    Parameters
    ----------
    recording : Path
        First file of the recording, NAME.mcap.
    out : Path, optional
        Recording to write. By default NAME.recovered.mcap, beside the old one.
    instrument : str, optional
        Instrument that made the recording: a preset or the path of a TOML file. Needed only if
        none of the recording's files names it any more.
    overwrite : bool, default False
        Replace an existing recording of that name.
    json : bool, default False
        Print one JSON object instead of a table.

    Returns
    -------
    int
        Exit code.
    """
    seems = what_is(recording)
    if recording.exists() and recording.suffix.lower() != SUFFIX:
        raise RecordingError(
            f"{str(recording)!r} is {seems}: recover takes the first file of a recording, "
            f"NAME{SUFFIX}"
        )
    known = None if instrument is None else Instrument.load(instrument)
    recovery = recover_recording(recording, out, instrument=known, overwrite=overwrite)
    if recovery.outcome == Outcome.NOTHING and not json:
        raise RecordingError(
            f"nothing could be recovered from {str(recording)!r}: it is {seems} without an intact "
            "record of a recording"
        )
    show(f"Recovered from {recording}", recovery.as_dict(), json_wanted=json)
    return int(recovery.outcome)
