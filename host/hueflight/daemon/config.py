# SPDX-License-Identifier: Apache-2.0
"""Configuration of a daemon, read from one TOML file in which unknown keys are errors."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path
from typing import Literal

import msgspec

from hueflight.daemon.config_section import ConfigError, Section, require_ranges
from hueflight.daemon.picture_settings import LONGEST_S
from hueflight.daemon.server_config import DEFAULT_PORT, LOOPBACK, CameraConfig, ServerConfig

__all__ = [
    "DEFAULT_PORT",
    "LOOPBACK",
    "ConfigError",
    "DaemonConfig",
    "MaterialsConfig",
    "RecordingConfig",
    "ServerConfig",
]

MOST_CAMERAS = 15  #: beside the daemon's own; browsers draw in sixteen places at most
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,63}")


class RecordingConfig(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits on the memory and disk space of recordings, and pictures in them.

    Attributes
    ----------
    queue_mb : int
        Most packets that wait for a slow disk, in MiB.
    min_free_mb : int
        Disk space that recordings leave free, in MiB.
    foxglove_hz : float
        Pictures per second of recording that are added for Foxglove, on channels of their own,
        when a recording has ended; 0 for none.
    """

    queue_mb: int = 128
    min_free_mb: int = 256
    foxglove_hz: float = 0.0

    def __post_init__(self) -> None:
        require_ranges(
            self,
            "recording.",
            queue_mb=(1, 65536),
            min_free_mb=(1, 1 << 30),
            foxglove_hz=(0, 1000),
        )


class MaterialsConfig(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Materials and spectral indices that the page shows of a pixel.

    Attributes
    ----------
    library : str
        Spectra of materials: a CSV file, or ``"colorchecker"``; empty for none. See
        `hueflight.analysis.SpectralLibrary.load`.
    names : tuple of str
        Materials of the library that may occur; empty for all.
    indices : tuple of str
        Spectral indices; see `hueflight.analysis.add_materials`.
    """

    library: str = ""
    names: tuple[str, ...] = ()
    indices: tuple[str, ...] = ()


class DaemonConfig(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
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
    sends : str
        What the camera sends: ``"codes"`` of all frames, a few ``"sums"`` per pixel and picture, or
        ``"auto"``, which is codes where the link carries them and sums where it does not.
    method : str
        Method of reconstruction, ``"joint"``, ``"pooled"`` or ``"paper"``; empty for the best one
        that keeps up.
    pictures_hz : float
        Live pictures per second; 0 for a rate that suits the frame rate.
    picture_frames : int
        Frames behind each live picture; 0 for a number that suits the frame rate.
    integration_s : float or None
        Longest time in seconds over which photons of a pixel add up while it does not change;
        ``inf`` for no limit, 0 for the newest frames alone. By default there is no limit, or 0 if
        `picture_frames` is given.
    change_sigma : float
        Standard deviations by which a pixel must have changed to be fitted again at once, where
        photons do not add up; 0 fits all pixels of every picture.
    threads : int
        Threads that count photons.
    picture_threads : int
        Threads that reconstruct, at a lower priority; 0 for one per core.
    foxglove : bool
        Serve live pictures to Foxglove, on a port of its own.
    server : ServerConfig
        Address, and limits on clients.
    recording : RecordingConfig
        Limits on recordings.
    materials : MaterialsConfig
        Materials and spectral indices that the page shows.
    cameras : tuple of CameraConfig
        Other daemons, whose cameras are shown beside this one's.
    """

    name: str = "hueflight"
    instrument: str = "paper"
    data: str = "~/hueflight"
    simulate: bool | None = None
    scene: str = "fig1"
    rig: str = ""
    camera: str = ""
    illuminator: str = ""
    sends: Literal["codes", "sums", "auto"] = "auto"
    method: str = ""
    pictures_hz: float = 0.0
    picture_frames: int = 0
    integration_s: float | None = None
    change_sigma: float = 4.0
    threads: int = 1
    picture_threads: int = 0
    foxglove: bool = False
    server: ServerConfig = ServerConfig()
    recording: RecordingConfig = RecordingConfig()
    materials: MaterialsConfig = MaterialsConfig()
    cameras: tuple[CameraConfig, ...] = ()

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise ConfigError(
                f"name = {self.name!r}: must be up to 64 letters, digits, spaces and '._-'"
            )
        require_ranges(
            self,
            "",
            pictures_hz=(0, 1000),
            picture_frames=(0, 10_000_000),
            change_sigma=(0, 100),
            threads=(1, 256),
            picture_threads=(0, 256),
        )
        if len(self.cameras) > MOST_CAMERAS:
            raise ConfigError(f"{len(self.cameras)} tables [[cameras]]: at most {MOST_CAMERAS}")
        if self.integration_s not in (None, math.inf):
            require_ranges(self, "", integration_s=(0, LONGEST_S))

    @property
    def integration_or_default(self) -> float:
        """Longest time over which photons add up, in seconds; infinite for no limit."""
        if self.integration_s is not None:
            return self.integration_s
        return 0.0 if self.picture_frames else math.inf

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
