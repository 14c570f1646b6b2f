# SPDX-License-Identifier: Apache-2.0
"""An application on the daemon's web server, in a thread of the test."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hueflight.daemon.config import ServerConfig
from hueflight.daemon.http import server

WAIT_S = 60.0


@contextmanager
def serving(app: Any, config: ServerConfig) -> Iterator[int]:
    """Serve an application; the port on which it is."""
    sock = server.open_socket(config)
    web = server.web_server(app, config)
    thread = threading.Thread(target=lambda: asyncio.run(web.serve(sockets=[sock])))
    thread.start()
    try:
        yield sock.getsockname()[1]
    finally:
        web.should_exit = True
        thread.join(WAIT_S)
    assert not thread.is_alive()
