# SPDX-License-Identifier: Apache-2.0
"""The daemon behind nginx, with the configuration that the documentation states."""

from __future__ import annotations

import json
import re
import shutil
import socket
import ssl
import subprocess
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from websockets.sync.client import connect

from support.daemon_process import PATIENCE_S, Daemon, until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
PAGE = Path(__file__).resolve().parents[3] / "docs/how-to/remote-use.md"
TOKEN = "operator-0123456789"
Start = Callable[..., Daemon]


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return sock.getsockname()[1]


def block(language: str, containing: str) -> str:
    """The block of the page in a language that contains some text."""
    blocks = re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)
    [found] = [text for text in blocks if containing in text]
    return found


@pytest.fixture
def proxy(tmp_path: Path, start_simulated: Start) -> Iterator[tuple[Daemon, int, ssl.SSLContext]]:
    """A daemon, the port of nginx in front of it, and whom to trust."""
    program = shutil.which("nginx", path="/usr/sbin:/usr/local/sbin:/usr/bin")
    openssl = shutil.which("openssl")
    if program is None or openssl is None:
        pytest.skip("nginx is not installed")
    certificate, key, port = tmp_path / "lab.pem", tmp_path / "lab.key", free_port()
    subprocess.run(
        [
            openssl, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1",
            "-nodes", "-keyout", key, "-out", certificate, "-days", "2", "-subj", "/CN=localhost",
            "-addext", "subjectAltName=DNS:localhost",
        ],
        check=True, capture_output=True,
    )  # fmt: skip
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    server = block("toml", "trusted_proxies").replace("[server]\n", "")
    server = server.replace("/etc/hueflight/token", str(token))
    server = server.replace("lab.example:443", f"localhost:{port}")
    daemon = start_simulated(tmp_path / "data", server=server)
    config = block("nginx", "proxy_pass")
    for written, here in (
        ("443 ssl", f"127.0.0.1:{port} ssl"),
        ("lab.example", "localhost"),
        ("/etc/hueflight/lab", str(tmp_path / "lab")),
        ("127.0.0.1:8470", daemon.url.removeprefix("http://")),
    ):
        assert written in config
        config = config.replace(written, here)
    folders = "".join(
        f"{kind}_temp_path {tmp_path}/{kind};\n"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    (tmp_path / "nginx.conf").write_text(
        f"daemon off; user root; pid {tmp_path}/pid; error_log stderr;\nevents {{}}\n"
        f"http {{\naccess_log off;\n{folders}{config}\n}}\n"
    )
    process = subprocess.Popen([program, "-p", tmp_path, "-c", tmp_path / "nginx.conf"])
    try:
        yield daemon, port, ssl.create_default_context(cafile=certificate)
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


def test_behind_nginx(proxy: tuple[Daemon, int, ssl.SSLContext]) -> None:
    """Requests, live pictures and refusals come through, and clients keep their addresses."""
    daemon, port, trust = proxy
    base = f"https://localhost:{port}"

    def ask(path: str, **headers: str) -> tuple[int, dict[str, object]]:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        request = urllib.request.Request(base + path, headers=named)
        if path == "/api/stop":
            request.method = "POST"
        try:
            with urllib.request.urlopen(request, timeout=30, context=trust) as answer:
                return answer.status, json.loads(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, json.loads(error.read())

    def answers() -> bool:
        try:
            return ask("/health")[0] in (200, 503)
        except OSError:
            return False

    until(answers, "nginx answers")
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    assert ask("/api/session")[1] == {"token": "missing", "role": None}
    assert ask("/api/session", **bearer)[1] == {"token": "right", "role": "operator"}
    assert ask("/api/status")[0] == 401
    assert ask("/api/status", **bearer)[0] == 200
    assert ask("/api/stop", **bearer, Origin=base)[0] == 200
    assert ask("/api/stop", **bearer, Origin="https://evil.example")[0] == 403
    assert ask("/api/status", **bearer, Host="evil.example")[0] == 421
    # nginx adds the address that it sees to what a client invents
    assert ask("/api/status", X_Forwarded_For="203.0.113.9")[0] == 401
    protocols = ["hueflight.v1", f"hueflight.token.{TOKEN}"]
    with connect(
        f"wss://localhost:{port}/api/live", ssl=trust, origin=base, subprotocols=protocols
    ) as viewer:
        kinds = {type(viewer.recv(PATIENCE_S)) for _ in range(4)}
        assert str in kinds
    _, log = daemon.end()
    entries = [json.loads(line) for line in log.splitlines()]
    refused = [entry for entry in entries if "refused" in entry["event"]]
    assert refused
    assert {line["client"] for line in refused} == {"127.0.0.1"}
