# SPDX-License-Identifier: Apache-2.0
"""The illuminator on any iCE40 board: two ticks per clock.

# Ref: Lattice FPGA-TN-02052, iCE40 sysCLOCK PLL.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from amaranth.build import Platform
from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module, Signal
from amaranth.lib import io
from amaranth.lib.cdc import ResetSynchronizer

from ..common.version import source_hash
from ..illuminator.gearing.portable import DoubleDataRateGearing
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import Limits, PulseConfig
from .illuminator_pins import add_from_platform
from .illuminator_target import target_of
from .pins import drive_pin
from .settings import choose_illuminator
from .target import Options, Target, TargetError

_AIM = 1.15
_ON_NS = 100.0
"""Longest on-time by default, as on the other boards."""
_VCO_HZ = (533e6, 1066e6)
_FILTERS_HZ = (17e6, 26e6, 44e6, 66e6, 101e6)
"""Bounds of the phase detector's frequency for the settings of the PLL's filter."""
_NO_ENABLES = {"synth_opts": "-nodffe"}
"""Eight logic cells share an enable; hundreds of small groups of registers would not fit."""


@dataclass(frozen=True)
class Ice40Pll:
    """Settings of the PLL with simple feedback.

    Parameters
    ----------
    clock_hz : float
        Frequency of the oscillator, 10 to 133 MHz.
    multiplier : int
        Of the oscillator, 1 to 128 (``DIVF`` + 1).
    halvings : int
        Of the result, 1 to 6 (``DIVQ``).
    """

    clock_hz: float
    multiplier: int
    halvings: int

    @property
    def hz(self) -> float:
        """Frequency that the PLL makes."""
        return self.clock_hz * self.multiplier / (1 << self.halvings)

    @property
    def filter_range(self) -> int:
        """Setting of the loop's filter."""
        return 1 + sum(self.clock_hz >= bound for bound in _FILTERS_HZ)


def find_pll(clock_hz: float, wanted_hz: float, /) -> Ice40Pll:
    """Return the settings that come nearest to a frequency.

    Parameters
    ----------
    clock_hz : float
        Frequency of the oscillator.
    wanted_hz : float
        Frequency of the domain `pulse`.

    Returns
    -------
    Ice40Pll
        Settings with which the PLL's oscillator is in its range.

    Raises
    ------
    TargetError
        If the PLL cannot make a frequency within 5% of that.
    """
    if not 10e6 <= clock_hz <= 133e6:
        raise TargetError(f"clock of {clock_hz:g} Hz: the PLL takes 10 to 133 MHz")
    candidates = [
        Ice40Pll(clock_hz, multiplier, halvings)
        for halvings in range(1, 7)
        for multiplier in range(1, 129)
        if _VCO_HZ[0] <= clock_hz * multiplier <= _VCO_HZ[1]
    ]
    best = min(candidates, key=lambda pll: abs(pll.hz - wanted_hz), default=None)
    if best is None or abs(best.hz / wanted_hz - 1) > 0.05:
        raise TargetError(
            f"pulse_hz = {wanted_hz:g}: the PLL makes {_VCO_HZ[0] / 64e6:.1f} to "
            f"{_VCO_HZ[1] / 2e6:.0f} MHz from {clock_hz / 1e6:g} MHz"
        )
    return best


class Ice40Clocks(Elaboratable):
    """Domains `pulse` and `sync` (half of it), in reset until the PLL has locked.

    Parameters
    ----------
    clock : Signal
        From the oscillator.
    pll : Ice40Pll
        Settings of the PLL.
    """

    def __init__(self, clock: Signal, pll: Ice40Pll) -> None:
        self.clock = clock
        self.pll = pll

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them."""
        for name, frequency in (("pulse", self.pll.hz), ("sync", self.pll.hz / 2)):
            domain = ClockDomain(name)
            m.domains += domain
            platform.add_clock_constraint(domain.clk, frequency * _AIM)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        locked = Signal()
        for name in ("pulse", "sync"):
            m.submodules[f"{name}_reset"] = ResetSynchronizer(~locked, domain=name)
        m.submodules.pll = Instance(
            "SB_PLL40_2F_CORE",
            p_FEEDBACK_PATH="SIMPLE",
            p_DIVR=Const(0, 4),
            p_DIVF=Const(self.pll.multiplier - 1, 7),
            p_DIVQ=Const(self.pll.halvings, 3),
            p_FILTER_RANGE=Const(self.pll.filter_range, 3),
            p_PLLOUT_SELECT_PORTA="GENCLK",
            p_PLLOUT_SELECT_PORTB="GENCLK_HALF",
            i_REFERENCECLK=self.clock,
            i_RESETB=Const(1),
            i_BYPASS=Const(0),
            o_PLLOUTGLOBALA=ClockSignal("pulse"),
            o_PLLOUTGLOBALB=ClockSignal("sync"),
            o_LOCK=locked,
        )
        return m


def ice40_config(pulse_hz: float) -> IlluminatorConfig:
    """Return the configuration: two pulses per channel, and limits of 100 ns.

    The sequencer's memory is block memory whatever its size: as registers, a program of four steps
    would take a fifth of an UP5K.
    """
    ticks = round(_ON_NS * 1e-9 * 2 * pulse_hz)
    pulse = PulseConfig(
        pulses=2, lanes=2, limits=Limits(max_on_ticks=ticks, duty_divisor=8, burst_ticks=ticks)
    )
    return IlluminatorConfig(
        pulse=pulse,
        pulse_hz=pulse_hz,
        clock_ratio=2,
        source=source_hash(),
        clock_supervision=False,
        memory_style="block",
    )


class Ice40Illuminator(Elaboratable):
    """Top-level module of the illuminator on an iCE40 board.

    Parameters
    ----------
    config : IlluminatorConfig
        What is built.
    pll : Ice40Pll
        Settings of the PLL.
    armed : str
        Resource of the indicator LED that is lit while the board is armed.
    """

    def __init__(self, config: IlluminatorConfig, pll: Ice40Pll, /, *, armed: str) -> None:
        self.config = config
        self.pll = pll
        self.armed = armed

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        Ice40Clocks(clock.i, self.pll).add_to(m, platform)
        illuminator = add_from_platform(m, self.config, DoubleDataRateGearing(), platform)
        drive_pin(m, platform, self.armed, illuminator.armed)
        return m


def illuminator_target(
    board: str,
    platform: Callable[[], Platform],
    options: Options,
    /,
    *,
    armed: str,
    leds: int,
    pulse_hz: float,
) -> Target:
    """Return the illuminator on an iCE40 board.

    Parameters
    ----------
    board : str
        Name of the board.
    platform : callable
        Returns the platform with all pins.
    options : Options
        Choices of the user.
    armed : str
        Resource of the indicator LED.
    leds : int
        Pins that the board has for LEDs.
    pulse_hz : float
        Frequency of the domain `pulse`; a tick is half of its clock. The nearest frequency that
        the PLL can make is taken.

    Returns
    -------
    Target
        What can be built.
    """
    pll = find_pll(platform().default_clk_frequency, pulse_hz)
    config = choose_illuminator(ice40_config(pll.hz), options, board=board, leds=leds)
    return target_of(
        config,
        lambda: Ice40Illuminator(config, pll, armed=armed),
        board=board,
        platform=platform,
        family="ice40",
        options=_NO_ENABLES,
    )
