# SPDX-License-Identifier: Apache-2.0
"""Configuration of a daemon, read from one TOML file in which unknown keys are errors."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import msgspec

from hueflight.errors import HueflightError

DEFAULT_PORT = 8470
LOOPBACK = ("127.0.0.1", "::1", "localhost")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,63}")
MIN_TOKEN_LENGTH = 16


class ConfigError(HueflightError):
    """A configuration that can't be read, or that would be unsafe."""


class _Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A strict, immutable table."""


def _require_ranges(section: _Section, prefix: str, /, **ranges: tuple[float, float]) -> None:
    """Refuse numbers outside their ranges; a number that is not finite is outside of any."""
    for name, (low, high) in ranges.items():
        value = getattr(section, name)
        if not low <= value <= high:
            raise ConfigError(f"{prefix}{name} = {value}: must be from {low:g} to {high:.10g}")


class ServerConfig(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Address of the daemon, and limits on its clients.

    Attributes
    ----------
    host : str
        Address on which the daemon listens. Beyond loopback a token is required.
    port : int
        Port on which the daemon listens; 0 for any free one.
    token_file : str
        File with the token that clients must send; only its owner may be able to read it.
    allowed_hosts : tuple of str
        Further names by which browsers may address the daemon, besides loopback and `host`.
    max_connections : int
        Most open connections of all clients together.
    max_connections_per_address : int
        Most open connections of one client address.
    max_viewers : int
        Most viewers of the live picture at the same time.
    requests_per_s : float
        Requests per second that one client address may send in the long run.
    burst : int
        Requests that one client address may send at once.
    max_body_bytes : int
        Most bytes in the body of a request.
    """

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    token_file: str = ""
    allowed_hosts: tuple[str, ...] = ()
    max_connections: int = 64
    max_connections_per_address: int = 48
    max_viewers: int = 8
    requests_per_s: float = 50.0
    burst: int = 100
    max_body_bytes: int = 1 << 16

    def __post_init__(self) -> None:
        _require_ranges(
            self,
            "server.",
            port=(0, 65535),
            max_connections=(4, 4096),
            max_connections_per_address=(1, 4096),
            max_viewers=(1, 256),
            requests_per_s=(1, 1e6),
            burst=(1, 1_000_000),
            max_body_bytes=(1 << 10, 1 << 24),
        )

    @property
    def beyond_loopback(self) -> bool:
        """True if other machines can reach the daemon."""
        return self.host not in LOOPBACK

    def token(self) -> str | None:
        """Return the token that clients must send.

        Returns
        -------
        str or None
            The token; None on loopback if no file is named.

        Raises
        ------
        ConfigError
            If a token is required and missing, can be read by others, or is too short.
        """
        if not self.token_file:
            if self.beyond_loopback:
                raise ConfigError(
                    f"server.host = {self.host!r} lets other machines in: write a token to a file "
                    "and name it in server.token_file (or --token-file), for example made by: "
                    "python3 -c 'import secrets; print(secrets.token_urlsafe())'"
                )
            return None
        path = Path(self.token_file).expanduser()
        try:
            token = path.read_text("ascii").strip()
            shared = path.stat().st_mode & 0o077
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"can't read the token in {path}: {error}") from None
        if shared:
            raise ConfigError(f"{path} can be read by others: chmod 600 {path}")
        if len(token) < MIN_TOKEN_LENGTH or not re.fullmatch(r"[A-Za-z0-9_.~-]+", token):
            raise ConfigError(
                f"the token in {path} must be at least {MIN_TOKEN_LENGTH} letters, digits and "
                "'-_.~'"
            )
        return token


class RecordingConfig(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits on the memory and disk space of recordings.

    Attributes
    ----------
    queue_mb : int
        Most packets that wait for a slow disk, in MiB.
    min_free_mb : int
        Disk space that recordings leave free, in MiB.
    """

    queue_mb: int = 128
    min_free_mb: int = 256

    def __post_init__(self) -> None:
        _require_ranges(self, "recording.", queue_mb=(1, 65536), min_free_mb=(1, 1 << 30))


class DaemonConfig(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Configuration of one daemon, which runs one camera.

    Attributes
    ----------
    name : str
        Name shown on the page and in metrics, to tell several daemons apart.
    instrument : str
        Name of a preset, or path of a TOML file.
    data : str
        Folder of recordings and calibrations.
    simulate : bool or None
        True uses the simulated instrument, False never does. By default it is used if no camera is
        plugged in and none is named.
    scene : str
        Scene of the simulated instrument.
    rig : str
        Address of the rig, in place of `simulate`, `scene`, `camera` and `illuminator`.
    camera : str
        Serial number of the camera, which is needed if several are plugged in.
    illuminator : str
        Serial port of the illuminator; empty if something else drives the LEDs.
    method : str
        Method of reconstruction, ``"joint"``, ``"pooled"`` or ``"paper"``; empty for the best one
        that keeps up.
    pictures_hz : float
        Live pictures per second; 0 for a rate that suits the frame rate.
    picture_frames : int
        Frames behind each live picture; 0 for a number that suits the frame rate.
    change_sigma : float
        Standard deviations by which a pixel must have changed to be fitted again at once; 0 fits
        all pixels of every picture.
    threads : int
        Threads that count photons.
    picture_threads : int
        Threads that reconstruct, at a lower priority; 0 for one per core.
    server : ServerConfig
        Address, and limits on clients.
    recording : RecordingConfig
        Limits on recordings.
    """

    name: str = "hueflight"
    instrument: str = "paper"
    data: str = "~/hueflight"
    simulate: bool | None = None
    scene: str = "fig1"
    rig: str = ""
    camera: str = ""
    illuminator: str = ""
    method: str = ""
    pictures_hz: float = 0.0
    picture_frames: int = 0
    change_sigma: float = 4.0
    threads: int = 1
    picture_threads: int = 0
    server: ServerConfig = ServerConfig()
    recording: RecordingConfig = RecordingConfig()

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise ConfigError(
                f"name = {self.name!r}: must be up to 64 letters, digits, spaces and '._-'"
            )
        _require_ranges(
            self,
            "",
            pictures_hz=(0, 1000),
            picture_frames=(0, 10_000_000),
            change_sigma=(0, 100),
            threads=(1, 256),
            picture_threads=(0, 256),
        )

    @property
    def folder(self) -> Path:
        """Absolute path of the data folder."""
        return Path(self.data).expanduser().resolve()

    @classmethod
    def load(cls, path: Path) -> DaemonConfig:
        """Return the configuration in a TOML file.

        Parameters
        ----------
        path : Path
            Path of the file.

        Returns
        -------
        DaemonConfig
            The configuration.

        Raises
        ------
        ConfigError
            If the file can't be read, or a key is unknown or has the wrong type.
        """
        try:
            return msgspec.convert(tomllib.loads(path.read_text("utf-8")), cls)
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"can't read {path}: {error}") from None
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"{path} is not TOML: {error}") from None
        except msgspec.ValidationError as error:
            cause = error.__cause__ if isinstance(error.__cause__, ConfigError) else error
            raise ConfigError(f"{path}: {cause}") from None
