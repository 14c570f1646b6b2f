# SPDX-License-Identifier: Apache-2.0
"""Run the daemon: a socket, a web server with limits, and a shutdown that finishes recordings."""

from __future__ import annotations

import asyncio
import gc
import socket
import sys
from typing import Any

import h11
import structlog
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from hueflight.daemon.config import ConfigError, DaemonConfig, ServerConfig
from hueflight.daemon.http.app import make_app
from hueflight.daemon.http.connections import Connections, address_of, refusal
from hueflight.daemon.http.sender import Senders
from hueflight.daemon.http.tls import Certificate, tls_gates
from hueflight.daemon.materials import PictureMaterials
from hueflight.daemon.recordings_folder import RecordingsFolder
from hueflight.devices.rig import Connect
from hueflight.files.optional import import_optional
from hueflight.model.instrument import Instrument

log = structlog.get_logger("hueflight.daemon")
REQUEST_S = 10.0  #: a request must have arrived completely within this time
UNREAD_S = 30.0  #: a client that receives nothing for so long is disconnected
IDLE_S = 5  #: idle connections are closed after this time
HEADER_BYTES = 1 << 14
VIEWER_MESSAGE_BYTES = 1 << 12
END_S = 5
#: after which a thread that waits for the interpreter gets it. Python's own 5 ms, waited for after
#: each array operation, were most of the time of a picture beside a camera at full rate
SWITCH_INTERVAL_S = 0.5e-3
BACKLOG = 64  #: connections that may wait for the server; they are taken in one go
OWN_FILES = 192  #: open files of camera, recordings, calibrations and logs


class _LimitedRequests(H11Protocol):
    """HTTP/1.1 with limits on open connections and on the time in which a request arrives."""

    open_connections: Connections

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._expect_request()
        if not self.open_connections.admit(self, address_of(transport)):
            transport.write(refusal("too many connections are open: try again later"))
            transport.close()

    @property
    def waits(self) -> bool:
        """True if no request is in progress."""
        return self.cycle is None or self.cycle.response_complete

    def hang_up(self) -> None:
        """Close the connection at once."""
        self.transport.abort()

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
        self._deadline.cancel()  # web sockets have limits of their own
        self.open_connections.remove(self)
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        self._deadline.cancel()
        self.open_connections.remove(self)
        super().connection_lost(exc)


def open_socket(config: ServerConfig, /, *, option: str = "port") -> socket.socket:
    """Return a socket on which the daemon listens.

    Parameters
    ----------
    config : ServerConfig
        Configuration.
    option : str
        Which entry of the configuration is the port.

    Returns
    -------
    socket.socket
        Listening socket.

    Raises
    ------
    ConfigError
        If the address is not available.
    """
    port = getattr(config, option)
    family = socket.AF_INET6 if ":" in config.host else socket.AF_INET
    try:
        sock = socket.create_server((config.host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        raise ConfigError(
            f"can't listen on {config.host} port {port}: {error.strerror}: is another "
            f"daemon running? Each camera's daemon needs a port of its own (server.{option})"
        ) from None
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux; connections inherit it
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1e3 * UNREAD_S))
    return sock


def raise_file_limit(config: ServerConfig, /) -> None:
    """Raise the soft limit on open files, so that clients never use up those of recordings.

    Parameters
    ----------
    config : ServerConfig
        Limits on connections.

    Raises
    ------
    ConfigError
        If the hard limit is too low for the connections that are allowed.
    """
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    # viewers of the page and of Foxglove
    wanted = config.max_connections + 2 * config.max_viewers + 2 * BACKLOG + OWN_FILES
    unlimited = resource.RLIM_INFINITY
    if hard != unlimited and hard < wanted:
        raise ConfigError(
            f"server.max_connections = {config.max_connections}: needs {wanted} open files, the "
            f"system allows {hard}: lower it, or raise the limit (LimitNOFILE)"
        )
    if soft != unlimited and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def web_server(app: Any, config: ServerConfig, /) -> uvicorn.Server:
    """Return a server of an ASGI application with limits on size, number and time of requests.

    Parameters
    ----------
    app : ASGI application
        Application to serve.
    config : ServerConfig
        Limits.

    Returns
    -------
    uvicorn.Server
        The server, not started.

    Raises
    ------
    ConfigError
        If the certificate can't be used.
    """
    connections = Connections(
        config.max_connections,
        config.max_connections_per_address,
        is_proxy=Senders(config).is_proxy,
    )

    class Requests(_LimitedRequests):
        open_connections = connections

    protocol: Any = Requests
    if config.certificate_file:
        protocol = tls_gates(Requests, Certificate(config), connections, handshake_s=REQUEST_S)
    return uvicorn.Server(
        uvicorn.Config(
            app,
            http=protocol,
            proxy_headers=False,  # access control knows whose word to take
            ws="websockets-sansio",
            # pictures hardly shrink, and compression takes most of a core
            ws_per_message_deflate=False,
            ws_max_size=VIEWER_MESSAGE_BYTES,
            ws_ping_interval=20.0,
            ws_ping_timeout=20.0,
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
    """Run the daemon until SIGINT or SIGTERM.

    Parameters
    ----------
    config : DaemonConfig
        Configuration.
    connect : callable
        Opens the rig; see `hueflight.devices.rig.Connect`.
    instrument : Instrument
        Instrument that the camera belongs to.

    Raises
    ------
    ConfigError
        If the address or the data folder can't be used, or a token is required and missing.
    MissingPackageError
        If Foxglove is to be served, or shown recordings, and foxglove-sdk is not installed.
    """
    tokens = config.server.tokens()
    PictureMaterials(config.materials, instrument)  # refused before anything runs
    raise_file_limit(config.server)
    try:
        RecordingsFolder(config.folder / "recordings")
    except OSError as error:
        raise ConfigError(
            f"data = {config.data!r}: can't use the folder: {error.strerror or error}"
        ) from None
    sockets = [open_socket(config.server)]
    if config.foxglove or config.recording.foxglove_hz:
        import_optional("foxglove", extra="foxglove")
    if config.foxglove:
        sockets.append(open_socket(config.server, option="foxglove_port"))
    host, port, *_ = sockets[0].getsockname()
    foxglove_port = sockets[1].getsockname()[1] if config.foxglove else None
    shown = f"[{host}]" if ":" in host else host
    app = make_app(
        config, connect, instrument, port=port, tokens=tokens, foxglove_port=foxglove_port
    )
    web = web_server(app, config.server)
    # a full garbage collection of all modules would stop everything else for 0.1 s
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    url = f"{config.server.scheme}://{shown}:{port}/"
    log.info("listening", url=url, name=config.name, token=tokens.operator is not None)
    if config.foxglove:
        scheme = "wss" if config.server.certificate_file else "ws"
        log.info("listening for Foxglove", url=f"{scheme}://{shown}:{foxglove_port}/")
    asyncio.run(web.serve(sockets=sockets))
