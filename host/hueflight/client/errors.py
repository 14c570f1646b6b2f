# SPDX-License-Identifier: Apache-2.0
"""Failures of a client, each saying what to do about it."""

from __future__ import annotations

from hueflight.errors import HueflightError


class ClientError(HueflightError):
    """A request to a daemon that did not succeed."""


class NotReachableError(ClientError, ConnectionError):
    """No daemon answers at the address."""


class ConnectionLostError(ClientError, ConnectionError):
    """The daemon was reached, and did not come back within the time for reconnection."""


class TokenError(ClientError, PermissionError):
    """The daemon requires a token, and none or another one was sent."""


class VersionMismatchError(ClientError):
    """The daemon speaks another version of the protocol, or the address is not a daemon's."""


class RefusedError(ClientError):
    """The daemon does not do what was asked, for a reason that it states.

    Parameters
    ----------
    message : str
        The reason.
    status : int
        HTTP status of the answer.

    Attributes
    ----------
    status : int
        HTTP status of the answer, such as 409 for a conflict with the present state.
    """

    def __init__(self, message: str, /, *, status: int) -> None:
        super().__init__(message)
        self.status = status


class NoPictureError(ClientError, TimeoutError):
    """No new picture came within the time given."""
