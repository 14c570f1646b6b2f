# SPDX-License-Identifier: Apache-2.0
"""The folder of the daemon's recordings, and the names that clients may choose in it."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from hueflight.errors import HueflightError
from hueflight.recording.layout import (
    PART,
    SUFFIX,
    segment_files,
    segment_path,
    split_segment_path,
)

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


class RecordingNameError(HueflightError):
    """A name that is not allowed, or that is taken."""


def timestamp_name() -> str:
    """Return a name for the present moment in UTC, such as 20240131T235959123Z."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")[:-4] + "Z"


class RecordingMissingError(RecordingNameError):
    """A recording that is not there, or that has no such segment."""


class RecordingsFolder:
    """Recordings of the daemon by name; no name leads out of the folder.

    Parameters
    ----------
    root : Path
        The folder, which is made if it does not exist.
    """

    def __init__(self, root: Path, /) -> None:
        root.mkdir(parents=True, exist_ok=True)
        self.root = root.resolve()

    def path(self, name: str, /) -> Path:
        """Return the path of the first file of the recording called `name`.

        Parameters
        ----------
        name : str
            Name of a recording, which need not exist.

        Returns
        -------
        Path
            Path in this folder.

        Raises
        ------
        RecordingNameError
            If the name holds anything but letters, digits, ``_`` and ``-``.
        """
        if not NAME.fullmatch(name):
            raise RecordingNameError(
                f"name {name[:80]!r}: must be 1 to 64 letters, digits, '_' and '-', and begin with "
                "a letter or digit"
            )
        path = self.root / f"{name}{SUFFIX}"
        # a link that somebody put into the folder must not lead out of it either
        if path.resolve().parent != self.root:
            raise RecordingNameError(f"recording {name!r} lies outside the data folder")
        return path

    def new_path(self, name: str, /) -> Path:
        """Return the path of a recording that does not exist yet.

        Parameters
        ----------
        name : str
            Name of the new recording.

        Returns
        -------
        Path
            Path in this folder.

        Raises
        ------
        RecordingNameError
            If the name is not allowed, or a recording of this name has any files.
        """
        path = self.path(name)
        if any(segment_files(path)):
            raise RecordingNameError(
                f"a recording called {name!r} exists already: choose another name"
            )
        return path

    def segment(self, name: str, number: int, /) -> Path:
        """Return the path of a finished segment of a recording.

        Parameters
        ----------
        name : str
            Name of the recording.
        number : int
            Number of the segment, from 0.

        Returns
        -------
        Path
            Path of a file in this folder.

        Raises
        ------
        RecordingNameError
            If the name is not allowed.
        RecordingMissingError
            If there is no such recording, or it has no finished segment of that number.
        """
        first = self.path(name)
        path = segment_path(first, number)
        if path not in segment_files(first)[0] or path.is_symlink():
            raise RecordingMissingError(
                f"there is no finished segment {number} of a recording called {name!r}: "
                "GET /api/recordings lists what there is"
            )
        return path

    def unfinished(self) -> list[str]:
        """Return the names of recordings with unfinished files, in alphabetical order."""
        return sorted(name for name, files in self._files().items() if files.unfinished)

    def listing(self) -> list[dict[str, str | int | bool]]:
        """Return the recordings, newest first, each with the size of all its files.

        The folder is read once, however many recordings it holds.

        Returns
        -------
        list of dict
            Name, bytes, number of segments, time of the latest change, and whether all files are
            finished.
        """
        found = sorted(self._files().items(), key=lambda item: item[1].modified_s, reverse=True)
        return [
            {
                "name": name,
                "bytes": files.size,
                "segments": files.finished + files.unfinished,
                "modified": datetime.fromtimestamp(files.modified_s, UTC).isoformat(
                    timespec="seconds"
                ),
                "finished": not files.unfinished,
            }
            for name, files in found
        ]

    def _files(self) -> dict[str, _Files]:
        """Files of each recording by its name."""
        found: dict[str, _Files] = {}
        with os.scandir(self.root) as entries:
            for entry in entries:
                if not entry.name.endswith((SUFFIX, SUFFIX + PART)) or entry.is_symlink():
                    continue
                first, _ = split_segment_path(Path(entry.name))
                name = first.name.removesuffix(SUFFIX)
                if not NAME.fullmatch(name):
                    continue
                try:
                    status = entry.stat(follow_symlinks=False)
                except FileNotFoundError:
                    continue  # it has just been finished or deleted
                files = found.setdefault(name, _Files())
                files.size += status.st_size
                files.modified_s = max(files.modified_s, status.st_mtime)
                if entry.name.endswith(PART):
                    files.unfinished += 1
                else:
                    files.finished += 1
        return found


@dataclass(slots=True)
class _Files:
    """Totals over the files of one recording."""

    size: int = 0
    modified_s: float = 0.0
    finished: int = 0
    unfinished: int = 0
