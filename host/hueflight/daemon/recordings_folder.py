"""Names that clients may choose, and the only folder they lead to."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from hueflight.errors import HueflightError
from hueflight.recording.layout import SUFFIX, segment_files

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


class FileNameError(HueflightError):
    """A name that is not allowed, is taken, or does not exist."""


def timestamp_name() -> str:
    """A name for now: 20240131T235959Z."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")[:-4] + "Z"


class Folder:
    """Recordings of the daemon.

    Parameters
    ----------
    root : made if it is not there.
    """

    def __init__(self, root: Path, /) -> None:
        root.mkdir(parents=True, exist_ok=True)
        self.root = root.resolve()

    def path(self, name: str, /) -> Path:
        """Where the recording called `name` is or will be.

        Raises
        ------
        FileNameError
            If the name holds anything but letters, digits, ``_`` and ``-``.
        """
        if not NAME.fullmatch(name):
            raise FileNameError(
                f"name {name[:80]!r}: must be 1 to 64 letters, digits, '_' and '-', and begin with "
                "a letter or digit"
            )
        path = self.root / f"{name}{SUFFIX}"
        # a link that somebody put into the folder must not lead out of it either
        if path.resolve().parent != self.root:
            raise FileNameError(f"recording {name!r} lies outside the data folder")
        return path

    def fresh(self, name: str, /) -> Path:
        """The path of a recording that does not exist yet."""
        path = self.path(name)
        if any(segment_files(path)):
            raise FileNameError(f"there is a recording {name!r} already: choose another name")
        return path

    def listing(self) -> list[dict[str, str | int]]:
        """Finished recordings, newest first, with the size of all their segments."""
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
