# SPDX-License-Identifier: Apache-2.0
"""A thread that waits for the disk, so that the stream need not."""

from __future__ import annotations

import atexit
from _thread import allocate_lock
from collections.abc import Callable
from queue import SimpleQueue
from threading import Thread


class Job:
    """Work that a `Background` does once.

    Parameters
    ----------
    work : callable
        Function without arguments.
    """

    def __init__(self, work: Callable[[], None]) -> None:
        self._work = work
        self._error: BaseException | None = None
        self._doing = allocate_lock()
        self._doing.acquire()

    @property
    def done(self) -> bool:
        """Whether the work has ended, well or not."""
        return not self._doing.locked()

    def run(self) -> None:
        """Do the work, and keep what it raises for `result`."""
        try:
            self._work()
        except BaseException as error:
            self._error = error
        finally:
            self._doing.release()

    def wait(self) -> None:
        """Wait until the work has ended."""
        with self._doing:
            pass

    def result(self) -> None:
        """Wait until the work has ended, and raise what it has raised."""
        self.wait()
        if self._error is not None:
            raise self._error


class Background:
    """One thread that does jobs in turn.

    Unlike an executor of the standard library, it needs no memory to say that a job has ended: who
    waits for that never waits in vain.

    Parameters
    ----------
    name : str
        Name of the thread.
    """

    def __init__(self, name: str) -> None:
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._thread = Thread(target=self._run, name=name, daemon=True)
        self._started = False

    def submit(self, work: Callable[[], None]) -> Job:
        """Have work done after all that was submitted before.

        Parameters
        ----------
        work : callable
            Function without arguments.

        Returns
        -------
        Job
            Tells when it is done.

        Raises
        ------
        MemoryError
            If memory is exhausted; then the work is not done.
        """
        if not self._started:
            self._thread.start()
            self._started = True
            atexit.register(self.close)
        job = Job(work)
        self._jobs.put(job)
        return job

    def close(self) -> None:
        """Wait until all jobs are done, and end the thread."""
        if self._started:
            self._jobs.put(None)
            self._thread.join()
            atexit.unregister(self.close)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            job.run()
