# SPDX-License-Identifier: Apache-2.0
"""How the stream of a run is cut into histograms, and how much of it may wait."""

from __future__ import annotations

from dataclasses import dataclass

from hueflight.acquisition.recorder import MIN_FREE_BYTES, QUEUE_BYTES
from hueflight.model.instrument import Instrument

LIVE_FRAMES = 480  #: behind each live picture at least, as far as the picture rate allows
PICTURES_HZ = 30.0
SLOW_PICTURES_HZ = 10.0


@dataclass(frozen=True)
class RunSettings:
    """How a stream is cut into histograms, and how much may wait.

    Attributes
    ----------
    rate_hz : float
        Frames per second to expect.
    block_frames : int
        Number of frames from one live histogram to the next.
    window_blocks : int
        Number of blocks whose sum a live picture is made of.
    threads : int
        Number of threads that count photons.
    recorder_queue_bytes, min_free_bytes : int
        Limits of the `Recorder`.
    """

    rate_hz: float
    block_frames: int
    window_blocks: int = 1
    threads: int = 1
    recorder_queue_bytes: int = QUEUE_BYTES
    min_free_bytes: int = MIN_FREE_BYTES

    @classmethod
    def of(
        cls,
        instrument: Instrument,
        /,
        *,
        pictures_hz: float | None = None,
        picture_frames: int | None = None,
    ) -> RunSettings:
        """Choose settings that suit an instrument's frame rate.

        Parameters
        ----------
        instrument : Instrument
            The instrument.
        pictures_hz : float, optional
            Live histograms per second; by default 30, or 10 where so few frames come that
            pictures overlap.
        picture_frames : int, optional
            Number of frames behind each picture; by default all since the one before, and at
            least 480.

        Returns
        -------
        RunSettings
            The settings.
        """
        rate = instrument.sensor.usual_frame_rate_hz
        if pictures_hz is None:
            few = rate / PICTURES_HZ < LIVE_FRAMES
            pictures_hz = SLOW_PICTURES_HZ if few else PICTURES_HZ
        block = max(1, round(rate / pictures_hz))
        wanted = picture_frames or max(LIVE_FRAMES, block)
        return cls(rate, block, max(1, round(wanted / block)))
