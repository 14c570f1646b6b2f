# SPDX-License-Identifier: Apache-2.0
"""Threads that can't end unnoticed: a failure is kept in words, reported, and work begins again."""

from __future__ import annotations

import contextlib
import threading
import time
import traceback
from collections.abc import Callable

FIRST_PAUSE_S = 2.0  #: from a failure until work begins again; long enough to be seen
LONGEST_PAUSE_S = 60.0  #: the pause doubles with each failure of a series
SERIES_S = 60.0  #: a failure that comes later than this after the one before begins a new series
Report = Callable[[str, str], None]


class SupervisedThread:
    """A thread whose work begins again after any exception.

    The work calls `beat` while it is well, so that `stuck` can tell a thread that hangs, and
    `recovered` when it has done again what it is for.

    Parameters
    ----------
    work : callable
        Work of the thread; the thread ends when it returns.
    name : str
        Name of the thread, which is also used in messages.
    on_failure : callable, optional
        Called in the thread with the failure in words and the traceback. Exceptions that it raises
        are ignored.
    restart : bool
        True to begin the work again after a failure; False to end the thread.
    patience_s : float
        Seconds without a `beat` after which the thread counts as stuck.

    Attributes
    ----------
    failure : str
        Present failure in words; empty if there is none.
    failures : int
        Failures since the thread was made.
    """

    def __init__(
        self,
        work: Callable[[], None],
        /,
        *,
        name: str,
        on_failure: Report | None = None,
        restart: bool = True,
        patience_s: float = 60.0,
    ) -> None:
        self._work, self._on_failure, self._restart = work, on_failure, restart
        self.failure = ""
        self.failures = 0
        self._patience_s = patience_s
        self._answered_s = self._failed_s = time.monotonic()
        self._pause_s = 0.0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._supervise, name=name, daemon=True)

    @property
    def name(self) -> str:
        """Name of the thread."""
        return self._thread.name

    @property
    def alive(self) -> bool:
        """True while the thread exists, pauses after a failure included."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Start the thread."""
        self.beat()
        self._thread.start()

    def beat(self, patience_s: float | None = None) -> None:
        """Note that the thread is well.

        Parameters
        ----------
        patience_s : float, optional
            Seconds that the next step of the work may take; by default as before.
        """
        if patience_s is not None:
            self._patience_s = patience_s
        self._answered_s = time.monotonic()

    def recovered(self) -> None:
        """Note that the work does again what it is for."""
        self.failure = ""

    def stuck(self) -> str:
        """Return in words that the thread does not answer or has ended, empty if it is well.

        Returns
        -------
        str
            What is wrong.
        """
        if self._ending.is_set():
            return ""
        if not self.alive:
            return f"the thread {self.name!r} has ended"
        silent_s = time.monotonic() - self._answered_s
        if silent_s > self._patience_s:
            return f"the thread {self.name!r} has not answered for {silent_s:.0f} s"
        return ""

    def end(self) -> None:
        """Do not begin the work again, and cut a pause short; the work itself is not ended."""
        self._ending.set()

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the thread.

        Parameters
        ----------
        timeout_s : float, optional
            Longest time to wait, in seconds.
        """
        self._thread.join(timeout_s)

    def _supervise(self) -> None:
        while True:
            try:
                self._work()
                return
            except BaseException as error:
                self._note(error)
            if not self._restart or self._ending.is_set():
                return
            self.beat(max(self._patience_s, self._pause_s + 1.0))
            if self._ending.wait(self._pause_s):
                # the work has to see for itself that it ends, and put things in order
                self._restart = False

    def _note(self, error: BaseException) -> None:
        now = time.monotonic()
        again = self.failures and now - self._failed_s < SERIES_S + self._pause_s
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S) if again else FIRST_PAUSE_S
        self._failed_s = now
        self.failures += 1
        words = str(error) or "no reason given"
        self.failure = f"{self.name} failed: {type(error).__name__}: {words}"
        if self._on_failure is not None:
            with contextlib.suppress(BaseException):
                self._on_failure(self.failure, "".join(traceback.format_exception(error)))
