# SPDX-License-Identifier: Apache-2.0
"""Limits on open connections: who asks for something is served, who only waits makes way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import msgspec

REFUSAL = b"".join(
    [
        b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\nretry-after: 1\r\n",
        b"content-type: application/json\r\ncontent-length: %d\r\n\r\n",
    ]
)


class Connection(Protocol):
    """A connection of a client."""

    @property
    def waits(self) -> bool:
        """True if the client has no request in progress."""
        ...

    def hang_up(self) -> None:
        """Close the connection at once."""
        ...


class Connections:
    """Open connections, of which there are at most so many in all and of one address.

    If there is no room for a new connection, the oldest one without a request in progress makes
    way, so that idle connections, however many, keep nobody out.

    Parameters
    ----------
    total : int
        Most open connections.
    per_address : int
        Most open connections of one client address.
    is_proxy : callable, optional
        Returns True for the address of a proxy, which stands for many clients: only the total limit
        holds for it.
    """

    def __init__(
        self,
        total: int,
        per_address: int,
        /,
        *,
        is_proxy: Callable[[str], bool] = lambda _: False,
    ) -> None:
        self._total, self._per_address, self._is_proxy = total, per_address, is_proxy
        self._open: dict[Connection, str] = {}  # oldest first
        self.refused = 0

    def __len__(self) -> int:
        """Return the number of open connections."""
        return len(self._open)

    def admit(self, connection: Connection, address: str, /) -> bool:
        """Take a new connection, in place of an idle one if need be.

        Parameters
        ----------
        connection : Connection
            The new connection.
        address : str
            Address of the client.

        Returns
        -------
        bool
            False if there is no room for it.
        """
        of_address = [other for other, its in self._open.items() if its == address]
        crowd: list[Connection] | None = None
        if len(of_address) >= self._per_address and not self._is_proxy(address):
            crowd = of_address
        elif len(self._open) >= self._total:
            crowd = list(self._open)
        if crowd is not None:
            oldest = next((other for other in crowd if other.waits), None)
            self.refused += 1
            if oldest is None:
                return False
            self._open.pop(oldest)
            oldest.hang_up()
        self._open[connection] = address
        return True

    def remove(self, connection: Connection, /) -> None:
        """Forget a connection that is closed."""
        self._open.pop(connection, None)


def address_of(transport: Any, /) -> str:
    """Return the address of the other end of a connection.

    Parameters
    ----------
    transport : asyncio.BaseTransport
        The connection.

    Returns
    -------
    str
        Address, ``"unknown"`` if it has none.
    """
    return (transport.get_extra_info("peername") or ("unknown",))[0]


def refusal(reason: str, /) -> bytes:
    """Return the answer to a connection for which there is no room.

    Parameters
    ----------
    reason : str
        Reason for the client.

    Returns
    -------
    bytes
        Answer with status 503 and a body in JSON.
    """
    body = msgspec.json.encode({"error": reason})
    return REFUSAL % len(body) + body
