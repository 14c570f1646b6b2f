# SPDX-License-Identifier: Apache-2.0
"""What describes an operation of the API: routes and OpenAPI description are made from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from hueflight.daemon.http.answers import Answer
from hueflight.daemon.http.bodies import Body
from hueflight.daemon.service import Service

PLAYBACK = "/api/playback/"


@dataclass(frozen=True)
class Named:
    """Argument of an operation on a recording.

    Attributes
    ----------
    name : str
        Name of the recording, from the path.
    body : Body or None
        Decoded body or query.
    """

    name: str
    body: Any


@dataclass(frozen=True)
class Operation:
    """One operation of the API.

    Attributes
    ----------
    method : str
        HTTP method.
    path : str
        Path of the request.
    name : str
        Identifier of the operation, which is unique.
    summary : str
        One line for the OpenAPI description.
    result : str
        What a successful answer holds, for the OpenAPI description.
    action : callable
        Carries the operation out, given the service and the decoded body or query, or a `Named` if
        the path holds a name; gives what is answered as JSON, or the bytes of a picture.
    answer : type or None
        Type of the answer; None for the message of a picture.
    body : type or None
        Type of the body; None for no body.
    query : type or None
        Type of the query; None for no query.
    conflicts : bool
        True if the operation can conflict with another one in progress (status 409).
    missing : bool
        True if the object of the operation may not exist (status 404).
    """

    method: Literal["GET", "POST", "PATCH", "DELETE"]
    path: str
    name: str
    summary: str
    result: str
    action: Callable[[Service, Any], dict[str, Any] | bytes]
    answer: type[Answer] | None = None
    body: type[Body] | None = None
    query: type[Body] | None = None
    conflicts: bool = False
    missing: bool = False

    @property
    def named(self) -> bool:
        """True if the path holds the name of a recording or result."""
        return "{name}" in self.path

    @property
    def plays(self) -> bool:
        """True if that name may also be one of a result."""
        return self.path.startswith(PLAYBACK)
