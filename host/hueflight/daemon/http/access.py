# SPDX-License-Identifier: Apache-2.0
"""Access control: hosts, origins, tokens, and limits on requests.

Every page in the user's browser can reach a daemon on loopback. Therefore a request must name a
host that this daemon serves (against DNS rebinding), and if a page sent it, that page must be the
daemon's own. Who sends a request, and what its token is good for, is decided in `sender` and
`roles`.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import MutableMapping
from urllib.parse import urlsplit

import structlog
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hueflight.daemon.http.refusal import RequestRefusedError, refuse
from hueflight.daemon.http.roles import (
    GUARDED,
    SESSION_PATH,
    Permission,
    check_permission,
    permission,
)
from hueflight.daemon.http.sender import Sender, Senders, ServedHosts, split_host
from hueflight.daemon.server_config import ServerConfig, Tokens

PERMISSION = "hueflight.permission"  #: key of the scope that holds the `Permission` of a request
_CLIENTS_KEPT = 1024
LOG_S = 1.0  #: from one log entry about refused requests to the next
log = structlog.get_logger("hueflight.daemon")
_HEADERS = [
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        b"connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
]


class AccessControl:
    """Middleware that refuses requests which are not allowed.

    Parameters
    ----------
    app : ASGI application
        Application behind it.
    config : ServerConfig
        Hosts and limits.
    port : int
        Port on which the daemon listens.
    tokens : Tokens
        Tokens that clients must send.

    Attributes
    ----------
    refused : int
        Requests that were refused.
    """

    def __init__(self, app: ASGIApp, config: ServerConfig, /, *, port: int, tokens: Tokens) -> None:
        self._app, self._config, self._tokens = app, config, tokens
        self._senders, self._hosts = Senders(config), ServedHosts(config, port)
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self.refused = 0
        self._logged_s = float("-inf")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer why it is refused."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        client = (scope.get("client") or ("unknown", 0))[0]
        send = _with_security_headers(send)
        try:
            headers = _headers(scope)
            try:
                sender = self._senders.of(scope, headers)
                client = sender.client
                found = self._check_sender(scope, headers, sender)
            except RequestRefusedError:
                # a page of another site in the user's own browser must not use up the user's
                # requests, nor may one who guesses tokens
                self._check_rate(f"{client} refused")
                raise
            guessing = scope["path"] == SESSION_PATH and found.token == "wrong"
            self._check_rate(f"{client} refused" if guessing else client)
            limited = _Body(receive, self._config.max_body_bytes, headers)
        except RequestRefusedError as refused:
            self._log(scope, client, refused)
            await refuse(scope, receive, send, refused)
            return
        scope[PERMISSION] = found
        await self._app(scope, limited if scope["type"] == "http" else receive, send)

    def _check_sender(
        self, scope: Scope, headers: MutableMapping[str, str], sender: Sender
    ) -> Permission:
        host = sender.host
        if not self._hosts.serves(sender):
            raise RequestRefusedError(
                421,
                f"host {host[:80]!r} is not served by this daemon: add it to server.allowed_hosts",
                "host",
            )
        origin = headers.get("origin")
        if origin is not None and not _is_same(origin, sender):
            raise RequestRefusedError(
                403, "the request comes from a page of another origin", "origin"
            )
        site = headers.get("sec-fetch-site", "none")
        if site not in ("same-origin", "none") and scope["path"].startswith(GUARDED):
            raise RequestRefusedError(
                403, "the request comes from a page of another site", "origin"
            )
        found = permission(self._tokens, headers)
        check_permission(scope, found)
        return found

    def _log(self, scope: Scope, client: str, refused: RequestRefusedError) -> None:
        """Log a refused request; at most one each second, with the number of those before it."""
        self.refused += 1
        now = time.monotonic()
        if now - self._logged_s < LOG_S:
            return
        log.warning(
            "request refused",
            client=client,
            path=scope["path"][:200],
            status=refused.status,
            reason=str(refused),
            refused_in_all=self.refused,
        )
        self._logged_s = now

    def _check_rate(self, client: str) -> None:
        """Limit requests of each address with a token bucket."""
        config, now = self._config, time.monotonic()
        left, since = self._buckets.pop(client, (float(config.burst), now))
        left = min(float(config.burst), left + (now - since) * config.requests_per_s)
        allowed = left >= 1
        self._buckets[client] = (left - 1 if allowed else left, now)
        while len(self._buckets) > _CLIENTS_KEPT:
            self._buckets.popitem(last=False)
        if not allowed:
            raise RequestRefusedError(
                429, f"more than {config.requests_per_s:g} requests per second", "rate"
            )


class _Body:
    """Reads a request's body up to a limit."""

    def __init__(self, receive: Receive, limit: int, headers: MutableMapping[str, str]) -> None:
        self._receive, self._left, self._limit = receive, limit, limit
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > limit:
            raise RequestRefusedError(
                413, f"the body of a request may have at most {limit} bytes", "size"
            )

    async def __call__(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.request":
            self._left -= len(message.get("body", b""))
            if self._left < 0:
                # as if the client had disconnected: none of the body is used
                return {"type": "http.disconnect"}
        return message


def _is_same(origin: str, sender: Sender) -> bool:
    """Whether a page comes from the host that it addresses."""
    parts = urlsplit(origin)
    if parts.scheme not in ("http", "https"):
        return False
    return split_host(parts.netloc, parts.scheme) == split_host(sender.host, sender.scheme)


#: header fields that decide about access, and may occur only once
_ONCE = (
    "host",
    "origin",
    "authorization",
    "content-length",
    "x-forwarded-host",
    "x-forwarded-proto",
)


def _headers(scope: Scope) -> MutableMapping[str, str]:
    """Header fields by lower-case name, lists joined; some may occur only once."""
    found: dict[str, str] = {}
    for raw_name, raw_value in scope["headers"]:
        name = raw_name.decode("latin-1").lower()
        if name in found and name in _ONCE:
            raise RequestRefusedError(400, f"header {name!r} occurs twice", "header")
        value = raw_value.decode("latin-1")
        found[name] = f"{found[name]}, {value}" if name in found else value
    return found


def _with_security_headers(send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            names = {name.lower() for name, _ in message["headers"]}
            extra = [pair for pair in _HEADERS if pair[0] not in names]
            if b"cache-control" not in names:
                extra.append((b"cache-control", b"no-store"))
            message = {**message, "headers": [*message["headers"], *extra]}
        await send(message)

    return send_with_headers
