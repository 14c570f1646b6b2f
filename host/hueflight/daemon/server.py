"""Running the daemon: a socket, a web server with limits, an end that finishes recordings."""

from __future__ import annotations

import asyncio
import gc
import socket
from typing import Any

import h11
import structlog
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from hueflight.daemon.app import make_app
from hueflight.daemon.config import ConfigError, DaemonConfig, ServerConfig
from hueflight.devices.rig import Connect
from hueflight.model.instrument import Instrument

log = structlog.get_logger("hueflight.daemon")
REQUEST_S = 10.0  #: a request must have come in by then
UNREAD_S = 30.0  #: a client that takes nothing of what is sent is cut off
IDLE_S = 5  #: an idle connection is closed after so long
HEADER_BYTES = 1 << 14
VIEWER_MESSAGE_BYTES = 1 << 12
END_S = 5


class _Impatient(H11Protocol):
    """HTTP/1.1 that hangs up on clients who take for ever to send a request, body included."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._expect_request()

    def _expect_request(self) -> None:
        self._deadline = self.loop.call_later(REQUEST_S, self._hang_up)

    def _hang_up(self) -> None:
        awaited = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        if awaited and not self.transport.is_closing():
            self.transport.close()

    def on_response_complete(self) -> None:
        self._deadline.cancel()
        self._expect_request()
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._deadline.cancel()  # the connection is another protocol's from here on
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        self._deadline.cancel()
        super().connection_lost(exc)


def open_socket(config: DaemonConfig) -> socket.socket:
    """The socket to listen on.

    Raises
    ------
    ConfigError
        If the address can't be had.
    """
    server = config.server
    family = socket.AF_INET6 if ":" in server.host else socket.AF_INET
    try:
        sock = socket.create_server((server.host, server.port), family=family, backlog=128)
    except OSError as error:
        raise ConfigError(
            f"can't listen on {server.host} port {server.port}: {error.strerror}: is another "
            "daemon running? Each camera's daemon needs a port of its own (server.port)"
        ) from None
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux; connections inherit it
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1e3 * UNREAD_S))
    return sock


def web_server(app: Any, config: ServerConfig, /) -> uvicorn.Server:
    """A server of an ASGI app that bounds what clients may ask of it, in size, number and time."""
    return uvicorn.Server(
        uvicorn.Config(
            app,
            http=_Impatient,
            ws="websockets-sansio",
            ws_per_message_deflate=False,  # pictures hardly shrink, and it costs most of a core
            ws_max_size=VIEWER_MESSAGE_BYTES,
            ws_ping_interval=20.0,
            ws_ping_timeout=20.0,
            limit_concurrency=config.max_connections,
            timeout_keep_alive=IDLE_S,
            timeout_graceful_shutdown=END_S,
            h11_max_incomplete_event_size=HEADER_BYTES,
            log_config=None,
            access_log=False,
            server_header=False,
            lifespan="on",
        )
    )


def serve(config: DaemonConfig, connect: Connect, instrument: Instrument, /) -> None:
    """Run until SIGINT or SIGTERM.

    Raises
    ------
    ConfigError
        If the address can't be had, or a token is needed and missing.
    """
    token = config.server.token()
    sock = open_socket(config)
    host, port = sock.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    app = make_app(config, connect, instrument, port=port, token=token)
    # a full collection goes through all modules for 0.1 s, in which nothing else runs
    gc.collect()
    gc.freeze()
    log.info("listening", url=f"http://{shown}:{port}/", name=config.name, token=token is not None)
    asyncio.run(web_server(app, config.server).serve(sockets=[sock]))
