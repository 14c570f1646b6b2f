# SPDX-License-Identifier: Apache-2.0
"""Tokens and roles: who may look, and who may change something."""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from starlette.types import Scope

from hueflight.daemon.http.refusal import RequestRefusedError
from hueflight.daemon.server_config import Role, Tokens
from hueflight.live.protocol import TOKEN_PROTOCOL

#: paths that need a token; the page, which holds no secret, and /health need none
GUARDED = ("/api/", "/metrics", "/openapi.json")
SESSION_PATH = "/api/session"  #: says what a token is good for, also to those who have none
_SAFE_METHODS = ("GET", "HEAD")

TokenState = Literal["not required", "missing", "wrong", "right"]


@dataclass(frozen=True)
class Permission:
    """What the token of a request is good for.

    Attributes
    ----------
    token : str
        ``"not required"``, ``"missing"``, ``"wrong"`` or ``"right"``.
    role : str or None
        ``"viewer"`` or ``"operator"``; None for a token that is missing or wrong.
    """

    token: TokenState
    role: Role | None


def permission(tokens: Tokens, headers: Mapping[str, str], /) -> Permission:
    """Return what the token of a request is good for.

    Parameters
    ----------
    tokens : Tokens
        Tokens of the daemon.
    headers : mapping of str to str
        Header fields of the request by lower-case name.

    Returns
    -------
    Permission
        State of the token, and the role.
    """
    if tokens.operator is None:
        return Permission("not required", "operator")
    shown = headers.get("authorization", "").removeprefix("Bearer ")
    for offered in headers.get("sec-websocket-protocol", "").split(","):
        if offered.strip().startswith(TOKEN_PROTOCOL):
            shown = offered.strip().removeprefix(TOKEN_PROTOCOL)
    if not shown:
        return Permission("missing", None)
    # both are compared in any case, so that the time says nothing
    operator = hmac.compare_digest(shown.encode(), tokens.operator.encode())
    viewer = hmac.compare_digest(shown.encode(), (tokens.viewer or "").encode())
    if operator:
        return Permission("right", "operator")
    return Permission("right", "viewer") if viewer else Permission("wrong", None)


def check_permission(scope: Scope, found: Permission, /) -> None:
    """Refuse a request that its token does not allow.

    Parameters
    ----------
    scope : Scope
        The request.
    found : Permission
        What its token is good for.

    Raises
    ------
    RequestRefusedError
        If the path needs a token and there is none that is right, or if a viewer would change
        something.
    """
    if not scope["path"].startswith(GUARDED) or scope["path"] == SESSION_PATH:
        return
    if found.token == "missing":
        raise RequestRefusedError(
            401,
            "a token is required: send the header 'Authorization: Bearer TOKEN'",
            "token missing",
        )
    if found.token == "wrong":
        raise RequestRefusedError(401, "the token is not one of this daemon", "token wrong")
    safe = scope["type"] == "websocket" or scope["method"] in _SAFE_METHODS
    if found.role == "viewer" and not safe:
        raise RequestRefusedError(
            403, "viewers may only look: send the token of an operator", "role"
        )
