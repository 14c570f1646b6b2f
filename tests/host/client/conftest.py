# SPDX-License-Identifier: Apache-2.0
"""A daemon as people run it, with the simulated instrument, on loopback."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="the extra 'daemon' is not installed")

from support.daemon_process import Daemon
from support.small_daemon import small_daemon, small_instrument

StartDaemon = Callable[..., Daemon]


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartDaemon]:
    """Function that starts a daemon; see `small_daemon`."""
    instrument = small_instrument(tmp_path_factory.mktemp("instrument"))
    started: list[Daemon] = []

    def run(folder: Path, **settings: Any) -> Daemon:
        started.append(small_daemon(folder, instrument, **settings))
        return started[-1]

    yield run
    for daemon in started:
        daemon.end()


@pytest.fixture(scope="module")
def daemon(start: StartDaemon, tmp_path_factory: pytest.TempPathFactory) -> Daemon:
    return start(tmp_path_factory.mktemp("daemon"))
