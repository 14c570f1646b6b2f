# SPDX-License-Identifier: Apache-2.0
"""The daemon as people run it: a process of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from support.lines import Lines

PATIENCE_S = 240.0


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for something that must come."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {PATIENCE_S:g} s until {what}"
        time.sleep(0.05)


class Daemon:
    """A running `hueflight serve`."""

    def __init__(
        self, config: Path, environment: dict[str, str], *, faults: Path | None = None
    ) -> None:
        command = "from hueflight.cli import main; main()"
        if faults is not None:  # the folder that asks for faults of the program
            prepare = f"install(pathlib.Path({str(faults)!r}))"
            command = (
                "import pathlib, sys; "
                f"sys.path.insert(0, {str(Path(__file__).parents[1])!r}); "
                f"from support.program_faults import install; {prepare}; {command}"
            )
        self.process = subprocess.Popen(
            [sys.executable, "-c", command, "serve", str(config), "--json-logs"],
            env=os.environ | environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stderr is not None
        self._log = Lines(self.process.stderr)
        try:
            first = self._log.next(PATIENCE_S)
            if not first.startswith("{"):
                raise AssertionError(first)
        except AssertionError as error:
            _, rest = self.end(signal.SIGKILL)
            raise AssertionError(f"no daemon: {error}{rest}") from None
        self.url = json.loads(first)["url"].rstrip("/")
        self._foxglove_url = ""

    @property
    def foxglove_url(self) -> str:
        """Address for Foxglove, which is in the second line of the log."""
        if not self._foxglove_url:
            self._foxglove_url = json.loads(self._log.next(PATIENCE_S))["url"]
        return self._foxglove_url

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(self.url + path, timeout=30) as answer:
            return json.loads(answer.read())

    def post(self, path: str, body: object = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self.url + path, data=data or b"", headers={"content-type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=30) as answer:
            return json.loads(answer.read())

    def health(self) -> tuple[int, Any]:
        """Status code and content of /health."""
        try:
            with urllib.request.urlopen(self.url + "/health", timeout=30) as answer:
                return answer.status, json.loads(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, json.loads(error.read())

    def status(self) -> Any:
        return self.get("/api/status")

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Signal it, wait for its end; exit code and log."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            code = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(PATIENCE_S)
            log = self._log.rest(PATIENCE_S)
            raise AssertionError(
                f"the daemon did not end within {PATIENCE_S:g} s:\n{log}"
            ) from None
        return code, self._log.rest(PATIENCE_S)
