# SPDX-License-Identifier: Apache-2.0
"""The temperature of an ECP5, from the sensor on its die.

# Ref: Lattice FPGA-TN-02210 (TN1266), Power Consumption and Management for ECP5, table 4.
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Instance, Module, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from hueflight_protocol.wire import TEMPERATURE_UNKNOWN

CODE_BITS = 6
PERIOD_S = 0.01
"""Time from one measurement to the next."""
START_S = 2e-6
"""Length of the pulse that starts one."""
CELSIUS = (
    *(-58, -56, -54, -52, -45, -44, -43, -42, -41, -40, -39, -38, -37, -36, -30, -20),
    *(-10, -4, 0, 4, 10, 21, 22, 23, 24, 25, 26, 27, 28, 29, 40, 50),
    *(60, 70, 76, 80, 82, 82, 83, 84, 85, 86, 87, 88, 89, 95, 96, 97),
    *(98, 99, 100, 101, 102, 103, 104, 105, 106, 107, 108, 116, 120, 124, 128, 132),
)
"""Temperature of each code of the sensor, in degrees Celsius."""


class TemperatureReader(wiring.Component):
    """Starts measurements and converts their codes.

    Until the sensor has said for the first time that a code is valid, and after a measurement in
    which it did not say so, the temperature is unknown.

    Parameters
    ----------
    clock_hz : float
        Frequency of the domain `sync`.

    Members
    -------
    start : Out(1)
        Its rising edge starts a measurement.
    valid : In(1), code : In
        From the sensor, asynchronous; at rest when the next measurement starts.
    mdeg : Out
        Temperature in millidegrees Celsius, or `TEMPERATURE_UNKNOWN`.
    """

    def __init__(self, clock_hz: float) -> None:
        self.period = round(clock_hz * PERIOD_S)
        self.start_clocks = max(1, round(clock_hz * START_S))
        super().__init__(
            {
                "start": Out(1),
                "valid": In(1),
                "code": In(CODE_BITS),
                "mdeg": Out(signed(32), init=TEMPERATURE_UNKNOWN),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        valid, code = Signal(), Signal(CODE_BITS)
        m.submodules.synchronizer = FFSynchronizer(Cat(self.valid, self.code), Cat(valid, code))
        time = Signal(range(self.period))
        last = Signal()
        m.d.comb += last.eq(time == self.period - 1)
        m.d.sync += [
            time.eq(time + 1),
            # from a register, so that the sensor gets no short pulses
            self.start.eq(time < self.start_clocks),
        ]
        with m.If(last):
            m.d.sync += [time.eq(0), self.mdeg.eq(TEMPERATURE_UNKNOWN)]
            with m.If(valid):
                known = Array(Const(1000 * celsius, signed(32)) for celsius in CELSIUS)
                m.d.sync += self.mdeg.eq(known[code])
        return m


def add_temperature(m: Module, clock_hz: float, /) -> Signal:
    """Add the sensor to a board's top module, and return the temperature.

    Parameters
    ----------
    m : Module
        The board's top module.
    clock_hz : float
        Frequency of its domain `sync`.

    Returns
    -------
    Signal
        As `TemperatureReader` has it.
    """
    m.submodules.temperature = reader = TemperatureReader(clock_hz)
    code = {f"o_DTROUT{bit}": reader.code[bit] for bit in range(CODE_BITS)}
    m.submodules.temperature_sensor = Instance(
        "DTR", i_STARTPULSE=reader.start, o_DTROUT7=reader.valid, **code
    )
    return reader.mdeg
