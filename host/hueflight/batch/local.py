# SPDX-License-Identifier: Apache-2.0
"""Local worker processes, each with one capture at a time; one that dies is replaced."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any

from hueflight.batch.job import Job, Outcome, work
from hueflight.errors import BatchError
from hueflight.numerical_threads import ONE_THREAD


@dataclass
class _Worker:
    """A process and the capture that it works on."""

    process: BaseProcess
    pipe: Any  # a Connection; its class differs between systems
    capture: str | None = None


@dataclass(frozen=True)
class LocalWorkers:
    """Runs a job on processes of this machine.

    Attributes
    ----------
    workers : int
        Number of processes.
    attempts : int
        How often a capture is begun at most, if workers die on it.
    """

    workers: int
    attempts: int = 2

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise BatchError(f"workers = {self.workers}: at least 1 is needed")

    def run(self, job: Job, captures: Sequence[str], /) -> Iterator[Outcome]:
        """Do a job for all captures.

        A worker that dies (killed, out of memory, a crash in a library) is replaced and its
        capture begun again; a capture on which `attempts` workers died has failed.

        Parameters
        ----------
        job : Job
            What is done to each capture.
        captures : sequence of str
            Absolute paths of the captures.

        Yields
        ------
        Outcome
            One for each capture, in the order in which they are finished.
        """
        waiting = deque((capture, 1) for capture in captures)
        begun: dict[str, int] = {}
        team: list[_Worker] = []
        try:
            while waiting or any(worker.capture for worker in team):
                while waiting and len(team) < self.workers:
                    team.append(_start(job))
                for worker in team:
                    if worker.capture is None and waiting:
                        worker.capture, attempt = waiting.popleft()
                        begun[worker.capture] = attempt
                        with suppress(OSError):  # it died; receiving finds out
                            worker.pipe.send(worker.capture)
                for worker in _ready(team):
                    yield from self._settle(worker, team, waiting, begun, job)
        finally:
            for worker in team:
                _stop(worker)

    def _settle(
        self,
        worker: _Worker,
        team: list[_Worker],
        waiting: deque[tuple[str, int]],
        begun: dict[str, int],
        job: Job,
    ) -> Iterator[Outcome]:
        """Take a worker's result, or start its capture again if it died."""
        capture = worker.capture
        try:
            outcome: Outcome = worker.pipe.recv()
        except (EOFError, OSError):  # it died
            team.remove(worker)
            _stop(worker)
            if capture is None:
                return
            attempt = begun[capture]
            if attempt < self.attempts:
                waiting.appendleft((capture, attempt + 1))
                return
            yield Outcome(
                capture=capture,
                store=str(job.store(capture)),
                state="failed",
                error=f"{attempt} workers died on it, the last {_cause(worker.process)}",
                attempts=attempt,
            )
            return
        worker.capture = None
        yield replace(outcome, attempts=begun[outcome.capture])


def _ready(team: list[_Worker]) -> list[_Worker]:
    """Workers that have sent something or died; waits for the first."""
    ready = wait([worker.pipe for worker in team])
    return [worker for worker in team if worker.pipe in ready]


def _start(job: Job) -> _Worker:
    # a fresh interpreter: forking a process with threads may lock up
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, job), daemon=True)
    with _environment(ONE_THREAD):
        process.start()
    theirs.close()  # the worker's end is then the only one: its death closes the pipe
    return _Worker(process, ours)


def _serve(pipe: Any, job: Job) -> None:
    """Receive captures and send outcomes until the other end of the pipe closes."""
    # Ctrl-C reaches the whole process group; the parent stops the workers
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        while True:
            pipe.send(work(pipe.recv(), job))


def _stop(worker: _Worker) -> None:
    worker.pipe.close()  # an idle worker then ends by itself
    if worker.capture is not None:
        worker.process.terminate()
    worker.process.join(timeout=5)
    if worker.process.exitcode is None:
        worker.process.kill()
        worker.process.join()


def _cause(process: BaseProcess) -> str:
    code = process.exitcode
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = ": out of memory?" if -code == getattr(signal, "SIGKILL", None) else ""
        return f"by {name}{hint}"
    return f"with exit code {code}"


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
