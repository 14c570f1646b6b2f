# SPDX-License-Identifier: Apache-2.0
"""Watches the disk of the data folder in its own thread, because a dead disk may not answer."""

from __future__ import annotations

import threading
from pathlib import Path

from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.errors import RecordingError
from hueflight.files.room import Room

LOOK_S = 0.5
PATIENCE_S = 5.0  #: a disk that takes longer to answer is reported


class DiskWatch:
    """Knows whether the data folder is there, and how much room it has.

    Parameters
    ----------
    folder : Path
        The folder, which exists.

    Attributes
    ----------
    room : Room
        The folder's file system at the start.
    free_bytes : int
        Space that was free when the disk last answered, in bytes.
    thread : SupervisedThread
        Thread that asks the disk.

    Raises
    ------
    OSError
        If the folder can't be examined.
    """

    def __init__(self, folder: Path, /) -> None:
        self.room = Room(folder)
        self.free_bytes = self.room.free_bytes()
        self._folder = folder
        self._problem = ""
        self._ending = threading.Event()
        self.thread = SupervisedThread(self._work, name="disk", patience_s=PATIENCE_S)
        self.thread.start()

    @property
    def problem(self) -> str:
        """What is wrong with the folder; empty if nothing is."""
        if self.thread.stuck():
            return f"the disk under {self._folder} does not answer"
        return self._problem or self.thread.failure

    def close(self) -> None:
        """End the thread, unless the disk does not answer."""
        self._ending.set()
        self.thread.end()
        self.thread.join(1.0)

    def _work(self) -> None:
        while not self._ending.is_set():
            self.thread.beat()
            try:
                self.free_bytes = self.room.free_bytes()
                self._problem = ""
                self.thread.recovered()
            except RecordingError as error:
                self._problem = str(error)
            except OSError as error:
                self._problem = f"the disk under {self._folder} fails: {error.strerror or error}"
            self._ending.wait(LOOK_S)
