# SPDX-License-Identifier: Apache-2.0
"""A testbench for the whole illuminator, from pin to pin: serial line, triggers, LEDs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..illuminator.gearing.interface import Gearing
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.generator import PulseGenerator
from .cxxrtl import Simulation, simulate
from .serial_line import LineReader, line_levels
from .simulated_pins import SimulatedIlluminator
from .ticks import words_to_ticks

Waveform = Callable[[int, int], np.ndarray]
"""First clock and number of clocks to the words of an input in them."""


class IlluminatorTestbench:
    """A simulated board on a serial line; time passes while the line is read.

    It has the interface of a serial port, so the driver for the hardware runs on it unchanged,
    down to the bits on the pins.

    Parameters
    ----------
    config : IlluminatorConfig
    gearing : Gearing
        Gearing of the board; its simulation model is used.
    step_clocks : int
        Clocks of `pulse` that pass in one read.

    Attributes
    ----------
    trigger, frame_sync, clock_failed : Waveform or None
        What the inputs do; low without one.
    clock : int
        Clocks of `pulse` so far.
    """

    name = "simulated gateware"

    def __init__(
        self, config: IlluminatorConfig, gearing: Gearing, *, step_clocks: int = 4000
    ) -> None:
        self.config = config
        self.gearing = gearing
        self.trigger: Waveform | None = None
        self.frame_sync: Waveform | None = None
        self.clock_failed: Waveform | None = None
        self.clock = 0
        self.recording = False
        self._step_clocks = step_clocks
        self._bit_clocks = config.pulse_hz / config.baud
        self._reader = LineReader(clocks_per_bit=self._bit_clocks)
        self._pending = np.ones(0, np.uint8)
        self._recorded: list[np.ndarray] = []
        self._simulation: Simulation = simulate(
            SimulatedIlluminator(config, gearing), clocks={"pulse": 1, "sync": config.clock_ratio}
        )

    @property
    def latency_clocks(self) -> int:
        """Clocks from the trigger's pin to the LED's."""
        return self.gearing.input_latency + PulseGenerator.latency + self.gearing.output_latency

    # -- a line of bytes ------------------------------------------------------------------------

    def write(self, data: bytes, /) -> None:
        """Put bytes on the line; they travel as time passes."""
        levels = line_levels(data, clocks_per_bit=self._bit_clocks)
        self._pending = np.concatenate((self._pending, levels))

    def write_levels(self, levels: np.ndarray, /) -> None:
        """Put any levels on the line, one for each clock."""
        self._pending = np.concatenate((self._pending, levels.astype(np.uint8)))

    def read(self, timeout_s: float, /) -> bytes:
        """Let time pass, and return the bytes that came."""
        return self.advance(self._step_clocks)

    def close(self) -> None:
        """Leave the line; the simulation goes on."""

    # -- time -----------------------------------------------------------------------------------

    def advance(self, clocks: int, /) -> bytes:
        """Let so many clocks pass, and return the bytes that came."""
        records = self._simulation.inputs(clocks)
        records["rx"] = 1
        sent = min(clocks, len(self._pending))
        records["rx"][:sent] = self._pending[:sent]
        self._pending = self._pending[sent:]
        if self.trigger is not None:
            records["trigger"] = self.trigger(self.clock, clocks)
        if self.frame_sync is not None:
            records["frame_sync"] = self.frame_sync(self.clock, clocks)
        if self.clock_failed is not None:
            records["clock_failed"] = self.clock_failed(self.clock, clocks)
        outputs = self._simulation.run(records)
        self.clock += clocks
        if self.recording:
            self._recorded.append(outputs)
        return self._reader.feed(outputs["tx"])

    def record(self) -> None:
        """Begin to keep what the outputs do."""
        self._recorded = []
        self.recording = True

    def recorded(self) -> np.ndarray:
        """Return the output records since `record`, one for each clock."""
        return (
            np.concatenate(self._recorded)
            if self._recorded
            else self._simulation.run(self._simulation.inputs(0))
        )

    def levels(self) -> np.ndarray:
        """Return what the LEDs did since `record`, bool, shape (channels, ticks)."""
        pulse = self.config.pulse
        return words_to_ticks(self.recorded()["levels"], lanes=pulse.lanes, signals=pulse.channels)
