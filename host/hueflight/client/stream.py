# SPDX-License-Identifier: Apache-2.0
"""The stream of pictures without its transport: what to send, and what the answers mean."""

from __future__ import annotations

from typing import Any

import xarray as xr

from hueflight.client.address import Address
from hueflight.client.errors import ClientError, VersionMismatchError
from hueflight.live.image import picture_of_message
from hueflight.live.message import MessageError, VersionError, decode_message
from hueflight.live.protocol import DELIVERIES, PROTOCOL, TOKEN_PROTOCOL, Delivery

AHEAD = 16  #: pictures that the daemon may send before they are taken, if all are wanted
#: seconds before each attempt to reconnect; the last one is repeated
RETRY_S = (0.1, 0.25, 0.5, 1.0, 2.0)


class PictureStream:
    """State of one stream of pictures, which goes on over several connections.

    Parameters
    ----------
    delivery : str
        ``"newest"`` or ``"all"``.

    Raises
    ------
    ClientError
        If `delivery` is unknown.
    """

    def __init__(self, delivery: Delivery, /) -> None:
        if delivery not in DELIVERIES:
            raise ClientError(f"pictures {delivery!r}: choose one of {', '.join(DELIVERIES)}")
        self._delivery = delivery
        self._number = 0
        self._connected = False
        self._awaited = 0

    def connected(self) -> None:
        """Note that a new connection is open."""
        self._awaited = 0
        self._connected = True

    def request(self) -> str | None:
        """Return the text to send before the next picture is awaited, if any."""
        wanted = AHEAD if self._delivery == "all" else 1
        more = wanted - self._awaited
        if more <= 0:
            return None
        self._awaited = wanted
        return f'{{"next":{more}}}'

    def receive(self, message: str | bytes, /) -> xr.Dataset | None:
        """Return the picture in a message; None if it was seen before the connection was lost.

        Parameters
        ----------
        message : str or bytes
            Message from the daemon.

        Returns
        -------
        xarray.Dataset or None
            The picture. Its attribute ``missed_pictures`` counts the pictures that were made since
            the last one and were not received.

        Raises
        ------
        VersionMismatchError
            If the message is of another version of the format.
        ClientError
            If it can't be read.
        """
        if isinstance(message, str):
            raise ClientError(f"the daemon sent text in place of a picture: {message[:80]!r}")
        try:
            picture = picture_of_message(decode_message(message))
        except VersionError as error:
            raise VersionMismatchError(str(error)) from None
        except MessageError as error:
            raise ClientError(f"a picture can't be read: {error}") from None
        self._awaited -= 1
        number = int(picture.attrs["number"])
        first_of_connection, self._connected = self._connected, False
        if number == self._number and first_of_connection:
            return None
        # a daemon that was started again counts from 1
        known = 0 < self._number < number
        picture.attrs["missed_pictures"] = number - self._number - 1 if known else 0
        self._number = number
        return picture

    def url(self, address: Address, /) -> str:
        """Return the address of the web socket."""
        scheme = "wss" if address.secure else "ws"
        return f"{scheme}://{address.netloc}/api/live?coding=exact&pictures={self._delivery}"


def socket_options(token: str | None, /) -> dict[str, Any]:
    """Return the options of a web socket to the daemon, for `websockets`.

    Parameters
    ----------
    token : str or None
        Token to send.

    Returns
    -------
    dict
        Keyword arguments of ``connect``.
    """
    return {
        "subprotocols": [PROTOCOL, *([TOKEN_PROTOCOL + token] if token else [])],
        "max_size": None,  # pictures of large sensors take tens of megabytes
        "compression": None,
        "proxy": None,
    }


def retry_delay_s(attempt: int, /) -> float:
    """Return the seconds to wait before an attempt to reconnect, the first of which is 0."""
    return RETRY_S[min(attempt, len(RETRY_S) - 1)]
