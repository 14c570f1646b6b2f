# SPDX-License-Identifier: Apache-2.0
"""Summary of a recording's run, as a small file beside the recording."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hueflight.acquisition.plan import RunResult
from hueflight.errors import OutputError
from hueflight.files import replace_file

WRITTEN_LATE = "the summary could not be written at once"  #: failure that a summary may name


def summarise(result: RunResult, /) -> dict[str, Any]:
    """Return what was counted in a run.

    Parameters
    ----------
    result : RunResult
        Result of the run.

    Returns
    -------
    dict
        Counts by name, for JSON.
    """
    return {
        "kind": result.plan.kind,
        "simulated": result.simulated,
        "started": result.started,
        "seconds": round(result.seconds, 3),
        "note": result.plan.metadata.get("note", ""),
        "calibration": result.plan.metadata.get("calibration", ""),
        "exposed": result.totals.exposed,
        "delivered": result.totals.delivered,
        "photons": result.photons,
        "recorded_frames": result.recorded_frames,
        "recorded_bytes": result.recorded_bytes,
        "lost": result.totals.losses.as_dict(),
        "gaps": [asdict(gap) for gap in result.gaps],
        **({} if result.share_known is None else {"share_known": round(result.share_known, 4)}),
        "failure": result.failure,
    }


def write_summary(recording: Path, result: RunResult, /) -> dict[str, Any]:
    """Write NAME.json beside a recording, whole or not at all.

    Parameters
    ----------
    recording : Path
        Path of the recording.
    result : RunResult
        Result of its run.

    Returns
    -------
    dict
        Content of the summary; also where the disk refuses the file, which is then the failure that
        the summary names.
    """
    summary = {"name": recording.stem} | summarise(result)
    try:
        write_summary_file(recording, summary)
    except OutputError as error:
        summary["failure"] = summary["failure"] or f"{WRITTEN_LATE}: {error}"
    return summary


def write_summary_file(recording: Path, summary: dict[str, Any], /) -> None:
    """Write a summary as NAME.json beside a recording, whole or not at all.

    Parameters
    ----------
    recording : Path
        Path of the recording.
    summary : dict
        Content, for JSON.

    Raises
    ------
    OutputError
        If the disk refuses.
    """
    replace_file(recording.with_suffix(".json"), json.dumps(summary, indent=1) + "\n")
