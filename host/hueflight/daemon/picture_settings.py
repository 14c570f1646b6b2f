# SPDX-License-Identifier: Apache-2.0
"""How live pictures are made, as clients may change it while the daemon runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hueflight.errors import HueflightError
from hueflight.reconstruction.entry_point import METHODS

LONGEST_S = 1e6  #: of integration, besides no limit at all


class PictureSettingsError(HueflightError):
    """Settings of live pictures that are not possible."""


@dataclass(frozen=True)
class PictureSettings:
    """How live pictures are made.

    Attributes
    ----------
    integration_s : float
        Longest time in seconds over which photons of a pixel add up while it does not change;
        infinite for no limit. 0 stands for the newest frames alone, changed or not.
    method : str
        Method of reconstruction.
    frames : int
        Frames behind each picture at least, where `integration_s` is 0; 0 for as many as the daemon
        was configured for.

    Raises
    ------
    PictureSettingsError
        If the time is out of range, or there is no such method.
    """

    integration_s: float
    method: str
    frames: int = 0

    def __post_init__(self) -> None:
        seconds = self.integration_s
        if not (0 <= seconds <= LONGEST_S or seconds == math.inf):
            raise PictureSettingsError(
                f"integration_s = {seconds}: must be from 0 to {LONGEST_S:g}, or without limit"
            )
        if self.method not in METHODS:
            raise PictureSettingsError(
                f"method = {self.method!r}: choose one of {', '.join(METHODS)}"
            )
