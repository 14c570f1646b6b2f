# SPDX-License-Identifier: Apache-2.0
"""Pictures for Foxglove in recordings that have just ended, on channels beside the packets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import structlog

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.export import add_foxglove_channels
from hueflight.export.foxglove_recording import FRAMES

log = structlog.get_logger("hueflight.daemon")


class RecordingPictures:
    """Adds pictures to recordings; their packets stay as they are, byte for byte.

    Parameters
    ----------
    pictures_hz : float
        Pictures per second of recording; 0 for none.
    calibration : callable
        Returns the calibration in use, or None, with which nothing is added.
    """

    def __init__(
        self, pictures_hz: float, /, *, calibration: Callable[[], Calibration | None]
    ) -> None:
        self._pictures_hz, self._calibration = pictures_hz, calibration

    def add(self, path: Path, summary: dict[str, Any], /) -> None:
        """Add pictures to a recording of a scene; a failure is logged and leaves it as it was.

        Parameters
        ----------
        path : Path
            First file of a recording that is finished.
        summary : dict
            Summary of its run.
        """
        calibration, frames = self._calibration(), int(summary.get("recorded_frames") or 0)
        if not self._pictures_hz or calibration is None or not frames:
            return
        if summary.get("kind") != "scene":
            return
        rate_hz = frames / max(float(summary.get("seconds") or 0.0), 1e-3)
        every = max(1, round(rate_hz / self._pictures_hz))
        try:
            add_foxglove_channels(
                path,
                path,
                calibration,
                every=every,
                frames=min(FRAMES, frames),
                overwrite=True,
            )
        except (HueflightError, OSError) as error:
            log.error("pictures can't be added", name=path.stem, reason=str(error))
        else:
            log.info("pictures added", name=path.stem, every=every)
