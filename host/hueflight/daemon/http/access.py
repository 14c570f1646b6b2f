# SPDX-License-Identifier: Apache-2.0
"""Access control: hosts, origins, tokens, and limits on requests.

Every page in the user's browser can reach a daemon on loopback. Therefore a request must name a
host that this daemon serves (against DNS rebinding), and if a page sent it, that page must be the
daemon's own.
"""

from __future__ import annotations

import hmac
import json
import time
from collections import OrderedDict
from collections.abc import MutableMapping
from typing import Any
from urllib.parse import urlsplit

import structlog
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hueflight.daemon.config import LOOPBACK, ServerConfig
from hueflight.live.protocol import TOKEN_PROTOCOL

#: paths that need the token; the page, which holds no secret, and /health need none
GUARDED = ("/api/", "/metrics", "/openapi.json")
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


class RequestRefused(Exception):  # noqa: N818 - a decision, not an error
    """A request that is refused.

    Parameters
    ----------
    status : int
        HTTP status.
    reason : str
        Reason for the client.
    """

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


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
    token : str or None
        Token that clients must send; None if none is required.
    """

    def __init__(
        self, app: ASGIApp, config: ServerConfig, /, *, port: int, token: str | None
    ) -> None:
        self._app, self._config, self._token = app, config, token
        names = {*LOOPBACK, config.host, *config.allowed_hosts} - {"0.0.0.0", "::", ""}
        self._hosts = {name.lower() for name in names}
        self._port = port
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self.refused = 0
        self._logged_s = float("-inf")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer why it is refused."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        try:
            headers = _headers(scope)
            self._check(scope, headers)
            limited = _Body(receive, self._config.max_body_bytes, headers)
        except RequestRefused as refused:
            self._log(scope, refused)
            await _refuse(scope, receive, send, refused)
            return
        await self._app(
            scope, limited if scope["type"] == "http" else receive, _with_security_headers(send)
        )

    def _check(self, scope: Scope, headers: MutableMapping[str, str]) -> None:
        client = (scope.get("client") or ("unknown", 0))[0]
        try:
            self._check_sender(scope, headers)
        except RequestRefused:
            # a page of another site in the user's own browser must not use up the user's requests
            self._check_rate(f"{client} refused")
            raise
        self._check_rate(client)

    def _check_sender(self, scope: Scope, headers: MutableMapping[str, str]) -> None:
        host = headers.get("host", "")
        if not self._is_served(host):
            raise RequestRefused(
                421,
                f"host {host[:80]!r} is not served by this daemon: add it to server.allowed_hosts",
            )
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            raise RequestRefused(403, "the request comes from a page of another origin")
        site = headers.get("sec-fetch-site", "none")
        if site not in ("same-origin", "none") and scope["path"].startswith(GUARDED):
            raise RequestRefused(403, "the request comes from a page of another site")
        if self._token is not None and scope["path"].startswith(GUARDED):
            self._check_token(headers)

    def _is_served(self, host: str) -> bool:
        try:
            parts = urlsplit(f"//{host}")
            name, port = parts.hostname or "", parts.port
        except ValueError:
            return False
        return name.lower() in self._hosts and (port or 80) == self._port

    def _check_token(self, headers: MutableMapping[str, str]) -> None:
        assert self._token is not None
        shown = headers.get("authorization", "").removeprefix("Bearer ")
        for offered in headers.get("sec-websocket-protocol", "").split(","):
            if offered.strip().startswith(TOKEN_PROTOCOL):
                shown = offered.strip().removeprefix(TOKEN_PROTOCOL)
        if not hmac.compare_digest(shown.encode(), self._token.encode()):
            raise RequestRefused(
                401, "a token is required: send the header 'Authorization: Bearer TOKEN'"
            )

    def _log(self, scope: Scope, refused: RequestRefused) -> None:
        """Log a refused request; at most one each second, with the number of those before it."""
        self.refused += 1
        now = time.monotonic()
        if now - self._logged_s < LOG_S:
            return
        log.warning(
            "request refused",
            client=(scope.get("client") or ("unknown", 0))[0],
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
            raise RequestRefused(429, f"more than {config.requests_per_s:g} requests per second")


class _Body:
    """Reads a request's body up to a limit."""

    def __init__(self, receive: Receive, limit: int, headers: MutableMapping[str, str]) -> None:
        self._receive, self._left, self._limit = receive, limit, limit
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > limit:
            raise RequestRefused(413, f"the body of a request may have at most {limit} bytes")

    async def __call__(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.request":
            self._left -= len(message.get("body", b""))
            if self._left < 0:
                # as if the client had disconnected: none of the body is used
                return {"type": "http.disconnect"}
        return message


def _headers(scope: Scope) -> MutableMapping[str, str]:
    """Header fields by lower-case name; those that decide about access may occur only once."""
    found: dict[str, str] = {}
    for raw_name, raw_value in scope["headers"]:
        name = raw_name.decode("latin-1").lower()
        if name in found and name in ("host", "origin", "authorization", "content-length"):
            raise RequestRefused(400, f"header {name!r} occurs twice")
        found[name] = raw_value.decode("latin-1")
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


async def _refuse(scope: Scope, receive: Receive, send: Send, refused: RequestRefused) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": str(refused)[:120]})
        return
    headers: list[Any] = [(b"content-type", b"application/json"), (b"connection", b"close")]
    if refused.status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    if refused.status == 429:
        headers.append((b"retry-after", b"1"))
    body = json.dumps({"error": str(refused)}).encode()
    send = _with_security_headers(send)
    await send({"type": "http.response.start", "status": refused.status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
