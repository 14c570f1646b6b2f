# SPDX-License-Identifier: Apache-2.0
"""Configuration of the daemon's web server: address, tokens, TLS, proxies, and limits."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hueflight.daemon.config_section import ConfigError, Section, require_ranges

DEFAULT_PORT = 8470
DEFAULT_FOXGLOVE_PORT = 8765  #: where Foxglove looks for a live source
LOOPBACK = ("127.0.0.1", "::1", "localhost")
MIN_TOKEN_LENGTH = 16
_ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/\s]*")
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:(\d{1,5}|\*))?")

Role = Literal["viewer", "operator"]
"""What a client may do: a viewer sees everything and changes nothing."""


@dataclass(frozen=True)
class Tokens:
    """Tokens that clients must send.

    Attributes
    ----------
    operator : str or None
        Token of those who may do everything; None if no token is required.
    viewer : str or None
        Token of those who may only look; None if there is no such role.
    """

    operator: str | None = None
    viewer: str | None = None


class ServerConfig(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Address of the daemon, and limits on its clients.

    Attributes
    ----------
    host : str
        Address on which the daemon listens. Beyond loopback a token is required.
    port : int
        Port on which the daemon listens; 0 for any free one.
    token_file : str
        File with the token that clients must send; only its owner may be able to read it.
    viewer_token_file : str
        File with the token of clients that may look and change nothing; empty for no such clients.
    certificate_file : str
        File with the certificate of TLS and those that lead to its authority, in PEM; empty for no
        TLS.
    key_file : str
        File with the private key of the certificate, in PEM.
    allowed_hosts : tuple of str
        Further names by which browsers may address the daemon, besides loopback and `host`, each
        with the port that they use, or ``*`` for any; without a port it is that of the daemon.
    trusted_proxies : tuple of str
        Addresses and networks of reverse proxies, whose word on a request's client, host and scheme
        is taken.
    max_connections : int
        Most open connections of all clients together.
    max_connections_per_address : int
        Most open connections of one client address; does not hold for proxies.
    max_viewers : int
        Most viewers of the live picture at the same time.
    requests_per_s : float
        Requests per second that one client address may send in the long run.
    burst : int
        Requests that one client address may send at once.
    max_body_bytes : int
        Most bytes in the body of a request.
    foxglove_port : int
        Port for Foxglove, if the daemon serves it; 0 for any free one.
    foxglove_origins : tuple of str
        Origins of web pages that may connect to that port, such as ``https://app.foxglove.dev``.
    """

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    token_file: str = ""
    viewer_token_file: str = ""
    certificate_file: str = ""
    key_file: str = ""
    allowed_hosts: tuple[str, ...] = ()
    trusted_proxies: tuple[str, ...] = ()
    max_connections: int = 64
    max_connections_per_address: int = 48
    max_viewers: int = 8
    requests_per_s: float = 50.0
    burst: int = 100
    max_body_bytes: int = 1 << 16
    foxglove_port: int = DEFAULT_FOXGLOVE_PORT
    foxglove_origins: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_ranges(
            self,
            "server.",
            port=(0, 65535),
            max_connections=(4, 4096),
            max_connections_per_address=(1, 4096),
            max_viewers=(1, 256),
            requests_per_s=(1, 1e6),
            burst=(1, 1_000_000),
            max_body_bytes=(1 << 10, 1 << 24),
            foxglove_port=(0, 65535),
        )
        for origin in self.foxglove_origins:
            if not _ORIGIN.fullmatch(origin):
                raise ConfigError(
                    f"server.foxglove_origins has {origin!r}: write it as "
                    "'https://app.foxglove.dev', without a path"
                )
        for host in self.allowed_hosts:
            if not _HOST.fullmatch(host):
                raise ConfigError(
                    f"server.allowed_hosts has {host!r}: write a name, NAME:PORT or NAME:*, an "
                    "address of IPv6 in brackets"
                )
        self.proxy_networks()  # refuses what is none
        if bool(self.certificate_file) != bool(self.key_file):
            raise ConfigError(
                "server.certificate_file and server.key_file belong together: give both or none"
            )

    @property
    def beyond_loopback(self) -> bool:
        """True if other machines can reach the daemon, also if only through a proxy."""
        return self.host not in LOOPBACK or bool(self.trusted_proxies)

    @property
    def scheme(self) -> str:
        """Scheme of the daemon's own address, ``"http"`` or ``"https"``."""
        return "https" if self.certificate_file else "http"

    def proxy_networks(self) -> tuple[ipaddress.IPv4Network | ipaddress.IPv6Network, ...]:
        """Return the networks whose proxies are trusted.

        Returns
        -------
        tuple of ip_network
            The networks; a single address is one of its own.

        Raises
        ------
        ConfigError
            If an entry is neither an address nor a network.
        """
        try:
            return tuple(ipaddress.ip_network(entry) for entry in self.trusted_proxies)
        except ValueError as error:
            raise ConfigError(
                f"server.trusted_proxies: {error}: write addresses such as '127.0.0.1', or "
                "networks such as '10.0.0.0/8'"
            ) from None

    def tokens(self) -> Tokens:
        """Return the tokens that clients must send.

        Returns
        -------
        Tokens
            The tokens; none on loopback if no file is named.

        Raises
        ------
        ConfigError
            If a token is required and missing, can be read by others, or is too short, or both
            tokens are the same.
        """
        if not self.token_file:
            if self.beyond_loopback:
                named = (
                    f"server.trusted_proxies = {list(self.trusted_proxies)}"
                    if self.host in LOOPBACK
                    else f"server.host = {self.host!r}"
                )
                raise ConfigError(
                    f"{named} lets other machines in: write a token to a file "
                    "and name it in server.token_file (or --token-file), for example made by: "
                    "python3 -c 'import secrets; print(secrets.token_urlsafe())'"
                )
            if self.viewer_token_file:
                raise ConfigError(
                    "server.viewer_token_file without server.token_file: everybody would be an "
                    "operator; give both"
                )
            return Tokens()
        operator = read_token(self.token_file)
        viewer = read_token(self.viewer_token_file) if self.viewer_token_file else None
        if viewer == operator:
            raise ConfigError(
                f"{self.token_file} and {self.viewer_token_file} hold the same token: viewers "
                "would be operators"
            )
        return Tokens(operator, viewer)


def read_token(file: str, /) -> str:
    """Return the token in a file.

    Parameters
    ----------
    file : str
        Path of the file.

    Returns
    -------
    str
        The token.

    Raises
    ------
    ConfigError
        If the file can't be read, others can read it, or it holds no token.
    """
    path = Path(file).expanduser()
    try:
        token = path.read_text("ascii").strip()
        shared = path.stat().st_mode & 0o077
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"can't read the token in {path}: {error}") from None
    if shared:
        raise ConfigError(f"{path} can be read by others: chmod 600 {path}")
    if len(token) < MIN_TOKEN_LENGTH or not re.fullmatch(r"[A-Za-z0-9_.~-]+", token):
        raise ConfigError(
            f"the token in {path} must be at least {MIN_TOKEN_LENGTH} letters, digits and '-_.~'"
        )
    return token


class CameraConfig(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Another daemon, whose camera is shown beside this one's.

    Attributes
    ----------
    address : str
        ``HOST:PORT``, or the address of its page.
    token_file : str
        File with a token of that daemon; empty if it requires none.
    """

    address: str
    token_file: str = ""
