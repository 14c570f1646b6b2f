# SPDX-License-Identifier: Apache-2.0
"""Sets the fine delay lines behind the outputs of the LEDs.

A line has no input for its setting: it is loaded with the one from configuration, which is 0 here,
and moves by one step with each pulse.

# Ref: Lattice FPGA-TN-02035, ECP5 and ECP5-5G High-Speed I/O Interface: DELAYF.
"""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.illuminator_map import MAX_FINE_STEPS

_CLOCKS = 8
"""For which each level of a control input stands; long enough for any wire."""


class FineDelays(wiring.Component):
    """Loads all lines with 0 and moves each to its target, whenever a target changes.

    This takes 16 clocks for each setting that there is, whatever the targets: 2048 clocks of
    `sync` for 128 settings. It also begins after configuration.

    Parameters
    ----------
    channels : int
        Lines.
    steps : int
        Settings of a line, 0 included.

    Members
    -------
    targets : In
        Wanted settings; one that a line does not have counts as the largest.
    restart : In(1)
        Targets have changed, or lines may have moved on their own.
    load : Out(1)
        Loads the lines with 0.
    move : Out(channels)
        A pulse moves the line of a channel by one step.
    moving : Out(1)
        The lines are not yet at their targets.
    """

    def __init__(self, channels: int, steps: int) -> None:
        self.channels = channels
        self.steps = steps
        super().__init__(
            {
                "targets": In(data.ArrayLayout(range(MAX_FINE_STEPS), channels)),
                "restart": In(1),
                "load": Out(1, init=1),
                "move": Out(channels),
                "moving": Out(1, init=1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        clock = Signal(range(2 * _CLOCKS))
        step = Signal(range(self.steps))
        m.d.sync += self.move.eq(0)
        with m.If(self.restart):
            m.d.sync += [self.load.eq(1), self.moving.eq(1), clock.eq(0), step.eq(0)]
        with m.Elif(self.moving):
            m.d.sync += [
                clock.eq(clock + 1),
                *(
                    self.move[channel].eq(
                        ~self.load & (clock < _CLOCKS) & (step < self.targets[channel])
                    )
                    for channel in range(self.channels)
                ),
            ]
            with m.If(clock == 2 * _CLOCKS - 1):
                m.d.sync += self.load.eq(0)
                with m.If(~self.load):
                    m.d.sync += step.eq(step + 1)
                    with m.If(step == self.steps - 2):
                        m.d.sync += self.moving.eq(0)
        return m
