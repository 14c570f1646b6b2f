# SPDX-License-Identifier: Apache-2.0
"""A harness for the verification of one component with free inputs."""

from __future__ import annotations

from amaranth.hdl import DomainRenamer, Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In


class FreeHarness(wiring.Component):
    """Gives a component free inputs; everything is in one clock domain.

    Parameters
    ----------
    component : wiring.Component
        Its inputs become those of the harness.
    """

    def __init__(self, component: wiring.Component) -> None:
        self.component = component
        members = component.signature.members
        super().__init__(
            {name: In(member.shape) for name, member in members.items() if member.flow is In}
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.component = DomainRenamer({"pulse": "sync"})(self.component)
        for name in self.signature.members:
            m.d.comb += getattr(self.component, name).eq(getattr(self, name))
        self.state(m)
        return m

    def state(self, m: Module) -> None:
        """Add assertions."""
