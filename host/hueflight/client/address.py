# SPDX-License-Identifier: Apache-2.0
"""Address of a daemon, as people write it."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from hueflight.client.errors import NotReachableError

DEFAULT_PORT = 8470
_SECURE = {"http": False, "ws": False, "https": True, "wss": True}


@dataclass(frozen=True)
class Address:
    """Where a daemon listens.

    Attributes
    ----------
    host : str
        Name or number of the machine.
    port : int
        Port.
    secure : bool
        True if there is TLS in front of the daemon.
    token : str or None
        Token that was part of the address.
    """

    host: str
    port: int
    secure: bool = False
    token: str | None = None

    @property
    def netloc(self) -> str:
        """Host and port as in a URL."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @classmethod
    def parse(cls, text: str) -> Address:
        """Return the address in a text.

        Parameters
        ----------
        text : str
            ``HOST``, ``HOST:PORT``, or the address of the live page, which may contain the token.

        Returns
        -------
        Address
            The address.

        Raises
        ------
        NotReachableError
            If the text is no such address.
        """
        try:
            parts = urlsplit(text if "://" in text else f"http://{text}")
            secure, host, port = _SECURE.get(parts.scheme), parts.hostname, parts.port
        except ValueError:
            raise _no_address(text) from None
        if secure is None or not host:
            raise _no_address(text)
        default = 443 if secure else DEFAULT_PORT
        token = parse_qs(parts.fragment).get("token", [None])[0]
        return cls(host, port or default, secure, token)


def _no_address(text: str) -> NotReachableError:
    return NotReachableError(
        f"{text!r} is no address of a daemon: write HOST:PORT, such as 'localhost:{DEFAULT_PORT}'"
    )
