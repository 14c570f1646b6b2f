"""The folder of the daemon's recordings, and the names that clients may choose in it."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from hueflight.errors import HueflightError
from hueflight.recording.layout import SUFFIX, segment_files, segment_path

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

    def listing(self) -> list[dict[str, str | int]]:
        """Return the finished recordings, newest first, each with the size of all its segments."""
        found = []
        for path in self.root.glob(f"*{SUFFIX}"):
            name = path.name[: -len(SUFFIX)]
            if not NAME.fullmatch(name) or path.is_symlink():
                continue
            segments, _ = segment_files(path)
            status = path.stat()
            found.append(
                {
                    "name": name,
                    "bytes": sum(segment.stat().st_size for segment in segments),
                    "segments": len(segments),
                    "modified": datetime.fromtimestamp(status.st_mtime, UTC).isoformat(
                        timespec="seconds"
                    ),
                }
            )
        return sorted(found, key=lambda entry: str(entry["modified"]), reverse=True)
