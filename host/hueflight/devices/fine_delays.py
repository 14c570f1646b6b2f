# SPDX-License-Identifier: Apache-2.0
"""Fine delay lines of an illuminator: times below one tick, for each channel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hueflight.errors import HueflightError


class FineDelayError(HueflightError):
    """Fine delays that the board's lines can't make."""


@dataclass(frozen=True)
class FineDelays:
    """Settings of the fine delay lines, and how late each channel is with them.

    Attributes
    ----------
    steps : int
        Settings of a line, 0 included.
    step_ns : float
        Step of the lines, in nanoseconds.
    settings : tuple of int
        Setting of each channel, from 0 to ``steps - 1``.
    skew_ns : tuple of float
        How much later each channel fires than another one, any, at the same setting, in
        nanoseconds.

    Raises
    ------
    FineDelayError
        If a number is out of its range.
    """

    steps: int
    step_ns: float
    settings: tuple[int, ...]
    skew_ns: tuple[float, ...]

    def __post_init__(self) -> None:
        if not 0 < self.step_ns < math.inf:
            raise FineDelayError(f"step_ns = {self.step_ns}: must be a time, more than 0")
        if len(self.skew_ns) != len(self.settings):
            raise FineDelayError(
                f"skew_ns: {len(self.skew_ns)} values, the board has {len(self.settings)} channels"
            )
        for channel, (setting, skew) in enumerate(zip(self.settings, self.skew_ns, strict=True)):
            if not 0 <= setting < self.steps:
                raise FineDelayError(
                    f"channel {channel}: setting = {setting}: must be from 0 to {self.steps - 1}"
                )
            if not math.isfinite(skew):
                raise FineDelayError(f"channel {channel}: skew_ns = {skew}: must be a number")

    @property
    def offset_ns(self) -> float:
        """Time by which all channels fire later than asked: the skew of the latest one.

        A channel can be made later, but not earlier.
        """
        return max(self.skew_ns)

    def late_ns(self, channel: int, /) -> float:
        """Return how much a channel adds to its delay in ticks, apart from `offset_ns`.

        Parameters
        ----------
        channel : int
            Number of the channel.

        Returns
        -------
        float
            Time in nanoseconds; negative if its skew is less than the largest one.
        """
        return self.settings[channel] * self.step_ns + self.skew_ns[channel] - self.offset_ns

    def fitted(self, delays_ns: Sequence[Sequence[float]], tick_ns: float, /) -> FineDelays:
        """Return the settings that make delays as exact as they can be, skew included.

        A line delays all pulses of its channel by the same time. Of several pulses the largest
        error is made as small as possible.

        Parameters
        ----------
        delays_ns : sequence of sequences of float
            Delays of the pulses of each channel, in nanoseconds.
        tick_ns : float
            Length of a tick, in nanoseconds.

        Returns
        -------
        FineDelays
            The same lines with other settings; channels without pulses are set to 0.
        """
        useful = min(self.steps, math.ceil(tick_ns / self.step_ns) + 1)
        settings = [0] * len(self.settings)
        for channel, delays in enumerate(delays_ns[: len(settings)]):
            late = self.skew_ns[channel] - self.offset_ns
            settings[channel] = min(
                range(useful),
                key=lambda setting: max(
                    (
                        # rounded, so that the smaller of two equal settings is taken
                        round(abs(error_ns(delay, late + setting * self.step_ns, tick_ns)), 9)
                        for delay in delays
                    ),
                    default=0.0,
                ),
            )
        return replace(self, settings=tuple(settings))


def ticks_of(delay_ns: float, late_ns: float, tick_ns: float, /) -> int:
    """Return the ticks that come nearest to a delay.

    Parameters
    ----------
    delay_ns : float
        Delay that is asked for, in nanoseconds.
    late_ns : float
        What the channel adds to its ticks, in nanoseconds.
    tick_ns : float
        Length of a tick, in nanoseconds.

    Returns
    -------
    int
        Ticks, 0 or more.
    """
    return max(0, round((delay_ns - late_ns) / tick_ns))


def error_ns(delay_ns: float, late_ns: float, tick_ns: float, /) -> float:
    """Return by how much a channel is later than asked at the nearest tick; see `ticks_of`."""
    return ticks_of(delay_ns, late_ns, tick_ns) * tick_ns + late_ns - delay_ns
