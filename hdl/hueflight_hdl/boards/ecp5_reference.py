# SPDX-License-Identifier: Apache-2.0
"""An external clock for boards with an ECP5, instead of their oscillator.

# Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL; FPGA-DS-02012, ECP5 and ECP5-5G
# family data sheet (the PLL's phase detector runs from 10 MHz, its oscillator from 400 to 800 MHz).
"""

from __future__ import annotations

import math

from amaranth.build import Platform
from amaranth.hdl import (
    ClockDomain,
    ClockSignal,
    DomainRenamer,
    Elaboratable,
    Instance,
    Module,
    Mux,
    Signal,
    Value,
)
from amaranth.lib.cdc import FFSynchronizer

from ..control.clock_choice import REFERENCE_STATE
from .ecp5_pll import PllOutput, ecp5_pll
from .pins import drive_pin, read_pin
from .reference_clock import LOCK_S, SETTLE_S, ReferenceSupervisor, divider_bits
from .settings import MAX_REFERENCE_HZ
from .target import TargetError

MIN_REFERENCE_HZ = 10_000_000
_VCO_HZ = (400e6, 800e6)


def conversion(clock_hz: int, reference_hz: int, /) -> tuple[int, int]:
    """Return how a PLL makes the oscillator's frequency from that of the external clock.

    Parameters
    ----------
    clock_hz, reference_hz : int
        Frequencies of the oscillator and of the external clock.

    Returns
    -------
    tuple of int
        Frequencies of the PLL's feedback, a multiple of both, and of its oscillator, a multiple of
        that.

    Raises
    ------
    TargetError
        If the PLL cannot make it.
    """
    feedback = math.lcm(clock_hz, reference_hz)
    multiples = range(1, math.floor(_VCO_HZ[1] / feedback) + 1)
    found = [feedback * multiple for multiple in multiples if feedback * multiple >= _VCO_HZ[0]]
    if not MIN_REFERENCE_HZ <= reference_hz <= MAX_REFERENCE_HZ or not found:
        raise TargetError(
            f"reference_hz = {reference_hz}: must be from {MIN_REFERENCE_HZ} to "
            f"{MAX_REFERENCE_HZ} and have a common multiple of at most {_VCO_HZ[1]:g} Hz with the "
            f"board's {clock_hz} Hz, for example 10000000 or {clock_hz}"
        )
    return feedback, found[0]


class Ecp5Reference(Elaboratable):
    """Chooses between oscillator and external clock, see `ReferenceSupervisor`.

    An external clock of another frequency than the oscillator's goes through a PLL of its own. The
    choice itself is plain logic: the PLL behind it is in reset when it changes.

    Parameters
    ----------
    clock : Value
        From the oscillator.
    clock_hz : int
        Its frequency.
    external : Value
        The external clock.
    external_hz : int
        Its frequency.
    place : str, optional
        Where the PLL behind the choice must be, see `pll_place`, if it drives an edge clock.

    Attributes
    ----------
    wanted : Signal
        The host wants the external clock; asynchronous.
    locked : Signal
        The PLL behind has locked; asynchronous.
    chosen : Signal
        Clock for the PLL.
    hold : Signal
        The PLL must be in reset, and no clock may run.
    state : Signal
        See `REFERENCE_STATE`; asynchronous.

    Raises
    ------
    TargetError
        If the frequencies do not fit.
    """

    def __init__(
        self,
        clock: Value,
        clock_hz: int,
        external: Value,
        external_hz: int,
        *,
        place: str | None = None,
    ) -> None:
        self.clock = clock
        self.clock_hz = clock_hz
        self.external = external
        self.external_hz = external_hz
        self.place = place
        self.feedback_hz, self.vco_hz = conversion(clock_hz, external_hz)
        self.wanted = Signal()
        self.locked = Signal()
        self.chosen = Signal()
        self.hold = Signal()
        self.state = Signal(REFERENCE_STATE)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        for name, clock in (("watch", self.clock), ("external", self.external)):
            domain = ClockDomain(name, reset_less=True, local=True)
            m.domains += domain
            m.d.comb += domain.clk.eq(clock)
        count = Signal(divider_bits(self.clock_hz, self.external_hz))
        m.d.external += count.eq(count + 1)
        supervisor = ReferenceSupervisor(
            interval=self.clock_hz / self.external_hz * (1 << (len(count) - 1)),
            settle=math.ceil(SETTLE_S * self.clock_hz),
            patience=math.ceil(LOCK_S * self.clock_hz),
        )
        m.submodules.supervisor = DomainRenamer("watch")(supervisor)
        m.submodules.divided = FFSynchronizer(count[-1], supervisor.divided, o_domain="watch")
        m.submodules.wanted = FFSynchronizer(self.wanted, supervisor.wanted, o_domain="watch")
        m.submodules.locked = FFSynchronizer(self.locked, supervisor.locked, o_domain="watch")
        m.d.comb += [
            self.hold.eq(supervisor.hold),
            self.state.external.eq(supervisor.select),
            self.state.present.eq(supervisor.present),
            self.state.lost.eq(supervisor.lost),
            self.chosen.eq(Mux(supervisor.select, self._converted(m), self.clock)),
        ]
        return m

    def _converted(self, m: Module) -> Value:
        """Return the external clock at the oscillator's frequency."""
        if self.external_hz == self.clock_hz:
            return self.external
        feedback, made = Signal(), Signal()
        m.submodules.pll = ecp5_pll(
            PllOutput(self.external, self.external_hz),
            PllOutput(feedback, self.feedback_hz),
            PllOutput(made, self.clock_hz),
            vco_hz=self.vco_hz,
            locked=Signal(),
        )
        return made


def reference_from_pins(
    m: Module, platform: Platform, clock: Value, external_hz: int, /, *, place: str | None = None
) -> Ecp5Reference:
    """Return the choice of a board's clock, and send the chosen one out where there is a pin.

    Parameters
    ----------
    m : Module
        The board's top module; the choice becomes a submodule of its clocks.
    platform : Platform
        Has the resource ``reference``, and perhaps ``clock_out``.
    clock : Value
        From the oscillator.
    external_hz : int
        Frequency of the external clock.
    place : str, optional
        See `Ecp5Reference`.
    """
    external = read_pin(m, platform, "reference")
    clock_hz = round(platform.default_clk_frequency)
    reference = Ecp5Reference(clock, clock_hz, external, external_hz, place=place)
    if ("clock_out", 0) in platform.resources:
        pin = Signal()
        clock_output(m, reference.chosen, pin)
        drive_pin(m, platform, "clock_out", pin)
    return reference


def clock_output(m: Module, clock: Value, pin: Signal, /) -> None:
    """Send a clock to a pin through its I/O register, as the vendor asks for."""
    domain = ClockDomain("clock_out", reset_less=True, local=True)
    m.domains += domain
    m.d.comb += domain.clk.eq(clock)
    m.submodules.clock_out = Instance(
        "ODDRX1F", i_D0=1, i_D1=0, i_SCLK=ClockSignal("clock_out"), i_RST=0, o_Q=pin
    )
