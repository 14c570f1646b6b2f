# SPDX-License-Identifier: Apache-2.0
"""Live pictures for Foxglove, over its WebSocket protocol.

The protocol (https://github.com/foxglove/ws-protocol) has JSON texts and binary messages. A client
is told the channels, subscribes to some of them, and is sent their messages. A message is built
only if a client has subscribed to its channel, in a thread of low priority. A slow client gets
fewer pictures; it delays neither acquisition nor other clients.
"""

from __future__ import annotations

import asyncio
import base64
import struct
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import structlog
from starlette.websockets import WebSocket

from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.daemon.http.client_socket import (
    SEND_TIMEOUT_S,
    STATUS_S,
    received_texts,
    serve_until_one_ends,
)
from hueflight.daemon.picture import Picture
from hueflight.daemon.service import Service
from hueflight.daemon.status_log import StatusLine, status_lines
from hueflight.export.foxglove_messages import NS, FoxgloveMessages, Topic

#: names of the protocol, whose messages used here are the same in both
SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
LOG_TOPIC = "/log"
MESSAGE_DATA = 1  #: first byte of a binary message of a channel
QUEUED_PICTURES = 8  #: for each client; older ones are dropped
QUEUED_LINES = 256
log = structlog.get_logger("hueflight.daemon")


@dataclass(frozen=True)
class Channel:
    """A channel as clients are told of it.

    Attributes
    ----------
    id : int
        Number of the channel.
    topic : str
        Name of its topic.
    advertised : dict
        The same with its schema, for the text ``advertise``.
    """

    id: int
    topic: str
    advertised: dict[str, Any]


class _Subscription(msgspec.Struct, frozen=True):
    id: Annotated[int, msgspec.Meta(ge=0, lt=1 << 32)]
    channel: int = msgspec.field(name="channelId")


class _Subscribe(msgspec.Struct, frozen=True, tag="subscribe", tag_field="op"):
    subscriptions: list[_Subscription]


class _Unsubscribe(msgspec.Struct, frozen=True, tag="unsubscribe", tag_field="op"):
    ids: list[int] = msgspec.field(name="subscriptionIds")


class FoxgloveHub:
    """Distributes pictures and the log to all clients.

    Parameters
    ----------
    service : Service
        Gives pictures and the status.
    max_viewers : int
        Most clients at the same time.
    """

    def __init__(self, service: Service, max_viewers: int, /) -> None:
        self._service, self._max_viewers = service, max_viewers
        self._messages = FoxgloveMessages(
            service.instrument, color=lambda image: service.live_color.shown(image)
        )
        self._session = str(time.time_ns())
        self._channels: dict[str, Channel] = {}
        self._clients: set[FoxgloveClient] = set()
        self._waiting: deque[Picture] = deque(maxlen=2)
        self._arrived = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._thread = ThreadPoolExecutor(
            1, "foxglove", lambda: set_thread_priority(ThreadPriority.RECONSTRUCTION)
        )
        self._open({LOG_TOPIC: self._line(StatusLine("Info", ""))})
        self._tasks = [asyncio.create_task(work()) for work in (self._distribute, self._watch)]

    async def close(self) -> None:
        """End the work of the hub."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._thread.shutdown(wait=False)

    def offer(self, picture: Picture, /) -> None:
        """Take a picture; called in the thread that makes pictures, which does not wait."""
        if self._clients:
            self._loop.call_soon_threadsafe(self._take, picture.without_histogram())

    def _take(self, picture: Picture) -> None:
        self._waiting.append(picture)
        self._arrived.set()

    async def serve(self, socket: WebSocket, /) -> None:
        """Serve one client until it leaves.

        Parameters
        ----------
        socket : WebSocket
            Its web socket, not accepted yet.
        """
        chosen = [name for name in socket.scope.get("subprotocols", []) if name in SUBPROTOCOLS]
        if not chosen:
            await socket.close(1002, f"offer the subprotocol {SUBPROTOCOLS[0]}")
            return
        if len(self._clients) >= self._max_viewers:
            await socket.close(1013, f"{self._max_viewers} clients are connected already")
            return
        await socket.accept(subprotocol=chosen[0])
        client = FoxgloveClient(socket, self)
        latest = self._service.pictures.latest
        self._clients.add(client)
        self._service.viewers += 1
        try:
            client.tell(self._server_info())
            client.tell(_advertise(self._channels.values()))
            if latest is not None:
                self._take(latest.without_histogram())
            await client.run()
        finally:
            self._clients.discard(client)
            self._service.viewers -= 1

    def channel(self, number: int, /) -> Channel | None:
        """Return the channel with a number, None if there is none."""
        found = [channel for channel in self._channels.values() if channel.id == number]
        return found[0] if found else None

    def greet(self, client: FoxgloveClient, /) -> None:
        """Send the present status to a client that has subscribed to the log."""
        self._tell_status(client, self._service.status())

    def _server_info(self) -> dict[str, Any]:
        return {
            "op": "serverInfo",
            "name": f"hueflight {self._service.config.name}",
            "capabilities": [],
            "metadata": {"instrument": self._service.instrument.name},
            "sessionId": self._session,
        }

    async def _distribute(self) -> None:
        """Build the messages of pictures that clients have subscribed to, and offer them."""
        while True:
            while not self._waiting:
                self._arrived.clear()
                await self._arrived.wait()
            picture = self._waiting.popleft()
            wanted = {topic for client in self._clients for topic in client.topics}
            try:
                topics, built = await self._loop.run_in_executor(
                    self._thread, self._build, picture, wanted
                )
            except Exception as error:
                log.error("a picture for Foxglove failed", error=repr(error), exc_info=error)
                continue
            self._open(topics)
            for client in tuple(self._clients):
                client.offer_picture(picture.number, built)

    def _build(
        self, picture: Picture, wanted: set[str]
    ) -> tuple[dict[str, Topic], dict[str, tuple[int, bytes]]]:
        time_ns = round(picture.received_unix_s() * NS)
        topics = self._messages.topics(picture.exact(), time_ns=time_ns)
        return topics, {
            name: (time_ns, topic.build().encode())
            for name, topic in topics.items()
            if name in wanted
        }

    def _open(self, topics: Mapping[str, Topic]) -> None:
        """Tell all clients of the topics that are new."""
        new = [name for name in topics if name not in self._channels]
        for name in new:
            schema = getattr(self._messages.types, topics[name].schema).get_schema()
            number = len(self._channels) + 1
            advertised = {
                "id": number,
                "topic": name,
                "encoding": "protobuf",
                "schemaName": schema.name,
                "schemaEncoding": schema.encoding,
                "schema": base64.b64encode(schema.data).decode(),
            }
            self._channels[name] = Channel(number, name, advertised)
        if new:
            for client in self._clients:
                client.tell(_advertise(self._channels[name] for name in new))

    async def _watch(self) -> None:
        """Send what changes in the daemon's status to those who have subscribed to the log."""
        while True:
            await asyncio.sleep(STATUS_S)
            readers = [client for client in self._clients if LOG_TOPIC in client.topics]
            if readers:
                status = self._service.status()
                for client in readers:
                    self._tell_status(client, status)

    def _tell_status(self, client: FoxgloveClient, status: Mapping[str, Any]) -> None:
        """Send a client what it does not know yet."""
        for line in status_lines(status, client.told):
            client.offer_line((time.time_ns(), self._line(line).build().encode()))
        client.told = status

    def _line(self, line: StatusLine) -> Topic:
        return self._messages.line(line.text, level=line.level, time_ns=time.time_ns())


class FoxgloveClient:
    """One client.

    Parameters
    ----------
    socket : WebSocket
        Its accepted web socket.
    hub : FoxgloveHub
        Hub that it belongs to.

    Attributes
    ----------
    topics : dict of str to int
        Number of the subscription, which the client chose, by topic.
    told : mapping or None
        Status that the log has told the client of.
    """

    def __init__(self, socket: WebSocket, hub: FoxgloveHub, /) -> None:
        self._socket, self._hub = socket, hub
        self.topics: dict[str, int] = {}
        self.told: Mapping[str, Any] | None = None
        self._texts: deque[str] = deque()
        self._lines: deque[tuple[int, bytes]] = deque(maxlen=QUEUED_LINES)
        self._pictures: deque[dict[str, tuple[int, bytes]]] = deque(maxlen=QUEUED_PICTURES)
        self._newest = 0
        self._offered = asyncio.Event()

    def tell(self, text: dict[str, Any], /) -> None:
        """Send a text, which is never dropped."""
        self._texts.append(msgspec.json.encode(text).decode())
        self._offered.set()

    def offer_line(self, message: tuple[int, bytes], /) -> None:
        """Send a line of the log, given as its time and content."""
        self._lines.append(message)
        self._offered.set()

    def offer_picture(self, number: int, messages: dict[str, tuple[int, bytes]], /) -> None:
        """Send the messages of a picture; the oldest one waiting may be dropped."""
        # one that was taken up again for a client that came meanwhile
        if number > self._newest and not self.topics.keys().isdisjoint(messages):
            self._newest = number
            self._pictures.append(messages)
            self._offered.set()

    async def run(self) -> None:
        """Serve the client until it leaves or is disconnected."""
        await serve_until_one_ends(self._socket, self._send(), self._listen())

    async def _send(self) -> None:
        while True:
            while not (self._texts or self._lines or self._pictures):
                self._offered.clear()
                await self._offered.wait()
            async with asyncio.timeout(SEND_TIMEOUT_S):
                if self._texts:
                    await self._socket.send_text(self._texts.popleft())
                elif self._lines:
                    await self._send_message(LOG_TOPIC, *self._lines.popleft())
                else:
                    for topic, (time_ns, content) in self._pictures.popleft().items():
                        await self._send_message(topic, time_ns, content)

    async def _send_message(self, topic: str, time_ns: int, content: bytes) -> None:
        subscription = self.topics.get(topic)
        if subscription is not None:
            head = struct.pack("<BIQ", MESSAGE_DATA, subscription, time_ns)
            await self._socket.send_bytes(head + content)

    async def _listen(self) -> None:
        async for text in received_texts(self._socket):
            try:
                request = msgspec.json.decode(text, type=_Subscribe | _Unsubscribe)
            except (msgspec.DecodeError, UnicodeError) as error:
                self._warn(f"not understood: {error}")
                continue
            self._take(request)

    def _take(self, request: _Subscribe | _Unsubscribe) -> None:
        if isinstance(request, _Unsubscribe):
            gone = set(request.ids)
            self.topics = {
                topic: number for topic, number in self.topics.items() if number not in gone
            }
            if LOG_TOPIC not in self.topics:
                self.told = None
            return
        for wanted in request.subscriptions:
            channel = self._hub.channel(wanted.channel)
            if channel is None:
                self._warn(f"there is no channel {wanted.channel}")
            elif wanted.id in self.topics.values():
                self._warn(f"subscription {wanted.id} exists already")
            elif channel.topic in self.topics:
                self._warn(f"channel {wanted.channel} is subscribed to already")
            else:
                self.topics[channel.topic] = wanted.id
                if channel.topic == LOG_TOPIC:
                    self._hub.greet(self)

    def _warn(self, text: str) -> None:
        self.tell({"op": "status", "level": 1, "message": text[:200]})


def _advertise(channels: Any) -> dict[str, Any]:
    return {"op": "advertise", "channels": [channel.advertised for channel in channels]}
