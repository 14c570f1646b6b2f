"""The web socket of the live page: each viewer gets the newest picture, never a queue of old ones.

A viewer is sent the next picture when it has answered that the last one is shown. A slow viewer
sees fewer pictures; it can delay neither other viewers nor acquisition.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import OrderedDict
from dataclasses import replace

import msgspec
import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from hueflight.daemon.http.access import PROTOCOL
from hueflight.daemon.http.picture_message import encode_picture
from hueflight.daemon.picture import Picture
from hueflight.daemon.service import Service

STATUS_S = 0.5
SEND_TIMEOUT_S = 15.0  #: a viewer that receives nothing for so long is disconnected
SHOWN_TIMEOUT_S = 5.0  #: a viewer that never says "shown" gets a picture this often
MESSAGES_PER_S = 200  #: from a viewer; one that sends more is disconnected
_REMEMBERED = 64
_NOTHING = np.empty(0, np.uint16)


class Shown(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Message of a viewer: the number of the picture that is on its screen."""

    shown: int


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
        self._message = b""
        self._number = 0
        self._sent: OrderedDict[int, Picture] = OrderedDict()

    def publish(self, picture: Picture, message: bytes) -> None:
        """Offer a picture to all viewers."""
        self._message, self._number = message, picture.number
        # only the times of sent pictures are needed; their arrays would occupy much memory
        self._sent[picture.number] = replace(
            picture, histogram=_NOTHING, photons=_NOTHING, image=None
        )
        while len(self._sent) > _REMEMBERED:
            self._sent.popitem(last=False)
        for viewer in self._viewers:
            viewer.offer(picture.number, message)

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
        offered = socket.scope.get("subprotocols", [])
        await socket.accept(subprotocol=PROTOCOL if PROTOCOL in offered else None)
        viewer = Viewer(socket)
        self._viewers.add(viewer)
        self._service.viewers = len(self._viewers)
        try:
            latest = self._service.pictures.latest
            if latest is not None and latest.number != self._number:
                message = await asyncio.to_thread(encode_picture, latest, self._service.live_color)
                self.publish(latest, message)
            elif self._message:
                viewer.offer(self._number, self._message)
            await viewer.run(self)
        finally:
            self._viewers.discard(viewer)
            self._service.viewers = len(self._viewers)

    def status(self) -> str:
        """Return the status as JSON text."""
        return msgspec.json.encode({"status": self._service.status()}).decode()


class Viewer:
    """One viewer of the live picture.

    Parameters
    ----------
    socket : WebSocket
        Its accepted web socket.
    """

    def __init__(self, socket: WebSocket) -> None:
        self._socket = socket
        self._offered: tuple[int, bytes] | None = None
        self._offered_event = asyncio.Event()
        self._ready = asyncio.Event()
        self._ready.set()
        self._sending = asyncio.Lock()

    def offer(self, number: int, message: bytes) -> None:
        """Send this message next, in place of any that is not sent yet."""
        self._offered = (number, message)
        self._offered_event.set()

    async def run(self, hub: Hub) -> None:
        """Serve the viewer until it leaves or is disconnected."""
        tasks = [
            asyncio.create_task(work)
            for work in (self._send_pictures(), self._send_status(hub), self._listen(hub))
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        if self._socket.client_state == WebSocketState.CONNECTED:
            try:
                await asyncio.wait_for(self._socket.close(1008), 1.0)
            except (RuntimeError, TimeoutError, WebSocketDisconnect):
                return  # it has been closed meanwhile

    async def _send_pictures(self) -> None:
        while True:
            await self._offered_event.wait()
            with contextlib.suppress(TimeoutError):  # a hidden tab gets a picture now and then
                await asyncio.wait_for(self._ready.wait(), SHOWN_TIMEOUT_S)
            self._offered_event.clear()
            self._ready.clear()
            assert self._offered is not None
            async with self._sending, asyncio.timeout(SEND_TIMEOUT_S):
                await self._socket.send_bytes(self._offered[1])

    async def _send_status(self, hub: Hub) -> None:
        while True:
            async with self._sending, asyncio.timeout(SEND_TIMEOUT_S):
                await self._socket.send_text(hub.status())
            await asyncio.sleep(STATUS_S)

    async def _listen(self, hub: Hub) -> None:
        since, count = time.monotonic(), 0
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if time.monotonic() - since > 1.0:
                since, count = time.monotonic(), 0
            count += 1
            if count > MESSAGES_PER_S:
                return
            try:
                shown = msgspec.json.decode(message.get("text") or b"", type=Shown)
            except (msgspec.DecodeError, UnicodeError):
                return  # this is not the live page
            self._ready.set()
            hub.shown(shown.shown)
