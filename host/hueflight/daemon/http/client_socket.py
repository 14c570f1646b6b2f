# SPDX-License-Identifier: Apache-2.0
"""What the web sockets of all clients have in common: their limits, and how they end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Coroutine
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

STATUS_S = 0.5  #: from one look at the daemon's status to the next
SEND_TIMEOUT_S = 15.0  #: a client that receives nothing for so long is disconnected
MESSAGES_PER_S = 200  #: from a client; one that sends more is disconnected
_CLOSE_S = 1.0


async def serve_until_one_ends(socket: WebSocket, /, *works: Coroutine[Any, Any, None]) -> None:
    """Serve a client until one of its works has ended, then end the others and the connection.

    Parameters
    ----------
    socket : WebSocket
        The client's accepted web socket.
    *works : coroutine
        What is done for the client at the same time. An exception ends a work, too.
    """
    tasks = [asyncio.create_task(work) for work in works]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if socket.client_state == WebSocketState.CONNECTED:
        try:
            await asyncio.wait_for(socket.close(1008), _CLOSE_S)
        except (RuntimeError, TimeoutError, WebSocketDisconnect):
            return  # it has been closed meanwhile


async def received_texts(socket: WebSocket, /) -> AsyncIterator[str]:
    """Yield what a client sends, until it leaves or sends too much.

    Parameters
    ----------
    socket : WebSocket
        The client's accepted web socket.

    Yields
    ------
    str
        A message; empty for one that is no text.
    """
    since, count = time.monotonic(), 0
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
        if time.monotonic() - since > 1.0:
            since, count = time.monotonic(), 0
        count += 1
        if count > MESSAGES_PER_S:
            return
        yield message.get("text") or ""
