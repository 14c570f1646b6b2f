# SPDX-License-Identifier: Apache-2.0
"""Configuration: strict, and safe beyond loopback."""

from __future__ import annotations

from pathlib import Path

import pytest

from hueflight.daemon.config import ConfigError, DaemonConfig, ServerConfig
from hueflight.daemon.server_config import Tokens


def test_defaults_and_files(tmp_path: Path) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text('name = "bench-1"\n[server]\nport = 9000\n[recording]\nqueue_mb = 64\n')
    config = DaemonConfig.load(path)
    assert (config.name, config.server.port, config.recording.queue_mb) == ("bench-1", 9000, 64)
    assert config.server.host == "127.0.0.1"
    assert config.server.tokens() == Tokens()


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
        ("pictures_hz = nan", "pictures_hz = nan"),
        ("picture_frames = 20000000", "picture_frames = 20000000: must be from 0 to 10000000"),
        ("threads = 0", "threads = 0: must be from 1"),
        ("[server]\nmax_connections = 1", "server.max_connections = 1: must be from 4"),
        ("[recording]\nqueue_mb = 0", "recording.queue_mb = 0: must be from 1"),
        ("[recording]\nmin_free_mb = -1", "recording.min_free_mb = -1: must be from 1"),
    ],
)
def test_errors_name_the_key(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        DaemonConfig.load(path)


def test_every_number_has_a_range(tmp_path: Path) -> None:
    """Neither of two absurd values of any number is taken."""
    from hueflight.daemon.config import RecordingConfig

    for section, prefix in (
        (DaemonConfig(), ""),
        (ServerConfig(), "[server]\n"),
        (RecordingConfig(), "[recording]\n"),
    ):
        for name in section.__struct_fields__:
            default = getattr(section, name)
            if isinstance(default, bool) or not isinstance(default, int | float):
                continue
            for absurd in (-(1 << 60), 1 << 60):
                path = tmp_path / "daemon.toml"
                path.write_text(f"{prefix}{name} = {absurd}")
                with pytest.raises(ConfigError, match=rf"{name} = -?[0-9.e+]+: must be from"):
                    DaemonConfig.load(path)


def test_beyond_loopback_a_token_is_needed(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="lets other machines in"):
        ServerConfig(host="0.0.0.0").tokens()
    path = tmp_path / "token"
    path.write_text("short\n")
    path.chmod(0o600)
    with pytest.raises(ConfigError, match="at least 16"):
        ServerConfig(host="0.0.0.0", token_file=str(path)).tokens()
    path.write_text("0123456789abcdef\n")
    assert ServerConfig(host="0.0.0.0", token_file=str(path)).tokens() == Tokens("0123456789abcdef")
    path.chmod(0o644)
    with pytest.raises(ConfigError, match="can be read by others"):
        ServerConfig(host="0.0.0.0", token_file=str(path)).tokens()


def test_viewers_have_a_token_of_their_own(tmp_path: Path) -> None:
    for name, token in (("operator", "0123456789abcdef"), ("viewer", "fedcba9876543210")):
        (tmp_path / name).write_text(token)
        (tmp_path / name).chmod(0o600)
    both = {
        "token_file": str(tmp_path / "operator"), "viewer_token_file": str(tmp_path / "viewer")
    }  # fmt: skip
    assert ServerConfig(**both).tokens() == Tokens("0123456789abcdef", "fedcba9876543210")
    with pytest.raises(ConfigError, match="hold the same token"):
        ServerConfig(**both | {"viewer_token_file": both["token_file"]}).tokens()
    with pytest.raises(ConfigError, match="everybody would be an operator"):
        ServerConfig(viewer_token_file=both["viewer_token_file"]).tokens()


def test_certificate_and_key_belong_together() -> None:
    with pytest.raises(ConfigError, match="give both or none"):
        ServerConfig(certificate_file="lab.pem")
