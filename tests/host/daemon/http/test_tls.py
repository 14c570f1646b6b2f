# SPDX-License-Identifier: Apache-2.0
"""TLS by certificate files, on a real socket."""

from __future__ import annotations

import contextlib
import shutil
import socket
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("uvicorn", reason="the extra 'daemon' is not installed")

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket
from websockets.sync.client import connect

from hueflight.daemon.config import ConfigError, ServerConfig
from hueflight.daemon.http import tls
from support.web import WAIT_S, serving

MOST = 8  #: open connections


def make_certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """Self-signed certificate of localhost and its key, by OpenSSL's own program."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("the program openssl is not installed")
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    subprocess.run(
        [
            program, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1",
            "-nodes", "-keyout", key, "-out", certificate, "-days", "2", "-subj", "/CN=localhost",
            "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1",
        ],
        check=True, capture_output=True,
    )  # fmt: skip
    key.chmod(0o600)
    return certificate, key


async def scheme(request: Request) -> Response:
    return PlainTextResponse(request.url.scheme)


async def live(web_socket: WebSocket) -> None:
    await web_socket.accept()
    await web_socket.send_text(web_socket.url.scheme)
    await web_socket.receive()


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    return make_certificate(tmp_path, "lab")


@pytest.fixture
def port(files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Of a server with TLS that looks for renewed files at each connection."""
    monkeypatch.setattr(tls, "LOOK_S", 0.0)
    certificate, key = files
    config = ServerConfig(
        port=0, certificate_file=str(certificate), key_file=str(key), max_connections=MOST
    )
    app = Starlette(routes=[Route("/scheme", scheme), WebSocketRoute("/live", live)])
    with serving(app, config) as number:
        yield number


def asked(port: int, certificate: Path) -> bytes:
    """Answer to a client that trusts this certificate alone."""
    context = ssl.create_default_context(cafile=certificate)
    with (
        socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as raw,
        context.wrap_socket(raw, server_hostname="localhost") as sock,
    ):
        sock.sendall(b"GET /scheme HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        answer = b""
        while piece := sock.recv(4096):
            answer += piece
    return answer.partition(b"\r\n\r\n")[2]


def test_requests_and_web_sockets_are_encrypted(port: int, files: tuple[Path, Path]) -> None:
    certificate, _ = files
    assert asked(port, certificate) == b"https"
    context = ssl.create_default_context(cafile=certificate)
    with connect(f"wss://localhost:{port}/live", ssl=context) as viewer:
        assert viewer.recv(WAIT_S) == "wss"
    old = ssl.create_default_context(cafile=certificate)
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        old.maximum_version = ssl.TLSVersion.TLSv1_1
    with (
        socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as raw,
        pytest.raises(ssl.SSLError),
    ):
        old.wrap_socket(raw, server_hostname="localhost")
    assert asked(port, certificate) == b"https"


def test_who_speaks_no_tls_is_cut_off(port: int, files: tuple[Path, Path]) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as sock:
        sock.sendall(b"GET /scheme HTTP/1.1\r\nHost: localhost\r\n\r\n")
        received = b""
        try:
            while piece := sock.recv(4096):
                received += piece
        except ConnectionResetError:
            pass
        assert b"HTTP" not in received
    assert asked(port, files[0]) == b"https"


def test_a_request_that_comes_with_the_end_of_the_handshake_is_answered(
    port: int, files: tuple[Path, Path]
) -> None:
    """In one piece, so that it is there before anything else of the server runs."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    context = ssl.create_default_context(cafile=files[0])
    client = context.wrap_bio(incoming, outgoing, server_hostname="localhost")
    with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as sock:
        while True:
            try:
                client.do_handshake()
                break
            except ssl.SSLWantReadError:
                sock.sendall(outgoing.read())
                incoming.write(sock.recv(65536))
        client.write(b"GET /scheme HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        sock.sendall(outgoing.read())
        answer = b""
        while not answer.endswith(b"https"):
            incoming.write(sock.recv(65536))
            with contextlib.suppress(ssl.SSLWantReadError):
                while not answer.endswith(b"https"):  # a record each time
                    answer += client.read(65536)
    assert answer.startswith(b"HTTP/1.1 200")


def open_sockets() -> int:
    """Of this process, whose server goes on closing them while they are counted."""
    count = 0
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            count += str(link.readlink()).startswith("socket:")
    return count


def test_idle_handshakes_keep_nobody_out(port: int, files: tuple[Path, Path]) -> None:
    """They count as connections from the first moment, and make way."""
    idle = []
    try:
        for _ in range(20 * MOST):
            sock = socket.create_connection(("127.0.0.1", port), timeout=WAIT_S)
            idle.append(sock)
        assert asked(port, files[0]) == b"https"
        # of this process, which is client and server at once: those of clients, and few others
        assert open_sockets() < len(idle) + MOST + 12
    finally:
        for sock in idle:
            sock.close()


def test_renewed_files_are_read(port: int, files: tuple[Path, Path], tmp_path: Path) -> None:
    certificate, key = files
    assert asked(port, certificate) == b"https"
    certificate.write_text("spoiled")
    renewed, new_key = make_certificate(tmp_path, "renewed")
    kept = tmp_path / "kept.pem"
    shutil.copy(renewed, kept)
    with pytest.raises(ssl.SSLCertVerificationError):  # the one before is still shown
        asked(port, kept)
    new_key.replace(key)
    renewed.replace(certificate)
    assert asked(port, kept) == b"https"


def test_files_that_can_not_be_used_are_named(files: tuple[Path, Path], tmp_path: Path) -> None:
    certificate, key = files
    other, other_key = make_certificate(tmp_path, "other")
    for config, words in (
        (ServerConfig(certificate_file=str(certificate), key_file=str(other_key)), "MISMATCH"),
        (ServerConfig(certificate_file="missing.pem", key_file=str(key)), "missing.pem"),
        (ServerConfig(certificate_file=str(key), key_file=str(key)), "certificate_file"),
    ):
        with pytest.raises(ConfigError, match=words):
            tls.Certificate(config)
    encrypted = tmp_path / "encrypted.key"
    subprocess.run(
        ["openssl", "ec", "-in", key, "-out", encrypted, "-aes256", "-passout", "pass:secret"],
        check=True, capture_output=True,
    )  # fmt: skip
    encrypted.chmod(0o600)
    with pytest.raises(ConfigError, match="is encrypted"):
        tls.Certificate(ServerConfig(certificate_file=str(certificate), key_file=str(encrypted)))
    other_key.chmod(0o644)
    with pytest.raises(ConfigError, match="everybody may read"):
        tls.Certificate(ServerConfig(certificate_file=str(other), key_file=str(other_key)))
