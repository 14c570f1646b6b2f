# SPDX-License-Identifier: Apache-2.0
"""How streams are cut into pictures, as the configuration says."""

from __future__ import annotations

from dataclasses import replace

from hueflight.acquisition.run_settings import RunSettings
from hueflight.daemon.config import DaemonConfig
from hueflight.model.instrument import Instrument


def run_settings(config: DaemonConfig, instrument: Instrument, /) -> RunSettings:
    """Return how streams are cut into pictures, at an instrument's frame rate.

    Parameters
    ----------
    config : DaemonConfig
        Pictures per second, frames behind each, and limits of queues.
    instrument : Instrument
        States the frame rate.

    Returns
    -------
    RunSettings
        The settings.
    """
    found = RunSettings.of(
        instrument,
        pictures_hz=config.pictures_hz or None,
        picture_frames=config.picture_frames or None,
    )
    return replace(
        found,
        threads=config.threads,
        recorder_queue_bytes=config.recording.queue_mb << 20,
        min_free_bytes=config.recording.min_free_mb << 20,
    )
