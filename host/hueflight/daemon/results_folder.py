# SPDX-License-Identifier: Apache-2.0
"""The folder of results: images, series of images and counts, which the page shows."""

from __future__ import annotations

import os
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hueflight.daemon.recordings_folder import RecordingMissingError, RecordingNameError
from hueflight.importers.images import is_image

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}\.[A-Za-z0-9]{1,8}")
#: endings of images and of counts that describe their instrument or fit that of the daemon
ENDINGS = (".zarr", ".nc", ".nc4", ".npz", ".npy", ".h5", ".hdf5")


class ResultsFolder:
    """Results by name; no name leads out of the folder.

    Parameters
    ----------
    root : Path
        The folder, which need not exist.
    """

    def __init__(self, root: Path, /) -> None:
        self.root = root.resolve()

    def path(self, name: str, /) -> Path:
        """Return the path of a result.

        Parameters
        ----------
        name : str
            Name of the file, with its ending.

        Returns
        -------
        Path
            Path of a file or Zarr store in this folder.

        Raises
        ------
        RecordingNameError
            If the name is none that a result can have.
        RecordingMissingError
            If there is no such file.
        """
        if not FILE_NAME.fullmatch(name) or not name.endswith(ENDINGS):
            raise RecordingNameError(
                f"name {name[:80]!r}: must consist of letters, digits, '_' and '-', and end in "
                f"one of {', '.join(ENDINGS)}"
            )
        path = self.root / name
        if path.is_symlink() or not path.exists():
            raise RecordingMissingError(
                f"there is no result called {name!r}: GET /api/results lists what there is"
            )
        return path

    def listing(self) -> list[dict[str, Any]]:
        """Return the results, newest first.

        Returns
        -------
        list of dict
            Name, kind (``"image"`` or ``"counts"``) and time of the latest change.
        """
        if not self.root.is_dir():
            return []
        with os.scandir(self.root) as entries:
            found = [
                (entry.stat(follow_symlinks=False).st_mtime, entry.name)
                for entry in entries
                if FILE_NAME.fullmatch(entry.name)
                and entry.name.endswith(ENDINGS)
                and not entry.is_symlink()
            ]
        return [
            {
                "name": name,
                "kind": "image" if is_image(self.root / name) else "counts",
                "modified": datetime.fromtimestamp(modified_s, UTC).isoformat(timespec="seconds"),
            }
            for modified_s, name in sorted(found, reverse=True)
        ]
