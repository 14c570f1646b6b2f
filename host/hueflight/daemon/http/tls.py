# SPDX-License-Identifier: Apache-2.0
"""TLS by certificate files: renewed files are read by themselves, unfinished handshakes are few."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import structlog

from hueflight.daemon.config_section import ConfigError
from hueflight.daemon.http.connections import Connections, address_of
from hueflight.daemon.server_config import ServerConfig

LOOK_S = 10.0  #: at most so often is looked whether the files were renewed
_READABLE_BY_ALL = 0o007
log = structlog.get_logger("hueflight.daemon")


class Certificate:
    """The daemon's certificate, read again when its files change.

    Parameters
    ----------
    config : ServerConfig
        Names the files.

    Raises
    ------
    ConfigError
        If the files can't be used, or everybody may read the key.
    """

    def __init__(self, config: ServerConfig, /) -> None:
        self._files = [Path(config.certificate_file), Path(config.key_file)]
        self._files = [file.expanduser() for file in self._files]
        self._looked_s = time.monotonic()
        self._version = self._stamp()
        self._context = self._load()

    def context(self) -> ssl.SSLContext:
        """Return the context of new connections.

        Returns
        -------
        ssl.SSLContext
            Of the present files, or the ones before if the present ones can't be used.
        """
        now = time.monotonic()
        if now - self._looked_s >= LOOK_S:
            self._looked_s = now
            version = self._stamp()
            if version != self._version:
                self._version = version
                try:
                    self._context = self._load()
                except ConfigError as error:
                    log.error("the renewed certificate can't be used", reason=str(error))
                else:
                    log.info("certificate renewed", path=str(self._files[0]))
        return self._context

    def _stamp(self) -> list[int]:
        found = []
        for file in self._files:
            with contextlib.suppress(OSError):  # told when the files are read
                found.append(file.stat().st_mtime_ns)
        return found

    def _load(self) -> ssl.SSLContext:
        certificate, key = self._files
        try:
            if key.stat().st_mode & _READABLE_BY_ALL:
                raise ConfigError(f"everybody may read {key}: chmod o-rwx {key}")
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.minimum_version = ssl.TLSVersion.TLSv1_2
            context.load_cert_chain(certificate, key, password=_no_password)
        except (OSError, ValueError) as error:
            if isinstance(error, ConfigError):
                raise
            raise ConfigError(
                f"can't use server.certificate_file = {str(certificate)!r} with "
                f"server.key_file = {str(key)!r}: {error}"
            ) from None
        return context


def _no_password() -> str:
    raise ValueError("the key is encrypted: store it without a password, readable by the daemon")


class _Held(asyncio.Protocol):
    """Keeps what comes with the end of a handshake, until somebody can take it."""

    def __init__(self) -> None:
        self.data = b""
        self.lost = False

    def data_received(self, data: bytes) -> None:
        self.data += data

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost = True


class TlsGate(asyncio.Protocol):
    """A connection until its handshake is over; counted from the first moment.

    Parameters
    ----------
    protocol : asyncio.Protocol
        Speaks with the client after the handshake.
    certificate : Certificate
        Certificate to show.
    connections : Connections
        Limits on open connections.
    handshake_s : float
        Time within which the handshake must be over.
    """

    waits = True  # no request is in progress

    def __init__(
        self,
        protocol: asyncio.Protocol,
        certificate: Certificate,
        connections: Connections,
        /,
        *,
        handshake_s: float,
    ) -> None:
        self._protocol, self._certificate = protocol, certificate
        self._connections, self._handshake_s = connections, handshake_s
        self._transport: Any = None
        self._task: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin the handshake if there is room for the connection."""
        self._transport = transport
        self._transport.pause_reading()  # until TLS reads
        if self._connections.admit(self, address_of(transport)):
            self._task = asyncio.get_running_loop().create_task(self._shake_hands())
        else:
            self._transport.abort()  # nothing can be said before there is TLS

    def hang_up(self) -> None:
        """Close the connection at once."""
        self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._connections.remove(self)
        if self._task is not None:
            self._task.cancel()

    async def _shake_hands(self) -> None:
        loop, held = asyncio.get_running_loop(), _Held()
        try:
            secured = await loop.start_tls(
                self._transport,
                held,
                self._certificate.context(),
                server_side=True,
                ssl_handshake_timeout=self._handshake_s,
            )
        except (OSError, ssl.SSLError):  # no TLS is spoken, or the client has left
            self._transport.abort()
            return
        finally:
            self._connections.remove(self)
        if secured is None or held.lost:
            return
        secured.set_protocol(self._protocol)
        self._protocol.connection_made(secured)
        if held.data:
            self._protocol.data_received(held.data)


def tls_gates(
    protocol: Callable[..., asyncio.Protocol],
    certificate: Certificate,
    connections: Connections,
    /,
    *,
    handshake_s: float,
) -> Callable[..., asyncio.Protocol]:
    """Return what makes the protocol of each new connection.

    Parameters
    ----------
    protocol : callable
        Makes the protocol that speaks with the client after the handshake.
    certificate : Certificate
        Certificate to show.
    connections : Connections
        Limits on open connections.
    handshake_s : float
        Time within which a handshake must be over.

    Returns
    -------
    callable
        Makes a `TlsGate`.
    """

    def gate(**arguments: Any) -> asyncio.Protocol:
        return TlsGate(protocol(**arguments), certificate, connections, handshake_s=handshake_s)

    return gate
