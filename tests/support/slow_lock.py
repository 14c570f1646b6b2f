# SPDX-License-Identifier: Apache-2.0
"""A lock that takes its time, so that what is seen before its release is seen for certain."""

from __future__ import annotations

import threading
import time


class SlowLock:
    """A lock whose release takes a while."""

    def __init__(self, release_s: float = 0.2) -> None:
        self._lock, self._release_s = threading.Lock(), release_s
        self.acquire, self.locked = self._lock.acquire, self._lock.locked

    def release(self) -> None:
        """Release the lock after a while."""
        time.sleep(self._release_s)
        self._lock.release()
