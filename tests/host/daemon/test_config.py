"""Configuration: strict, and safe beyond loopback."""

from __future__ import annotations

from pathlib import Path

import pytest

from hueflight.daemon.config import ConfigError, DaemonConfig, ServerConfig


def test_defaults_and_files(tmp_path: Path) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text('name = "bench-1"\n[server]\nport = 9000\n[recording]\nqueue_mb = 64\n')
    config = DaemonConfig.load(path)
    assert (config.name, config.server.port, config.recording.queue_mb) == ("bench-1", 9000, 64)
    assert config.server.host == "127.0.0.1"
    assert config.server.token() is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("colour = 1", "colour"),
        ("name = 3", "name"),
        ("name = '../x'", "must be up to 64 letters"),
        ("[server]\nport = 70000", "server.port = 70000"),
        ("[server]\nmax_viewers = 0", "server.max_viewers = 0"),
        ("name = ", "not TOML"),
        ("pictures_hz = -1.0", "pictures_hz = -1.0"),
    ],
)
def test_errors_name_the_key(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        DaemonConfig.load(path)


def test_beyond_loopback_a_token_is_needed(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="lets other machines in"):
        ServerConfig(host="0.0.0.0").token()
    path = tmp_path / "token"
    path.write_text("short\n")
    path.chmod(0o600)
    with pytest.raises(ConfigError, match="at least 16"):
        ServerConfig(host="0.0.0.0", token_file=str(path)).token()
    path.write_text("0123456789abcdef\n")
    assert ServerConfig(host="0.0.0.0", token_file=str(path)).token() == "0123456789abcdef"
    path.chmod(0o644)
    with pytest.raises(ConfigError, match="can be read by others"):
        ServerConfig(host="0.0.0.0", token_file=str(path)).token()
