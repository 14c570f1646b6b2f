# SPDX-License-Identifier: Apache-2.0
"""Runs of tests in processes that have loaded the libraries of others already.

Most of a short run of tests goes into imports. A server loads what the tests of the host load, but
for our own packages, and forks a process for each run, in which these are loaded from the copy.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

OWN = ("hueflight", "hueflight_protocol", "hueflight_hdl", "support", "tests", "conftest")
FOLLOWED = ("hueflight", "hueflight.reconstruction", "hueflight.recording", "hueflight_protocol")
OTHERS = ("pytest", "hypothesis", "scipy.io", "scipy.ndimage", "scipy.stats")
LOADED_ALREADY = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
TICK = 0.02  #: seconds between looks at a run


class WarmTests:
    """A server of runs of tests.

    Parameters
    ----------
    tree : Path
        Folder in which the tests run.
    environment : mapping of str to str
        Their environment.
    prefix : list of str
        Command in front of the server.
    """

    def __init__(self, tree: Path, environment: Mapping[str, str], prefix: list[str]) -> None:
        self.server = subprocess.Popen(
            [*prefix, sys.executable, __file__],
            cwd=tree,
            env={**environment, "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(
        self, arguments: list[str], *, limit: float | None, timeout: float | None
    ) -> tuple[bool, float]:
        """Run pytest.

        Parameters
        ----------
        arguments : list of str
            Its arguments.
        limit : float, optional
            Seconds of the processor that it may take.
        timeout : float, optional
            Seconds on the clock that it may take.

        Returns
        -------
        passed : bool
            Whether all tests passed in that time.
        seconds : float
            Seconds of the processor.
        """
        assert self.server.stdin
        assert self.server.stdout
        self.server.stdin.write(json.dumps([arguments, limit, timeout]) + "\n")
        self.server.stdin.flush()
        passed, seconds = json.loads(self.server.stdout.readline())
        return passed, seconds

    def close(self) -> None:
        """End the server."""
        self.server.communicate()


def load_libraries() -> None:
    """Load what our packages load of others."""
    reader, writer = os.pipe()
    if not os.fork():
        for name in FOLLOWED:
            __import__(name)
        os.write(writer, json.dumps(list(sys.modules)).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as names:
        loaded = json.loads(names.read())
    os.wait()
    for name in [*OTHERS, *loaded]:
        if name.partition(".")[0] not in OWN:
            with contextlib.suppress(Exception):
                __import__(name)


def serve() -> None:
    """Answer each line of JSON on the standard input with one on the standard output."""
    load_libraries()
    for line in sys.stdin:
        arguments, limit, timeout = json.loads(line)
        child = os.fork()
        if not child:
            _run_tests(arguments, limit)
        print(json.dumps(_wait(child, timeout)), flush=True)


def _run_tests(arguments: list[str], limit: float | None) -> None:
    """Run pytest in this process, and end it."""
    os.setpgid(0, 0)
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nothing, stream)
    if limit is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (round(limit), round(limit) + 1))
    code = 1
    try:
        import pytest

        code = int(pytest.main([*LOADED_ALREADY, *arguments]))
    finally:
        os._exit(code)


def _wait(child: int, timeout: float | None) -> tuple[bool, float]:
    """Return whether a run has passed, and how long the processor worked."""
    end = None if timeout is None else time.monotonic() + timeout
    while True:
        found, status, used = os.wait4(child, os.WNOHANG)
        if found:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)  # what the tests have left running
            return status == 0, used.ru_utime + used.ru_stime
        if end is not None and time.monotonic() > end:
            os.killpg(child, signal.SIGKILL)
            end = None
        time.sleep(TICK)


if __name__ == "__main__":
    sys.path.pop(0)  # the folder of this file
    serve()
