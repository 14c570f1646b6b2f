# SPDX-License-Identifier: Apache-2.0
"""What the summaries beside recordings say, for the list of recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

_MOST_BYTES = 1 << 20  #: of a summary; it is a page of text, with a few lines for each gap
#: facts in the list, and their values for a recording whose summary does not state them
UNKNOWN: dict[str, Any] = {
    "kind": None,
    "simulated": None,
    "started": None,
    "seconds": None,
    "frames": None,
    "photons": None,
    "lost": None,
    "gaps": None,
    "note": "",
    "calibration": "",
    "failure": "",
}
_NAMES = {"frames": "recorded_frames"}


class RecordingFacts:
    """Reads summaries, each only once until it changes.

    Parameters
    ----------
    root : Path
        Folder of the recordings.
    """

    def __init__(self, root: Path, /) -> None:
        self._root = root
        self._known: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {}

    def of(self, names: list[str], /) -> dict[str, dict[str, Any]]:
        """Return what is known of recordings.

        Parameters
        ----------
        names : list of str
            Names of all recordings that there are; others are forgotten.

        Returns
        -------
        dict of dict
            Facts by name, with the keys of `UNKNOWN`.
        """
        known = {name: self._read(name) for name in names}
        self._known = {name: entry for name, entry in known.items() if entry is not None}
        return {name: dict(UNKNOWN) if entry is None else entry[1] for name, entry in known.items()}

    def _read(self, name: str) -> tuple[tuple[int, int], dict[str, Any]] | None:
        path = self._root / f"{name}.json"
        try:
            status = path.stat()
            version = (status.st_mtime_ns, status.st_size)
            before = self._known.get(name)
            if before is not None and before[0] == version:
                return before
            if status.st_size > _MOST_BYTES or path.is_symlink():
                return None
            summary = json.loads(path.read_text("utf-8"))
        except (OSError, ValueError):
            return None  # there is none yet, or it was not written by a daemon
        return (version, _facts(summary)) if isinstance(summary, dict) else None


def _facts(summary: dict[str, Any]) -> dict[str, Any]:
    found = {name: summary.get(_NAMES.get(name, name), UNKNOWN[name]) for name in UNKNOWN}
    gaps = found["gaps"]
    return found | {"gaps": len(gaps) if isinstance(gaps, list) else None}
