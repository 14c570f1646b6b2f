# SPDX-License-Identifier: Apache-2.0
"""What a client says when there is no daemon at the address, or another one."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

import hueflight as hf
from hueflight.client import NotReachableError, VersionMismatchError
from hueflight.client.address import Address
from hueflight.client.stream import AHEAD, PictureStream
from hueflight.live import encode_message

Serve = Callable[[bytes], str]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Function that answers every request with the same body, and returns the address."""
    servers: list[HTTPServer] = []

    def run(body: bytes) -> str:
        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("content-length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                pass

        servers.append(HTTPServer(("127.0.0.1", 0), Handler))
        threading.Thread(target=servers[-1].serve_forever, daemon=True).start()
        return f"127.0.0.1:{servers[-1].server_port}"

    yield run
    for server in servers:
        server.shutdown()
        server.server_close()


def test_nothing_listens() -> None:
    with pytest.raises(NotReachableError, match=r"127\.0\.0\.1:1: .*hueflight serve") as caught:
        hf.connect("127.0.0.1:1")
    assert isinstance(caught.value, ConnectionError)


def test_another_version_and_other_servers(serve: Serve) -> None:
    with pytest.raises(VersionMismatchError, match=r"hueflight\.v9, this client hueflight\.v1"):
        hf.connect(serve(json.dumps({"protocol": "hueflight.v9"}).encode()))
    with pytest.raises(VersionMismatchError, match="an older protocol"):
        hf.connect(serve(b'{"rows": 3}'))
    with pytest.raises(VersionMismatchError, match="not a Hueflight daemon"):
        hf.connect(serve(b"<html>"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lab", Address("lab", 8470)),
        ("lab:99", Address("lab", 99)),
        ("[::1]:99", Address("::1", 99)),
        ("http://lab:8470/#token=abc", Address("lab", 8470, token="abc")),
        ("https://lab.example", Address("lab.example", 443, secure=True)),
    ],
)
def test_addresses(text: str, expected: Address) -> None:
    assert Address.parse(text) == expected


@pytest.mark.parametrize("text", ["", ":80", "lab:port", "ftp://lab", "lab:99999"])
def test_no_addresses(text: str) -> None:
    with pytest.raises(NotReachableError, match="HOST:PORT"):
        Address.parse(text)


def message(number: int) -> bytes:
    return encode_message({"number": number, "coding": "exact"}, [])


def test_a_stream_asks_for_as_many_as_it_may_have() -> None:
    newest, every = PictureStream("newest"), PictureStream("all")
    for stream, ahead in ((newest, 1), (every, AHEAD)):
        stream.connected()
        assert json.loads(stream.request() or "") == {"next": ahead}
        assert stream.request() is None
        assert stream.receive(message(5)) is not None
        assert json.loads(stream.request() or "") == {"next": 1}


def test_a_stream_counts_what_it_missed_and_drops_what_it_has_seen() -> None:
    stream = PictureStream("all")
    stream.connected()
    found = [stream.receive(message(number)) for number in (5, 6, 9)]
    assert [each.attrs["missed_pictures"] for each in found if each is not None] == [0, 0, 2]
    stream.connected()
    assert stream.receive(message(9)) is None
    after = stream.receive(message(10))
    assert after is not None
    assert after.attrs["missed_pictures"] == 0
    stream.connected()  # to a daemon that was started again
    restarted = stream.receive(message(1))
    assert restarted is not None
    assert restarted.attrs["missed_pictures"] == 0


def test_a_message_of_another_version() -> None:
    stream = PictureStream("newest")
    stream.connected()
    with pytest.raises(VersionMismatchError, match="version 3"):
        stream.receive(message(1).replace(b'"version":1', b'"version":3'))
