# SPDX-License-Identifier: Apache-2.0
"""Illuminators between simulated pins, for compiled simulation.

A pin behind the gearing is a word of ticks in each clock.
"""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ..boards.illuminator_pins import GearedPorts, add_illuminator
from ..illuminator.gearing.interface import Gearing
from ..illuminator.gearing.simulated import SimulatedGearing
from ..illuminator.illuminator import IlluminatorConfig


class SimulatedPins(wiring.Component):
    """Base of illuminators with simulated gearing.

    Parameters
    ----------
    config : IlluminatorConfig
        What is built.
    gearing : Gearing
        Gearing of the board; its simulation model is used.
    members : dict of str to wiring.Member
        Members besides `trigger`, `levels`, `missed` and `armed`.
    """

    def __init__(
        self, config: IlluminatorConfig, gearing: Gearing, members: dict[str, wiring.Member]
    ) -> None:
        self.config = config
        self.gearing = SimulatedGearing(gearing)
        lanes, channels = config.pulse.lanes, config.pulse.channels
        super().__init__(
            {
                "trigger": In(lanes),
                "levels": Out(data.ArrayLayout(lanes, channels)),
                "missed": Out(1),
                "armed": Out(1),
                **members,
            }
        )


class SimulatedIlluminator(SimulatedPins):
    """The illuminator with its serial line between simulated pins."""

    def __init__(self, config: IlluminatorConfig, gearing: Gearing) -> None:
        members = {
            "rx": In(1),
            "tx": Out(1, init=1),
            "frame_sync": In(1),
            "clock_failed": In(1),
            "trigger_out": Out(config.pulse.lanes),
            "marker": Out(8),
        }
        super().__init__(config, gearing, members)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        levels = [Signal(self.config.pulse.lanes) for _ in range(self.config.pulse.channels)]
        ports = GearedPorts(self.trigger, tuple(levels), self.trigger_out)
        illuminator = add_illuminator(m, self.config, self.gearing, ports, self.clock_failed)
        m.d.comb += [
            illuminator.rx.eq(self.rx),
            illuminator.frame_sync.eq(self.frame_sync),
            self.tx.eq(illuminator.tx),
            *(self.levels[channel].eq(level) for channel, level in enumerate(levels)),
            self.marker.eq(illuminator.marker),
            self.missed.eq(illuminator.missed),
            self.armed.eq(illuminator.armed),
        ]
        return m
