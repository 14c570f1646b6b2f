# SPDX-License-Identifier: Apache-2.0
"""Types of what a client is given and gives."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import xarray as xr

from hueflight.live.protocol import Delivery

__all__ = ["CaptureKind", "Delivery", "Exposure", "RemoteRecording"]

#: kind of capture, which decides which LEDs fire
CaptureKind = Literal["scene", "reference", "bands", "dark", "flat"]


@dataclass(frozen=True)
class Exposure:
    """Live pictures that were begun anew.

    Attributes
    ----------
    frames : int
        Frames behind each picture at least.
    after : int
        Number of the latest picture that may hold older photons.
    """

    frames: int
    after: int

    def holds(self, picture: xr.Dataset, /) -> bool:
        """Return whether a picture has all its frames, none of them older than the exposure.

        Parameters
        ----------
        picture : xarray.Dataset
            Picture of the client.

        Returns
        -------
        bool
            True if it has.
        """
        return picture.attrs["number"] > self.after and picture.attrs["frames"] >= self.frames


@dataclass(frozen=True)
class RemoteRecording:
    """A finished recording in the folder of a daemon.

    Attributes
    ----------
    name : str
        Name of the recording.
    bytes : int
        Size of all its segments.
    segments : int
        Number of its segments.
    modified : datetime
        Time of its first segment's last change.
    """

    name: str
    bytes: int
    segments: int
    modified: datetime
