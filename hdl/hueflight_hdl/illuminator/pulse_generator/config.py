# SPDX-License-Identifier: Apache-2.0
"""Build-time configuration of a pulse generator: sizes, lanes, and limits for the LEDs."""

from __future__ import annotations

from dataclasses import dataclass, field

from amaranth.lib import data
from amaranth.utils import bits_for

from hueflight_protocol.errors import HueflightError
from hueflight_protocol.illuminator_map import (
    MAX_CHANNELS,
    MAX_PULSES,
    MAX_STEPS,
    MIN_PERIOD_CLOCKS,
)

DELAY_BITS = 12
"""Delays are 0 to 4095 ticks."""
PERIOD_BITS = 13
"""Trains are up to 4096 ticks long."""
MIN_SPACING = MIN_PERIOD_CLOCKS
"""Clocks from one served trigger to the next, at least; gives the sequencer time to step."""
LANES = (1, 2, 4)


class ConfigError(HueflightError):
    """A configuration is out of range."""


@dataclass(frozen=True)
class Limits:
    """Limits for the LED of a channel; built into the gateware.

    Parameters
    ----------
    max_on_ticks : int
        Longest time on without a pause.
    duty_divisor : int
        In any stretch of L ticks the channel is on for at most
        ``L / duty_divisor + burst_ticks``; 1 sets no limit.
    burst_ticks : int
        See `duty_divisor`.
    """

    max_on_ticks: int = 80
    duty_divisor: int = 8
    burst_ticks: int = 80

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("max_on_ticks", self.max_on_ticks, 1, 4095),
            ("duty_divisor", self.duty_divisor, 1, 255),
            ("burst_ticks", self.burst_ticks, 1, 4095),
        ):
            if not low <= value <= high:
                raise ConfigError(f"{name} = {value}: must be from {low} to {high}")


@dataclass(frozen=True)
class PulseConfig:
    """Configuration of a pulse generator.

    Parameters
    ----------
    channels : int
        LED channels, 1 to 32.
    pulses : int
        Pulses per channel and train, 1 to 4.
    lanes : int
        Ticks per clock: 1, 2 or 4.
    steps : int
        Steps of a sequencer program, 1 to 32.
    limits : Limits or tuple of Limits
        For all channels, or one for each.

    Raises
    ------
    ConfigError
        If a number is out of its range.
    """

    channels: int = 9
    pulses: int = MAX_PULSES
    lanes: int = 4
    steps: int = MAX_STEPS
    limits: Limits | tuple[Limits, ...] = field(default_factory=Limits)

    def __post_init__(self) -> None:
        for name, value, high in (
            ("channels", self.channels, MAX_CHANNELS),
            ("pulses", self.pulses, MAX_PULSES),
            ("steps", self.steps, MAX_STEPS),
        ):
            if not 1 <= value <= high:
                raise ConfigError(f"{name} = {value}: must be from 1 to {high}")
        if self.lanes not in LANES:
            raise ConfigError(f"lanes = {self.lanes}: must be one of {LANES}")
        if isinstance(self.limits, tuple) and len(self.limits) != self.channels:
            raise ConfigError(f"{len(self.limits)} limits for {self.channels} channels")
        for channel in range(self.channels):
            if self.limit(channel).max_on_ticks < self.lanes:
                raise ConfigError(
                    f"channel {channel}: max_on_ticks = {self.limit(channel).max_on_ticks} is "
                    f"less than one clock ({self.lanes} ticks)"
                )
            if self.limit(channel).burst_ticks < self.lanes:
                raise ConfigError(
                    f"channel {channel}: burst_ticks = {self.limit(channel).burst_ticks} is less "
                    f"than one clock ({self.lanes} ticks)"
                )

    def limit(self, channel: int) -> Limits:
        """Return the limits of a channel."""
        return self.limits[channel] if isinstance(self.limits, tuple) else self.limits

    @property
    def lane_bits(self) -> int:
        """Low bits of a time in ticks that name the lane."""
        return (self.lanes - 1).bit_length()

    @property
    def width_bits(self) -> int:
        """Bits of a pulse width; wider pulses saturate, and exceed the on-time limit anyway."""
        longest = max(self.limit(channel).max_on_ticks for channel in range(self.channels))
        return max(bits_for(longest + 1), self.lane_bits + 1)

    @property
    def widest(self) -> int:
        """Largest pulse width that the generator can represent, in ticks."""
        return (1 << self.width_bits) - 1

    @property
    def pulse_layout(self) -> data.StructLayout:
        """Layout of one pulse of one channel."""
        return data.StructLayout({"delay": DELAY_BITS, "width": self.width_bits})

    @property
    def bank_layout(self) -> data.StructLayout:
        """Layout of one bank: a schedule for all channels."""
        return data.StructLayout(
            {
                "period": PERIOD_BITS,
                "enable": self.channels,
                "pulses": data.ArrayLayout(
                    data.ArrayLayout(self.pulse_layout, self.pulses), self.channels
                ),
            }
        )

    @property
    def train_layout(self) -> data.StructLayout:
        """Layout of the state of the running train that is distributed to all channels."""
        return data.StructLayout(
            {
                "time": DELAY_BITS - self.lane_bits,  # clocks since the trigger's clock
                "live": 1,  # pulses may still begin
                "phase": self.lane_bits,  # lane of the trigger
                "bank": 1,
            }
        )
