# SPDX-License-Identifier: Apache-2.0
"""A client of Foxglove's WebSocket protocol, written from its text.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md; messages are decoded with the
schemas that the server sends.
"""

from __future__ import annotations

import base64
import json
import struct
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import Any, Self

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message_factory import GetMessages
from websockets.sync.client import connect


class FoxgloveClient:
    """One connection; `channels` are those that were advertised, by topic."""

    def __init__(self, url: str, *, subprotocol: str = "foxglove.sdk.v1", **options: Any) -> None:
        self._open = ExitStack()
        self._socket = self._open.enter_context(
            connect(url, subprotocols=[subprotocol], max_size=None, proxy=None, **options)
        )
        self.subprotocol = self._socket.subprotocol
        self.info = json.loads(self._socket.recv(timeout=30))
        assert self.info["op"] == "serverInfo"
        self.channels: dict[str, dict[str, Any]] = {}
        self.statuses: list[dict[str, Any]] = []
        self._classes: dict[str, Any] = {}
        self._topics: dict[int, str] = {}
        self._next = 7  # numbers of subscriptions are the client's own choice

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def send(self, text: str) -> None:
        self._socket.send(text)

    def subscribe(self, topics: Iterable[str]) -> None:
        wanted = []
        for topic in topics:
            self._topics[self._next] = topic
            wanted.append({"id": self._next, "channelId": self.channels[topic]["id"]})
            self._next += 1
        self.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def unsubscribe(self, topic: str) -> None:
        [number] = [number for number, its in self._topics.items() if its == topic]
        self.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [number]}))

    def wait_for(self, done: Callable[[], bool], timeout_s: float = 60.0) -> None:
        """Take messages until something is so."""
        deadline = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < deadline, "it did not come about"
            try:
                self.take(timeout_s=0.2)
            except TimeoutError:
                continue

    def next_message(self, timeout_s: float = 60.0) -> tuple[str, int, Any]:
        """Topic, time in ns and decoded content of the next message of a channel."""
        while (found := self.take(timeout_s=timeout_s)) is None:
            pass
        return found

    def take(self, *, timeout_s: float) -> tuple[str, int, Any] | None:
        frame = self._socket.recv(timeout=timeout_s)
        if isinstance(frame, bytes):
            opcode, subscription, time_ns = struct.unpack_from("<BIQ", frame)
            assert opcode == 1
            topic = self._topics[subscription]
            return topic, time_ns, self._decode(topic, frame[13:])
        text = json.loads(frame)
        if text["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in text["channels"]}
        elif text["op"] == "status":
            self.statuses.append(text)
        return None

    def _decode(self, topic: str, content: bytes) -> Any:
        channel = self.channels[topic]
        assert channel["encoding"] == channel["schemaEncoding"] == "protobuf"
        name = channel["schemaName"]
        if name not in self._classes:
            files = FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
            self._classes[name] = GetMessages(files.file)[name]
        return self._classes[name].FromString(content)
