# SPDX-License-Identifier: Apache-2.0
"""The folder of the daemon's recordings, and the names that clients may choose in it."""

from __future__ import annotations

import json
import os
import re
import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hueflight.acquisition.summary import write_summary_file
from hueflight.daemon.recording_facts import RecordingFacts
from hueflight.errors import HueflightError, OutputError
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
        self._facts = RecordingFacts(self.root)
        self._lock = threading.Lock()  # of the facts, which several requests may ask for

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

    def rename(self, name: str, new_name: str, /) -> None:
        """Give all files of a recording another name.

        Parameters
        ----------
        name, new_name : str
            Name of the recording, and the name that it is given.

        Raises
        ------
        RecordingNameError
            If a name is not allowed, or the new one is taken.
        RecordingMissingError
            If there is no such recording.
        OutputError
            If the disk refuses; the files then have their former names.
        """
        first, target = self._existing(name), self.new_path(new_name)
        done: list[tuple[Path, Path]] = []
        try:
            for file in self._files_of(first):
                renamed = target.with_name(target.stem + file.name.removeprefix(first.stem))
                file.rename(renamed)
                done.append((file, renamed))
        except OSError as error:
            for file, renamed in reversed(done):
                renamed.rename(file)
            raise OutputError(f"can't rename {name!r}: {error.strerror or error}") from error
        _restate_name(target)

    def delete(self, name: str, /) -> None:
        """Delete all files of a recording.

        Parameters
        ----------
        name : str
            Name of the recording.

        Raises
        ------
        RecordingNameError
            If the name is not allowed.
        RecordingMissingError
            If there is no such recording.
        OutputError
            If the disk refuses; files that are left are still listed.
        """
        try:
            # the first file last: what an error leaves is still found under the name
            for file in reversed(self._files_of(self._existing(name))):
                file.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"can't delete {name!r}: {error.strerror or error}") from error

    def _existing(self, name: str) -> Path:
        path = self.path(name)
        if not any(segment_files(path)):
            raise RecordingMissingError(
                f"there is no recording called {name!r}: GET /api/recordings lists what there is"
            )
        return path

    @staticmethod
    def _files_of(first: Path) -> list[Path]:
        """Files of a recording, the summary beside it included."""
        finished, unfinished = segment_files(first)
        summary = first.with_suffix(".json")
        return [*finished, *unfinished, *([summary] if summary.exists() else [])]

    def listing(self) -> list[dict[str, Any]]:
        """Return the recordings, newest first, each with the size of all its files.

        The folder is read once, however many recordings it holds, and each summary only once until
        it changes.

        Returns
        -------
        list of dict
            Name, bytes, number of segments, time of the latest change, whether all files are
            finished, and the facts of the summary (`recording_facts.UNKNOWN`).
        """
        found = sorted(self._files().items(), key=lambda item: item[1].modified_s, reverse=True)
        with self._lock:
            facts = self._facts.of([name for name, _ in found])
        return [
            {
                "name": name,
                "bytes": files.size,
                "segments": files.finished + files.unfinished,
                "modified": datetime.fromtimestamp(files.modified_s, UTC).isoformat(
                    timespec="seconds"
                ),
                "finished": not files.unfinished,
                **facts[name],
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


def _restate_name(first: Path) -> None:
    """Have the summary of a recording that was renamed state its new name."""
    try:
        summary = json.loads(first.with_suffix(".json").read_text("utf-8"))
    except (OSError, ValueError):
        return  # there is none, or it was not written by a daemon
    write_summary_file(first, summary | {"name": first.stem})


@dataclass(slots=True)
class _Files:
    """Totals over the files of one recording."""

    size: int = 0
    modified_s: float = 0.0
    finished: int = 0
    unfinished: int = 0
