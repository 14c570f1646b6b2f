# SPDX-License-Identifier: Apache-2.0
"""The web server's patience: with requests that do not come in, and with nothing else."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="the extra 'daemon' is not installed")

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from hueflight.daemon.config import ServerConfig
from hueflight.daemon.http import server
from support.web import WAIT_S, serving

PATIENCE_S = 1.0
LONGER_S = 3 * PATIENCE_S
HEAD = "{} HTTP/1.1\r\nHost: here\r\n"


async def echo(request: Request) -> Response:
    return PlainTextResponse(await request.body())


async def who(request: Request) -> Response:
    return PlainTextResponse(f"{request.url.scheme} {request.client.host}.")


async def long(request: Request) -> Response:
    async def parts() -> Any:
        for _ in range(6):
            yield b"part "
            await asyncio.sleep(LONGER_S / 6)

    return StreamingResponse(parts())


async def live(web_socket: WebSocket) -> None:
    await web_socket.accept()
    while (await web_socket.receive())["type"] != "websocket.disconnect":
        await web_socket.send_text("still here")


async def flood(web_socket: WebSocket) -> None:
    await web_socket.accept()
    with suppress(WebSocketDisconnect):
        while True:
            await web_socket.send_bytes(bytes(1 << 16))
    web_socket.app.state.cut_off.set()


@pytest.fixture
def cut_off() -> threading.Event:
    """Set when a flood is over."""
    return threading.Event()


@pytest.fixture
def port(cut_off: threading.Event, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Of a server that waits `PATIENCE_S` for requests and for readers."""
    monkeypatch.setattr(server, "REQUEST_S", PATIENCE_S)
    monkeypatch.setattr(server, "UNREAD_S", PATIENCE_S)
    routes = [
        Route("/echo", echo, methods=["POST"]),
        Route("/long", long),
        Route("/who", who),
        WebSocketRoute("/live", live),
        WebSocketRoute("/flood", flood),
    ]
    app = Starlette(routes=routes)
    app.state.cut_off = cut_off
    with serving(app, ServerConfig(port=0)) as number:
        yield number


def opened(port: int) -> socket.socket:
    made = socket.create_connection(("127.0.0.1", port))
    made.settimeout(WAIT_S)
    return made


def trickled(sock: socket.socket, text: bytes) -> bool:
    """Whether the server hung up while `text` came a byte at a time."""
    for byte in text:
        try:
            sock.sendall(bytes([byte]))
        except OSError:
            return True
        time.sleep(PATIENCE_S / 10)
    return False


def answer(sock: socket.socket, ending: bytes) -> bytes:
    got = b""
    while not got.endswith(ending):
        piece = sock.recv(4096)
        assert piece, got
        got += piece
    return got


def test_a_live_socket_stays(port: int) -> None:
    """For longer than a request may take to come in."""
    with connect(f"ws://127.0.0.1:{port}/live") as viewer:
        began = time.monotonic()
        while time.monotonic() - began < LONGER_S:
            viewer.send("?")
            assert viewer.recv(WAIT_S) == "still here"
            time.sleep(PATIENCE_S / 8)


def test_a_long_answer_is_finished(port: int) -> None:
    with opened(port) as sock:
        sock.sendall((HEAD.format("GET /long") + "\r\n").encode())
        assert answer(sock, b"0\r\n\r\n").count(b"part ") == 6


@pytest.mark.parametrize("before", [0, 4])
@pytest.mark.parametrize("body", [False, True])
def test_a_request_that_does_not_come_in_is_hung_up_on(port: int, before: int, body: bool) -> None:
    """The first one of a connection or a later one, in its header or in its body."""
    whole = HEAD.format("POST /echo") + "Content-Length: 400\r\n\r\n"
    with opened(port) as sock:
        for _ in range(before):
            sock.sendall(whole.encode() + b"y" * 400)
            assert answer(sock, b"y" * 400).startswith(b"HTTP/1.1 200")
            time.sleep(0.4 * PATIENCE_S)
        if body:
            sock.sendall(whole.encode())
        assert trickled(sock, b"x" * 200)


def test_who_reads_nothing_is_cut_off(port: int, cut_off: threading.Event) -> None:
    if not hasattr(socket, "TCP_USER_TIMEOUT"):
        pytest.skip("this system can't be told how long to wait for a reader")
    with opened(port) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.sendall(
            (HEAD.format("GET /flood") + "Upgrade: websocket\r\nConnection: Upgrade\r\n").encode()
            + b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        assert cut_off.wait(WAIT_S)


def test_nobody_is_taken_for_a_proxy(port: int) -> None:
    """The web server itself believes no forwarding header, also of clients on loopback."""
    with opened(port) as sock:
        head = HEAD.format("GET /who") + "X-Forwarded-For: 203.0.113.9\r\n"
        sock.sendall((head + "X-Forwarded-Proto: https\r\n\r\n").encode())
        assert answer(sock, b".").endswith(b"http 127.0.0.1.")


def test_a_viewer_that_says_too_much_is_refused(port: int) -> None:
    with connect(f"ws://127.0.0.1:{port}/live") as viewer:
        viewer.send("x" * (server.VIEWER_MESSAGE_BYTES + 1))
        with pytest.raises(ConnectionClosed, match="1009"):
            viewer.recv(WAIT_S)


def test_idle_connections_make_way(port: int) -> None:
    """However many there are; one with a request in progress stays."""
    with opened(port) as busy:
        busy.sendall((HEAD.format("GET /long") + "\r\n").encode())
        assert busy.recv(100).startswith(b"HTTP/1.1 200")
        idle = [opened(port) for _ in range(100)]
        try:
            with opened(port) as sock:
                whole = HEAD.format("POST /echo") + "Content-Length: 4\r\n\r\n"
                sock.sendall(whole.encode() + b"here")
                assert answer(sock, b"here").startswith(b"HTTP/1.1 200")
        finally:
            for sock in idle:
                sock.close()
        assert answer(busy, b"0\r\n\r\n").count(b"part ") >= 5


def test_who_finds_no_room_is_told_in_json() -> None:
    from hueflight.daemon.http.connections import Connections, refusal

    class Busy:
        waits = False

        def hang_up(self) -> None:
            raise AssertionError("it has a request in progress")

    connections = Connections(3, 2)
    assert connections.admit(Busy(), "a")
    assert connections.admit(Busy(), "a")
    assert not connections.admit(Busy(), "a")
    assert connections.admit(Busy(), "b")
    assert not connections.admit(Busy(), "c")
    assert (len(connections), connections.refused) == (3, 2)
    head, _, body = refusal("no room").partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503 ")
    assert f"content-length: {len(body)}".encode() in head
    assert json.loads(body) == {"error": "no room"}
