"""What acquisition counted during a recording, as a small file beside it."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hueflight.acquisition.plan import RunResult
from hueflight.errors import OutputError
from hueflight.files import replace_file


def summarise(result: RunResult, /) -> dict[str, Any]:
    """Counts of a run by name."""
    return {
        "kind": result.plan.kind,
        "simulated": result.simulated,
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
    """Write NAME.json beside a recording, whole or not at all; return what is in it.

    A disk that is full keeps nothing from being said: the summary is returned all the same.
    """
    summary = {"name": recording.stem} | summarise(result)
    try:
        replace_file(recording.with_suffix(".json"), json.dumps(summary, indent=1) + "\n")
    except OutputError as error:
        summary["failure"] = summary["failure"] or f"the summary is missing: {error}"
    return summary
