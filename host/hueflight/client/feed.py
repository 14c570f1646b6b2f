# SPDX-License-Identifier: Apache-2.0
"""Pictures over a web socket that is opened again when it breaks."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from typing import Any

import xarray as xr

from hueflight.client.errors import (
    ClientError,
    ConnectionLostError,
    NoPictureError,
    NotReachableError,
    RefusedError,
    VersionMismatchError,
)
from hueflight.client.requests import Requests
from hueflight.client.stream import PictureStream, retry_delay_s, socket_options
from hueflight.files.optional import import_optional
from hueflight.live.protocol import PROTOCOL, Delivery


class PictureFeed:
    """Pictures of one daemon, one at a time.

    Parameters
    ----------
    requests : Requests
        Requests to the daemon.
    delivery : str
        ``"newest"`` or ``"all"``.
    reconnect_s : float
        Seconds for which a lost connection is tried to be opened again.
    open_timeout_s : float
        Seconds within which the daemon must accept a connection.
    """

    def __init__(
        self,
        requests: Requests,
        delivery: Delivery,
        /,
        *,
        reconnect_s: float,
        open_timeout_s: float,
    ) -> None:
        self._websockets = import_optional("websockets.sync.client", extra="client")
        self._exceptions = import_optional("websockets.exceptions", extra="client")
        self._requests = requests
        self._stream = PictureStream(delivery)
        self._reconnect_s, self._open_timeout_s = reconnect_s, open_timeout_s
        self._socket: Any = None
        self._connection = ExitStack()
        self._closed = threading.Event()

    def next(self, timeout_s: float | None) -> xr.Dataset:
        """Return the next picture.

        Parameters
        ----------
        timeout_s : float or None
            Seconds within which it must come; None waits as long as it takes.

        Returns
        -------
        xarray.Dataset
            The picture.

        Raises
        ------
        NoPictureError
            If no picture comes in time.
        ConnectionLostError
            If the connection breaks and can't be opened again.
        ClientError
            If the daemon refuses, or the feed was closed.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            # another thread may drop the socket at any time, so it is looked up once
            socket = self._socket or self._connect()
            try:
                text = self._stream.request()
                if text is not None:
                    socket.send(text)
                left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
                message = socket.recv(timeout=left)
            except TimeoutError:
                self._drop()  # or the picture asked for would be taken later, as if it were new
                raise NoPictureError(
                    f"no new picture came within {timeout_s:g} s: does status() say that the "
                    "camera is running?"
                ) from None
            except (self._exceptions.ConnectionClosed, OSError):
                self._drop()
                continue
            picture = self._stream.receive(message)
            if picture is not None:
                return picture

    def close(self) -> None:
        """Close the connection; a thread that waits for a picture gets an error."""
        self._closed.set()
        self._drop()

    def _drop(self) -> None:
        self._socket = None
        self._connection.close()

    def _connect(self) -> Any:
        """Open the web socket, if necessary after several attempts, and return it."""
        deadline = time.monotonic() + self._reconnect_s
        attempt = 0
        while not self._closed.is_set():
            try:
                socket = self._open()
            except (NotReachableError, RefusedError) as error:
                if time.monotonic() >= deadline:
                    raise ConnectionLostError(
                        f"the connection to {self._requests.address.netloc} was lost and could "
                        f"not be opened again within {self._reconnect_s:g} s: {error}"
                    ) from None
                self._closed.wait(retry_delay_s(attempt))
                attempt += 1
            else:
                self._stream.connected()
                self._socket = socket
                if self._closed.is_set():  # by another thread, meanwhile
                    self._drop()
                    break
                return socket
        raise ClientError("the client was closed while it waited for a picture")

    def _open(self) -> Any:
        """Open the web socket, after the token and the version were checked."""
        self._requests.check_protocol()
        address = self._requests.address
        try:
            socket = self._connection.enter_context(
                self._websockets.connect(
                    self._stream.url(address),
                    open_timeout=self._open_timeout_s,
                    close_timeout=1.0,
                    **socket_options(self._requests.token),
                )
            )
        except self._exceptions.InvalidStatus as error:
            status = error.response.status_code
            raise RefusedError(
                f"the daemon at {address.netloc} refuses another viewer (status {status}): "
                "server.max_viewers limits how many there may be",
                status=status,
            ) from None
        except (OSError, self._exceptions.InvalidHandshake) as error:
            raise NotReachableError(
                f"no web socket can be opened to {address.netloc}: {error}"
            ) from None
        if socket.subprotocol != PROTOCOL:
            self._drop()
            raise VersionMismatchError(
                f"the daemon at {address.netloc} does not speak {PROTOCOL}: install the same "
                "version of hueflight on both machines"
            )
        return socket
