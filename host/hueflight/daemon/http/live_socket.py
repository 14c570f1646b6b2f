# SPDX-License-Identifier: Apache-2.0
"""The web socket of live pictures: a viewer is sent as many as it takes, and delays nobody.

The live page is sent the newest picture when it has answered that the last one is shown, and the
status. Other clients say in the address how they want pictures (`StreamQuery`) and then ask for
them; they are sent nothing else. A slow viewer gets fewer pictures; it can delay neither other
viewers nor acquisition.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import OrderedDict, deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import msgspec
import numpy as np
from starlette.websockets import WebSocket

from hueflight.daemon.http.client_socket import (
    SEND_TIMEOUT_S,
    STATUS_S,
    received_texts,
    serve_until_one_ends,
)
from hueflight.daemon.http.picture_message import encode_picture
from hueflight.daemon.picture import Picture
from hueflight.daemon.service import Service
from hueflight.live.protocol import PROTOCOL, Coding, Delivery

SHOWN_TIMEOUT_S = 5.0  #: a viewer that never says "shown" gets a picture this often
QUEUED_PICTURES = 32  #: for a viewer that wants all; older ones are dropped
ASKED_AT_MOST = 1000  #: pictures that a viewer may have asked for and not received
_REMEMBERED = 64
_NOTHING = np.empty(0, np.uint16)


class Shown(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Message of a viewer: the number of the picture that is on its screen."""

    shown: int


class Next(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Message of a viewer that asks for pictures: how many more may be sent."""

    next: Annotated[int, msgspec.Meta(ge=1, le=ASKED_AT_MOST)]


class StreamQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a viewer wants pictures, in the query of the web socket's address.

    Attributes
    ----------
    coding : str
        Coding of the values.
    pictures : str or None
        Which pictures are sent when the viewer asks for them; None for a viewer that does not ask,
        such as the live page.
    """

    coding: Coding = "display"
    pictures: Delivery | None = None


def read_query(pairs: Mapping[str, str], /) -> StreamQuery:
    """Return how a viewer wants pictures.

    Parameters
    ----------
    pairs : mapping of str to str
        Query of the address.

    Returns
    -------
    StreamQuery
        The settings.

    Raises
    ------
    msgspec.ValidationError
        If a name or value is unknown.
    """
    return msgspec.convert(dict(pairs), StreamQuery)


class Hub:
    """Distributes pictures to all viewers.

    Parameters
    ----------
    service : Service
        Gives the status and takes latencies.
    max_viewers : int
        Most viewers at the same time.
    """

    def __init__(self, service: Service, max_viewers: int, /) -> None:
        self._service = service
        self._max_viewers = max_viewers
        self._viewers: set[Viewer] = set()
        self._messages: dict[Coding, tuple[int, bytes]] = {}
        self._sent: OrderedDict[int, Picture] = OrderedDict()
        self._status, self._status_until_s = "", 0.0

    @property
    def codings(self) -> tuple[Coding, ...]:
        """Codings that the present viewers want."""
        # called in the thread that makes pictures, while viewers come and go: a copy is made first
        return tuple({viewer.query.coding for viewer in tuple(self._viewers)})

    def publish(self, picture: Picture, messages: Mapping[Coding, bytes]) -> None:
        """Offer a picture to all viewers whose coding is among the messages."""
        for coding, message in messages.items():
            self._messages[coding] = (picture.number, message)
        # only the times of sent pictures are needed; their arrays would occupy much memory
        self._sent[picture.number] = replace(
            picture.without_histogram(), photons=_NOTHING, image=None
        )
        while len(self._sent) > _REMEMBERED:
            self._sent.popitem(last=False)
        for viewer in self._viewers:
            if viewer.query.coding in messages:
                viewer.offer(picture.number, messages[viewer.query.coding])

    def shown(self, number: int) -> None:
        """Note that a viewer has a picture on its screen."""
        picture = self._sent.get(number)
        if picture is not None:
            self._service.latencies.shown(picture, time.monotonic())

    async def serve(self, socket: WebSocket) -> None:
        """Serve one viewer until it leaves."""
        if len(self._viewers) >= self._max_viewers:
            await socket.close(1013, f"{self._max_viewers} viewers are connected already")
            return
        try:
            query = read_query(socket.query_params)
        except msgspec.ValidationError as error:
            await socket.close(1008, str(error)[:120])
            return
        offered = socket.scope.get("subprotocols", [])
        await socket.accept(subprotocol=PROTOCOL if PROTOCOL in offered else None)
        viewer = Viewer(socket, query)
        self._viewers.add(viewer)
        self._service.viewers += 1
        try:
            await self._offer_latest(viewer)
            await viewer.run(self)
        finally:
            self._viewers.discard(viewer)
            self._service.viewers -= 1

    async def _offer_latest(self, viewer: Viewer) -> None:
        """Offer the latest picture, which may be older than the viewer."""
        latest, coding = self._service.pictures.latest, viewer.query.coding
        number, message = self._messages.get(coding, (0, b""))
        if latest is not None and latest.number != number:
            message = await asyncio.to_thread(
                encode_picture, latest, self._service.live_color, coding=coding
            )
            self.publish(latest, {coding: message})
        elif message:
            viewer.offer(number, message)

    def status(self) -> str:
        """Return the status as JSON text, the same for all viewers that are told at one time."""
        now = time.monotonic()
        if now >= self._status_until_s:
            self._status = msgspec.json.encode({"status": self._service.status()}).decode()
            self._status_until_s = now + STATUS_S / 2
        return self._status


class Viewer:
    """One viewer of the live picture.

    Parameters
    ----------
    socket : WebSocket
        Its accepted web socket.
    query : StreamQuery
        How it wants pictures.
    """

    def __init__(self, socket: WebSocket, query: StreamQuery) -> None:
        self._socket = socket
        self.query = query
        self._offered: deque[bytes] = deque(
            maxlen=QUEUED_PICTURES if query.pictures == "all" else 1
        )
        self._offered_event = asyncio.Event()
        self._newest = 0
        self._may_send = 0 if query.pictures else 1
        self._ready = asyncio.Event()
        self._sending = asyncio.Lock()

    def offer(self, number: int, message: bytes) -> None:
        """Send this message when the viewer is ready; the oldest one waiting may be dropped."""
        if number <= self._newest:  # it was made for a viewer that came meanwhile
            return
        self._newest = number
        self._offered.append(message)
        self._offered_event.set()

    async def run(self, hub: Hub) -> None:
        """Serve the viewer until it leaves or is disconnected."""
        works = [self._send_pictures(), self._listen(hub)]
        if self.query.pictures is None:
            works.append(self._send_status(hub))
        await serve_until_one_ends(self._socket, *works)

    async def _send_pictures(self) -> None:
        while True:
            await self._wait_until_ready()
            while not self._offered:
                self._offered_event.clear()
                await self._offered_event.wait()
            self._may_send = max(self._may_send - 1, 0)
            async with self._sending, asyncio.timeout(SEND_TIMEOUT_S):
                await self._socket.send_bytes(self._offered.popleft())

    async def _wait_until_ready(self) -> None:
        """Wait until the viewer may be sent a picture."""
        if self._may_send:
            return
        self._ready.clear()
        if self.query.pictures:
            await self._ready.wait()
            return
        with contextlib.suppress(TimeoutError):  # a hidden tab gets a picture now and then
            await asyncio.wait_for(self._ready.wait(), SHOWN_TIMEOUT_S)

    async def _send_status(self, hub: Hub) -> None:
        while True:
            async with self._sending, asyncio.timeout(SEND_TIMEOUT_S):
                await self._socket.send_text(hub.status())
            await asyncio.sleep(STATUS_S)

    async def _listen(self, hub: Hub) -> None:
        async for text in received_texts(self._socket):
            if not self._take(text, hub):
                return

    def _take(self, text: str, hub: Hub) -> bool:
        """Take a message of the viewer; False if it is none that a viewer may send."""
        try:
            if self.query.pictures:
                self._may_send += msgspec.json.decode(text, type=Next).next
            else:
                hub.shown(msgspec.json.decode(text, type=Shown).shown)
                self._may_send = 1
        except (msgspec.DecodeError, UnicodeError):
            return False
        self._ready.set()
        return self._may_send <= ASKED_AT_MOST
