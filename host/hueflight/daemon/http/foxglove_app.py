# SPDX-License-Identifier: Apache-2.0
"""The application on the port for Foxglove, with the access rules of the daemon's own port.

Foxglove can be given nothing but an address, and may run as a page of another origin. Therefore the
address may contain the token, and the configuration lists origins whose pages may connect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import parse_qs

from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from hueflight.daemon.http.access import AccessControl
from hueflight.daemon.server_config import ServerConfig, Tokens

PATH = "/api/foxglove"  #: what the path ``/`` of the port stands for; it needs a token


def foxglove_app(
    hub: Callable[[], Any], config: ServerConfig, /, *, port: int, tokens: Tokens
) -> ASGIApp:
    """Return the application of the port for Foxglove: nothing but a web socket.

    Parameters
    ----------
    hub : callable
        Returns the `hueflight.daemon.http.foxglove_hub.FoxgloveHub`.
    config : ServerConfig
        Hosts, origins and limits.
    port : int
        The port.
    tokens : Tokens
        Tokens that clients must send.

    Returns
    -------
    ASGI application
        The application with access control.
    """

    async def live(socket: Any) -> None:
        await hub().serve(socket)

    routes = [WebSocketRoute(PATH, live)]
    guarded = AccessControl(Starlette(routes=routes), config, port=port, tokens=tokens)
    origins = {origin.lower().encode() for origin in config.foxglove_origins}

    async def entrance(scope: Scope, receive: Receive, send: Send) -> None:
        await guarded(_as_of_the_daemon(scope, origins), receive, send)

    return entrance


def by_port(app: ASGIApp, others: Mapping[int, ASGIApp], /) -> ASGIApp:
    """Return an application that answers differently on some ports of its server.

    Parameters
    ----------
    app : ASGI application
        The application, which also has the lifespan.
    others : mapping of int to ASGI application
        Applications for connections to other ports.

    Returns
    -------
    ASGI application
        All of them.
    """

    async def chosen(scope: Scope, receive: Receive, send: Send) -> None:
        server = scope.get("server")
        await (others.get(server[1], app) if server else app)(scope, receive, send)

    return chosen


def _as_of_the_daemon(scope: Scope, origins: set[bytes]) -> Scope:
    """The request as the daemon's own page or a program would send it."""
    headers = list(scope["headers"])
    if any(name == b"origin" and value.lower() in origins for name, value in headers):
        headers = [pair for pair in headers if pair[0] not in (b"origin", b"sec-fetch-site")]
    token = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
    if token and all(name != b"authorization" for name, _ in headers):
        headers.append((b"authorization", f"Bearer {token}".encode("latin-1", "replace")))
    path = PATH if scope["path"] == "/" else scope["path"]
    return {**scope, "headers": headers, "path": path, "raw_path": path.encode()}
