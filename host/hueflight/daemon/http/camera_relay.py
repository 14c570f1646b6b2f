# SPDX-License-Identifier: Apache-2.0
"""Live pictures of another daemon, passed on to a viewer of this one.

A page may only connect to the daemon that it comes from. This daemon connects to the others with
the tokens of its configuration, which no viewer sees.
"""

from __future__ import annotations

from typing import Any

import structlog
from starlette.websockets import WebSocket
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from hueflight.client.requests import Requests
from hueflight.client.stream import socket_options
from hueflight.daemon.http.client_socket import received_texts, serve_until_one_ends
from hueflight.live.protocol import PROTOCOL

log = structlog.get_logger("hueflight.daemon")
OPEN_S = 5.0  #: within which the other daemon must accept the connection


async def relay(socket: WebSocket, other: Requests, /) -> None:
    """Pass messages on between a viewer and another daemon until one of them leaves.

    Parameters
    ----------
    socket : WebSocket
        The viewer's web socket, which is not accepted yet.
    other : Requests
        Address and token of the other daemon.
    """
    address = other.address
    scheme = "wss" if address.secure else "ws"
    url = f"{scheme}://{address.netloc}/api/live"
    try:
        async with connect(url, open_timeout=OPEN_S, **socket_options(other.token)) as upstream:
            offered = socket.scope.get("subprotocols", [])
            await socket.accept(subprotocol=PROTOCOL if PROTOCOL in offered else None)
            await serve_until_one_ends(
                socket, _pass_down(socket, upstream), _pass_up(socket, upstream)
            )
    except (OSError, TimeoutError, WebSocketException) as error:
        log.info("another camera can't be shown", address=address.netloc, reason=str(error))
        await socket.close(1013, f"{address.netloc} can't be reached")


async def _pass_down(socket: WebSocket, upstream: Any) -> None:
    async for message in upstream:
        if isinstance(message, str):
            await socket.send_text(message)
        else:
            await socket.send_bytes(message)


async def _pass_up(socket: WebSocket, upstream: Any) -> None:
    async for text in received_texts(socket):
        await upstream.send(text)
