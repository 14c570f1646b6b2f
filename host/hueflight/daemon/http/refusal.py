# SPDX-License-Identifier: Apache-2.0
"""Refusals of requests, and the answers that tell clients of them."""

from __future__ import annotations

import json
from typing import Any, Literal

from starlette.types import Receive, Scope, Send

RefusalCode = Literal[
    "host", "origin", "token missing", "token wrong", "role", "rate", "size", "header", "forwarded"
]
"""Why a request is refused, for programs."""


class RequestRefusedError(Exception):
    """A request that is refused.

    Parameters
    ----------
    status : int
        HTTP status.
    reason : str
        Reason for people.
    code : str
        Reason for programs.
    """

    def __init__(self, status: int, reason: str, code: RefusalCode) -> None:
        super().__init__(reason)
        self.status, self.code = status, code


async def refuse(
    scope: Scope, receive: Receive, send: Send, refused: RequestRefusedError, /
) -> None:
    """Answer a request that is refused; a web socket is closed.

    Parameters
    ----------
    scope, receive, send : ASGI arguments
        The request.
    refused : RequestRefusedError
        Why it is refused.
    """
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": str(refused)[:120]})
        return
    headers: list[Any] = [(b"content-type", b"application/json"), (b"connection", b"close")]
    if refused.status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    if refused.status == 429:
        headers.append((b"retry-after", b"1"))
    body = json.dumps({"error": str(refused), "code": refused.code}).encode()
    await send({"type": "http.response.start", "status": refused.status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
