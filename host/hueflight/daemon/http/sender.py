# SPDX-License-Identifier: Apache-2.0
"""Who sends a request, and to which host: what the connection says, or a trusted proxy."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Mapping
from dataclasses import dataclass

from starlette.types import Scope

from hueflight.daemon.http.refusal import RequestRefusedError
from hueflight.daemon.server_config import LOOPBACK, ServerConfig

_FORWARDED = ("x-forwarded-for", "x-forwarded-host", "x-forwarded-proto")
_DEFAULT_PORTS = {"http": 80, "https": 443}
_PAIR = re.compile(r'\s*([A-Za-z]+)\s*=\s*("[^"]*"|[^\s;,"]+)\s*')  # RFC 7239, section 4
_ADDRESS = re.compile(r"\[([0-9A-Fa-f:.]+)\](?::\d+)?|([0-9.]+)(?::\d+)?|([0-9A-Fa-f:.]+)")


@dataclass(frozen=True)
class Sender:
    """Who sends a request, and to which host.

    Attributes
    ----------
    client : str
        Address of the client, for limits and logs.
    host : str
        Host that the client has addressed, with the port if it was stated.
    scheme : str
        ``"http"`` or ``"https"``.
    """

    client: str
    host: str
    scheme: str


class Senders:
    """Finds out who sends requests.

    Parameters
    ----------
    config : ServerConfig
        Says which proxies are trusted.
    """

    def __init__(self, config: ServerConfig, /) -> None:
        self._proxies = config.proxy_networks()

    def is_proxy(self, address: str, /) -> bool:
        """Return whether an address is that of a trusted proxy.

        Parameters
        ----------
        address : str
            Address of the other end of a connection.

        Returns
        -------
        bool
            True if its word on a request is taken.
        """
        try:
            found = ipaddress.ip_address(address)
        except ValueError:
            return False
        mapped = getattr(found, "ipv4_mapped", None)
        return any((mapped or found) in network for network in self._proxies)

    def of(self, scope: Scope, headers: Mapping[str, str], /) -> Sender:
        """Return who sends a request.

        Forwarding headers count only if the connection comes from a trusted proxy. Of a chain of
        proxies, the client is the last address that is none of a trusted proxy: whatever stands
        before it, the client can have invented.

        Parameters
        ----------
        scope : Scope
            The request.
        headers : mapping of str to str
            Its header fields by lower-case name.

        Returns
        -------
        Sender
            Client, host and scheme.

        Raises
        ------
        RequestRefusedError
            If a trusted proxy states client, host or scheme in a form that can't be read, or in
            two ways.
        """
        client = (scope.get("client") or ("unknown", 0))[0]
        secure = scope.get("scheme") in ("https", "wss")
        direct = Sender(client, headers.get("host", ""), "https" if secure else "http")
        if not self.is_proxy(client):
            return direct
        if "forwarded" in headers:
            if any(name in headers for name in _FORWARDED):
                raise _unclear("'Forwarded' stands beside 'X-Forwarded-…': let the proxy send one")
            return self._of_forwarded(headers["forwarded"], direct)
        return self._of_x_forwarded(headers, direct)

    def _of_x_forwarded(self, headers: Mapping[str, str], direct: Sender) -> Sender:
        hops = [_address(hop) for hop in headers.get("x-forwarded-for", "").split(",") if hop]
        host = headers.get("x-forwarded-host", direct.host)
        scheme = headers.get("x-forwarded-proto", direct.scheme)
        if "," in host or "," in scheme:
            raise _unclear("X-Forwarded-Host or X-Forwarded-Proto has several values")
        return self._checked(hops, host.strip(), scheme.strip(), direct)

    def _of_forwarded(self, text: str, direct: Sender) -> Sender:
        elements = [_pairs(element) for element in text.split(",")]
        hops = [_address(found["for"]) for found in elements if "for" in found]
        nearest = elements[-1]  # the one that the trusted proxy has added
        host, scheme = nearest.get("host", direct.host), nearest.get("proto", direct.scheme)
        return self._checked(hops, host, scheme, direct)

    def _checked(self, hops: list[str], host: str, scheme: str, direct: Sender) -> Sender:
        if scheme not in _DEFAULT_PORTS:
            raise _unclear(f"scheme {scheme[:20]!r} is neither 'http' nor 'https'")
        client = next((hop for hop in reversed(hops) if not self.is_proxy(hop)), None)
        return Sender(client or (hops[0] if hops else direct.client), host, scheme)


class ServedHosts:
    """Hosts by which clients may address the daemon.

    Parameters
    ----------
    config : ServerConfig
        Names its own address and the further hosts.
    port : int
        Port on which the daemon listens.
    """

    def __init__(self, config: ServerConfig, port: int, /) -> None:
        own = {*LOOPBACK, config.host} - {"0.0.0.0", "::", ""}
        self._served: set[tuple[str, int | None]] = {(name.lower(), port) for name in own}
        for entry in config.allowed_hosts:
            name, _, stated = entry.rpartition(":") if _has_port(entry) else (entry, "", "")
            wanted = None if stated == "*" else int(stated or port)
            self._served.add((name.lower().strip("[]"), wanted))

    def serves(self, sender: Sender, /) -> bool:
        """Return whether a host is served.

        Parameters
        ----------
        sender : Sender
            States the host and the scheme, which decides about a port that is not stated.

        Returns
        -------
        bool
            True if it is.
        """
        name, port = split_host(sender.host, sender.scheme)
        return (name, port) in self._served or bool(name and (name, None) in self._served)


def split_host(host: str, scheme: str, /) -> tuple[str, int]:
    """Return name and port of a host as a request states it.

    Parameters
    ----------
    host : str
        Name or address, with or without a port.
    scheme : str
        Scheme, which says the port where none is stated.

    Returns
    -------
    tuple of (str, int)
        Name in lower case and port; no name and port 0 if the text is not a host.
    """
    match = re.fullmatch(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::(\d{1,5}))?", host)
    if match is None:
        return "", 0
    return match[1].lower().strip("[]"), int(match[2] or _DEFAULT_PORTS[scheme])


def _has_port(entry: str) -> bool:
    return ":" in entry.rpartition("]")[2]


def _pairs(element: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for part in element.split(";"):
        match = _PAIR.fullmatch(part)
        if match is None or match[1].lower() in found:
            raise _unclear(f"Forwarded: {element[:80]!r} is not as in RFC 7239")
        found[match[1].lower()] = match[2].strip('"')
    return found


def _address(text: str) -> str:
    match = _ADDRESS.fullmatch(text.strip().strip('"'))
    try:
        return str(ipaddress.ip_address(match[1] or match[2] or match[3] if match else ""))
    except ValueError:
        raise _unclear(f"{text[:80]!r} is no address of a client") from None


def _unclear(reason: str) -> RequestRefusedError:
    return RequestRefusedError(
        400, f"the proxy does not say clearly who asks: {reason}", "forwarded"
    )
