# SPDX-License-Identifier: Apache-2.0
"""A clock-domain crossing that carries settings and commands together and in order."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out


class SettingsCrossing(wiring.Component):
    """Transfers settings repeatedly, with the commands given since the previous transfer.

    All bits of a transfer are sampled in the same clock of the domain `sync`. A command arrives
    with the settings that were valid when it was given, or with later ones. A transfer takes at
    most four clocks of the target domain and five of `sync`.

    Parameters
    ----------
    settings, commands : StructLayout
        Layouts of what is transferred.
    domain : str
        Target clock domain.

    Members
    -------
    settings : In, commands : In
        Inputs in `sync`; a command is high for one clock.
    settings_out : Out, commands_out : Out
        Outputs in the target domain; a command is high for one clock.
    """

    def __init__(
        self, settings: data.StructLayout, commands: data.StructLayout, *, domain: str
    ) -> None:
        self.domain = domain
        super().__init__(
            {
                "settings": In(settings),
                "commands": In(commands),
                "settings_out": Out(settings),
                "commands_out": Out(commands),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        target = m.d[self.domain]
        settings = Signal.like(self.settings)
        commands = Signal.like(self.commands.as_value())
        waiting = Signal.like(self.commands.as_value())
        request = Signal()
        seen = Signal()
        arrived = Signal()
        acknowledge = Signal()
        m.submodules.there = FFSynchronizer(request, seen, o_domain=self.domain)
        m.submodules.back = FFSynchronizer(arrived, acknowledge, o_domain="sync")
        now = self.commands.as_value() | waiting
        m.d.sync += waiting.eq(now)
        with m.If(request == acknowledge):
            m.d.sync += [
                settings.eq(self.settings),
                commands.eq(now),
                waiting.eq(0),
                request.eq(~request),
            ]
        target += [arrived.eq(seen), self.commands_out.as_value().eq(0)]
        with m.If(seen != arrived):
            target += [
                self.settings_out.eq(settings),
                self.commands_out.as_value().eq(commands),
            ]
        return m
