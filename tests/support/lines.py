# SPDX-License-Identifier: Apache-2.0
"""Lines that a process writes, read as they come: its pipe never fills, no wait is for ever."""

from __future__ import annotations

import queue
import threading
from typing import IO


class Lines:
    """Reads a stream to its end in a thread of its own, and closes it."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._lines: queue.Queue[str] = queue.Queue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._stream:
            for line in self._stream:
                self._lines.put(line)
        self._lines.put("")

    def next(self, patience_s: float) -> str:
        """The next line, empty at the end; fails if none comes."""
        try:
            return self._lines.get(timeout=patience_s)
        except queue.Empty:
            raise AssertionError(f"the process said nothing for {patience_s:g} s") from None

    def rest(self, patience_s: float) -> str:
        """All that has not been taken yet; call when the process has ended."""
        self._thread.join(patience_s)
        assert not self._thread.is_alive(), "something still holds the process's pipe open"
        left = []
        while not self._lines.empty():
            left.append(self._lines.get())
        return "".join(left)
