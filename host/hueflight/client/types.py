# SPDX-License-Identifier: Apache-2.0
"""Types of what a client is given and gives."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from hueflight.live.protocol import Delivery

__all__ = ["CaptureKind", "Delivery", "RemoteRecording"]

#: kind of capture, which decides which LEDs fire
CaptureKind = Literal["scene", "reference", "bands", "dark", "flat"]


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
