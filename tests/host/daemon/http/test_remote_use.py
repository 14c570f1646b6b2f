# SPDX-License-Identifier: Apache-2.0
"""Use from elsewhere: tokens and roles, names and ports, and whose word on them is taken."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from hueflight.daemon.config import ConfigError, ServerConfig
from hueflight.daemon.http.refusal import RequestRefusedError
from hueflight.daemon.http.sender import Sender, Senders, ServedHosts

OpenDaemon = Callable[..., Any]
OPERATOR, VIEWER = "operator-0123456789", "viewer-0123456789ab"
LIVE = "ws://127.0.0.1:8470/api/live"


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


# -- tokens and roles ---------------------------------------------------------------------------


def test_a_client_learns_what_its_token_is_good_for(open_daemon: OpenDaemon) -> None:
    with open_daemon(token=OPERATOR, viewer_token=VIEWER) as client:
        for headers, token, role in (
            ({}, "missing", None),
            (bearer("wrong"), "wrong", None),
            (bearer("ü" * 20), "wrong", None),
            (bearer(VIEWER), "right", "viewer"),
            (bearer(OPERATOR), "right", "operator"),
        ):
            sent = {name: value.encode() for name, value in headers.items()}
            answer = client.get("/api/session", headers=sent)
            assert (answer.status_code, answer.json()) == (200, {"token": token, "role": role})
        for headers, code in (({}, "token missing"), (bearer("wrong"), "token wrong")):
            answer = client.get("/api/status", headers=headers)
            assert (answer.status_code, answer.json()["code"]) == (401, code)
    with open_daemon() as client:
        assert client.get("/api/session").json() == {"token": "not required", "role": "operator"}


def test_viewers_see_everything_and_change_nothing(open_daemon: OpenDaemon) -> None:
    with open_daemon(token=OPERATOR, viewer_token=VIEWER, burst=1000) as client:
        paths = client.get("/openapi.json", headers=bearer(VIEWER)).json()["paths"]
        changing = [
            (method, path)
            for path, methods in paths.items()
            for method in methods
            if method != "get"
        ]
        assert len(changing) >= 8
        for method, path in changing:
            path = path.replace("{name}", "x")
            answer = client.request(method, path, headers=bearer(VIEWER))
            assert (answer.status_code, answer.json()["code"]) == (403, "role"), path
            assert client.request(method, path).status_code == 401, path
        for path in ("/api/status", "/api/recordings", "/metrics"):
            assert client.get(path, headers=bearer(VIEWER)).status_code == 200
        protocols = ["hueflight.v1", f"hueflight.token.{VIEWER}"]
        # the test client cancels the application when the socket is closed
        with (
            suppress(CancelledError),
            client.websocket_connect(LIVE, subprotocols=protocols) as socket,
        ):
            assert socket.accepted_subprotocol == "hueflight.v1"
        wrong = ["hueflight.v1", "hueflight.token.wrong"]
        with (
            pytest.raises(WebSocketDisconnect),
            client.websocket_connect(LIVE, subprotocols=wrong),
        ):
            pass
        answer = client.post("/api/stop", headers=bearer(OPERATOR))
        assert answer.status_code == 200


def test_tokens_are_not_guessed_by_the_thousand(open_daemon: OpenDaemon) -> None:
    with open_daemon(token=OPERATOR, requests_per_s=1, burst=10) as client:
        for path in ("/api/session", "/api/status"):
            answers = [client.get(path, headers=bearer("wrong")).status_code for _ in range(30)]
            assert answers.count(429) >= 15
        assert client.get("/api/session", headers=bearer(OPERATOR)).status_code == 200


# -- names and ports ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("allowed", "host", "scheme", "served"),
    [
        ((), "localhost:8470", "http", True),
        ((), "LOCALHOST:8470", "http", True),
        ((), "[::1]:8470", "http", True),
        ((), "localhost:9000", "http", False),  # a port forward
        (("localhost:9000",), "localhost:9000", "http", True),
        (("localhost:9000",), "127.0.0.1:9000", "http", False),
        (("localhost:*",), "localhost:50123", "http", True),
        (("lab.example",), "lab.example:8470", "http", True),
        (("lab.example",), "lab.example", "https", False),
        (("lab.example:443",), "lab.example", "https", True),
        (("lab.example:443",), "lab.example", "http", False),
        (("lab.example:443",), "lab.example:443", "https", True),
        (("lab.example:80",), "lab.example", "http", True),
        (("lab.example:443",), "evil.lab.example", "https", False),
        (("lab.example:*",), "lab.example.evil", "https", False),
        (("[fe80::1]:9000",), "[fe80::1]:9000", "http", True),
        (("lab.example:*",), "", "http", False),
        (("lab.example:*",), "lab.example:x", "http", False),
        (("lab.example:*",), "x@lab.example", "http", False),
    ],
)
def test_names_are_served_with_their_ports(
    allowed: tuple[str, ...], host: str, scheme: str, served: bool
) -> None:
    hosts = ServedHosts(ServerConfig(allowed_hosts=allowed), 8470)
    assert hosts.serves(Sender("203.0.113.9", host, scheme)) is served


@pytest.mark.parametrize("entry", ["lab.example:", "http://lab.example", "a b", "lab:x", "::1"])
def test_names_that_are_none_are_refused(entry: str) -> None:
    with pytest.raises(ConfigError, match=r"server\.allowed_hosts has"):
        ServerConfig(allowed_hosts=(entry,))


def test_a_page_behind_a_port_forward(open_daemon: OpenDaemon) -> None:
    with open_daemon(allowed_hosts=("localhost:9000",)) as client:
        own = {"host": "localhost:9000", "origin": "http://localhost:9000"}
        assert client.post("/api/stop", headers=own).status_code == 200
        other = {"host": "localhost:9000", "origin": "http://localhost:8470"}
        assert client.post("/api/stop", headers=other).status_code == 403


# -- proxies --------------------------------------------------------------------------------------


def sender(headers: dict[str, str], *, peer: str, proxies: tuple[str, ...]) -> Sender:
    scope = {"client": (peer, 50000), "scheme": "http"}
    return Senders(ServerConfig(trusted_proxies=proxies)).of(
        scope, {"host": "127.0.0.1:8470", **headers}
    )


X = {
    "x-forwarded-for": "198.51.100.7, 203.0.113.9",
    "x-forwarded-host": "lab.example",
    "x-forwarded-proto": "https",
}


def test_only_trusted_proxies_are_believed() -> None:
    direct = Sender("192.0.2.1", "127.0.0.1:8470", "http")
    assert sender(X, peer="192.0.2.1", proxies=()) == direct
    assert sender(X, peer="192.0.2.1", proxies=("127.0.0.1",)) == direct
    forwarded = {"forwarded": "for=203.0.113.9;host=lab.example;proto=https"}
    assert sender(forwarded, peer="192.0.2.1", proxies=("127.0.0.1",)) == direct
    seen = Sender("203.0.113.9", "lab.example", "https")
    for peer, proxies in (
        ("192.0.2.1", ("192.0.2.0/24",)),
        ("::ffff:192.0.2.1", ("192.0.2.0/24",)),
        ("fd00::5", ("fd00::/8",)),
    ):
        assert sender(X, peer=peer, proxies=proxies) == seen
        assert sender(forwarded, peer=peer, proxies=proxies) == seen


def test_the_client_is_the_last_that_no_trusted_proxy_is() -> None:
    """What stands before it, the client can have sent itself."""
    chain = {"x-forwarded-for": "127.0.0.1, 203.0.113.9, 10.0.0.2"}
    found = sender(chain, peer="10.0.0.1", proxies=("10.0.0.0/8",))
    assert found.client == "203.0.113.9"
    chain = {"forwarded": 'for=127.0.0.1, for="[2001:db8::9]:4711", for=10.0.0.2;proto=https'}
    assert sender(chain, peer="10.0.0.1", proxies=("10.0.0.0/8",)).client == "2001:db8::9"
    own = {"x-forwarded-for": "10.0.0.9"}  # a machine of the proxies' network asks
    assert sender(own, peer="10.0.0.1", proxies=("10.0.0.0/8",)).client == "10.0.0.9"


@pytest.mark.parametrize(
    "headers",
    [
        {"x-forwarded-for": "unknown"},
        {"x-forwarded-for": "1.2.3.4.5"},
        {"x-forwarded-proto": "gopher"},
        {"x-forwarded-host": "a, b"},
        {"forwarded": "for"},
        {"forwarded": "for=_hidden"},
        {"forwarded": "for=1.2.3.4;for=1.2.3.5"},
        {"forwarded": "for=203.0.113.9", "x-forwarded-for": "203.0.113.9"},
    ],
)
def test_a_proxy_must_speak_clearly(headers: dict[str, str]) -> None:
    with pytest.raises(RequestRefusedError, match="does not say clearly") as refused:
        sender(headers, peer="10.0.0.1", proxies=("10.0.0.0/8",))
    assert (refused.value.status, refused.value.code) == (400, "forwarded")


@given(st.dictionaries(st.sampled_from([*X, "forwarded"]), st.text(max_size=60)))
def test_any_header_is_read_or_refused(headers: dict[str, str]) -> None:
    try:
        found = sender(headers, peer="10.0.0.1", proxies=("10.0.0.0/8",))
    except RequestRefusedError:
        return
    assert found.scheme in ("http", "https")
    ServedHosts(ServerConfig(), 8470).serves(found)


def test_requests_through_a_proxy(open_daemon: OpenDaemon) -> None:
    """Each client has a budget of its own, and a page is the daemon's if host and origin agree."""
    with open_daemon(
        token=OPERATOR, trusted_proxies=("127.0.0.1",), allowed_hosts=("lab.example:443",),
        requests_per_s=1, burst=10,
    ) as client:  # fmt: skip
        proxied = TestClient(client.app, "http://127.0.0.1:8470", client=("127.0.0.1", 4000))
        headers = X | bearer(OPERATOR) | {"origin": "https://lab.example"}
        answers = [proxied.post("/api/stop", headers=headers).status_code for _ in range(20)]
        assert answers[:10] == [200] * 10
        assert answers.count(429) >= 5
        other = headers | {"x-forwarded-for": "198.51.100.7"}
        assert proxied.post("/api/stop", headers=other).status_code == 200
        for changed in ({"origin": "http://lab.example"}, {"origin": "https://evil.example"}):
            assert proxied.post("/api/stop", headers=other | changed).status_code == 403
        elsewhere = other | {"x-forwarded-host": "evil.example"}
        assert proxied.post("/api/stop", headers=elsewhere).status_code == 421


def test_a_proxy_on_loopback_needs_a_token() -> None:
    """Whoever can reach the proxy can reach the daemon."""
    with pytest.raises(ConfigError, match=r"trusted_proxies = .* lets other machines in"):
        ServerConfig(trusted_proxies=("127.0.0.1",)).tokens()
    with pytest.raises(ConfigError, match=r"server\.trusted_proxies: .*'proxy'"):
        ServerConfig(trusted_proxies=("proxy",))
