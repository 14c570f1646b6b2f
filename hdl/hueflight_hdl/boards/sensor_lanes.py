# SPDX-License-Identifier: Apache-2.0
"""Pins of a sensor with serial lanes, in front of `camera.sensor.ddr`.

The resources of a board are ``sensor_clock``, ``sensor_data`` (a pin for each lane of the sensor
port), ``sensor_control``, ``sensor_expose`` and ``sensor_read``.

# Ref: Lattice FPGA-TN-02035, ECP5 and ECP5-5G High-Speed I/O Interface: GDDRX2_RX.ECLK.Centered;
# Xilinx UG381, Spartan-6 FPGA SelectIO Resources: IDDR2.
"""

from __future__ import annotations

from typing import Protocol

from amaranth.build import Platform
from amaranth.hdl import ClockDomain, ClockSignal, Const, Instance, Module, Signal, Value
from amaranth.lib import io
from amaranth.lib.wiring import connect

from ..camera.camera import Camera, CameraConfig
from ..camera.sensor.ddr.link_format import WORD_BITS, LinkFormat
from ..camera.sensor.ddr.receiver import DdrReceiver
from .ecp5_clocks import AIM, IoStart
from .pins import drive_pin, input_of
from .target import TargetError

SENSOR_HZ = 100e6
"""Highest frequency of the domain `sensor`."""
SETUP_NS, HOLD_NS = 0.32, 0.32
"""What GDDRX2_RX.ECLK.Centered needs at 400 MHz, from the vendor's technical note."""


FABRIC_CLOCK = {"nextpnr_opts": "--allow-fabric-eclk"}
"""For boards on which no free pin reaches an edge clock by dedicated wires."""


class LaneInputs(Protocol):
    """Input registers of a family for lanes at double data rate.

    Attributes
    ----------
    gear : int
        Bits of a lane in each clock of the domain `sensor`.
    """

    gear: int

    def add_clock(self, m: Module, platform: Platform, pin: Value, /) -> None:
        """Add the domain `sensor`, from the sensor's clock."""
        ...

    def add_lane(self, m: Module, name: str, port: object, /) -> Value:
        """Add the registers of a lane and return its bits, the earliest lowest."""
        ...


class Ecp5LaneInputs:
    """IDDRX2F behind a fixed delay: four bits a clock; the clock comes centered on the bits.

    The delay is the one with which the vendor states setup and hold for clocks that reach the
    registers by the edge clock (`ECLK_CENTERED`).

    Parameters
    ----------
    oscillator : Value
        A clock that always runs: it starts divider and registers in the vendor's order.
    """

    gear = 4

    def __init__(self, oscillator: Value) -> None:
        self.oscillator = oscillator

    def add_clock(self, m: Module, platform: Platform, pin: Value, /) -> None:
        """Add the domains `sensor_edge` and `sensor` (half of it), from the sensor's clock."""
        for name in ("sensor_edge", "sensor"):
            domain = ClockDomain(name, reset_less=True)
            m.domains += domain
            if name == "sensor":  # nothing of the fabric runs on the other
                platform.add_clock_constraint(domain.clk, SENSOR_HZ * AIM)
        m.submodules.sensor_start = start = IoStart(self.oscillator, Const(1))
        self._reset = start.reset
        m.submodules.sensor_edge = Instance(
            "ECLKSYNCB", i_ECLKI=pin, i_STOP=start.stop, o_ECLKO=ClockSignal("sensor_edge")
        )
        m.submodules.sensor_clock = Instance(
            "CLKDIVF",
            p_DIV="2.0",
            i_CLKI=ClockSignal("sensor_edge"),
            i_RST=start.reset,
            i_ALIGNWD=Const(0),
            o_CDIVX=ClockSignal("sensor"),
        )

    def add_lane(self, m: Module, name: str, port: object, /) -> Value:
        """Add the registers of a lane and return its bits."""
        pin = input_of(m, name, port)
        late, bits = Signal(name=f"{name}_late"), Signal(4, name=f"{name}_bits")
        m.submodules[f"{name}_delay"] = Instance(
            "DELAYG", p_DEL_MODE="ECLK_CENTERED", i_A=pin, o_Z=late
        )
        m.submodules[f"{name}_iddr"] = Instance(
            "IDDRX2F",
            i_D=late,
            i_ECLK=ClockSignal("sensor_edge"),
            i_SCLK=ClockSignal("sensor"),
            i_RST=self._reset,
            **{f"o_Q{bit}": bits[bit] for bit in range(4)},
        )
        return bits


class PortableLaneInputs:
    """Amaranth's input buffer at double data rate: two bits a clock, on any family.

    The domain `sensor` is the sensor's clock itself.
    """

    gear = 2

    def add_clock(self, m: Module, platform: Platform, pin: Value, /) -> None:
        """Add the domain `sensor`, the sensor's clock."""
        m.domains.sensor = domain = ClockDomain("sensor", reset_less=True)
        m.d.comb += ClockSignal("sensor").eq(pin)
        platform.add_clock_constraint(domain.clk, SENSOR_HZ)

    def add_lane(self, m: Module, name: str, port: object, /) -> Value:
        """Add the registers of a lane and return its bits."""
        m.submodules[f"{name}_ddr"] = buffer = io.DDRBuffer("i", port, i_domain="sensor")
        bits = Signal(2, name=f"{name}_bits")
        m.d.sensor += bits.eq(buffer.i[0] | buffer.i[1] << 1)
        return bits


def link_format(config: CameraConfig, inputs: LaneInputs, /) -> LinkFormat:
    """Return the link of a camera: the shortest words that its codes fit in."""
    bits = next(bits for bits in WORD_BITS if bits > config.form.code_bits)
    return LinkFormat(form=config.form, word_bits=bits, gear=inputs.gear)


def add_sensor(m: Module, camera: Camera, platform: Platform, inputs: LaneInputs, /) -> None:
    """Connect a camera to the sensor's pins.

    Parameters
    ----------
    m : Module
        The board's top module.
    camera : Camera
        Its sensor port is connected.
    platform : Platform
        Has the resources of the sensor.
    inputs : LaneInputs
        Input registers of the family.
    """
    pin = input_of(m, "sensor_clock", platform.request("sensor_clock", 0, dir="-"))
    inputs.add_clock(m, platform, pin)
    link = link_format(camera.config, inputs)
    m.submodules.receiver = receiver = DdrReceiver(link)
    data = platform.request("sensor_data", 0, dir="-")
    for lane in range(link.form.lanes):
        bits = inputs.add_lane(m, f"sensor_data{lane}", data[lane])
        m.d.comb += receiver.samples[lane].eq(bits)
    control = platform.request("sensor_control", 0, dir="-")
    bits = inputs.add_lane(m, "sensor_control", control)
    m.d.comb += receiver.samples[link.form.lanes].eq(bits)
    drive_pin(m, platform, "sensor_expose", receiver.expose_pin)
    drive_pin(m, platform, "sensor_read", receiver.read_pin)
    connect(m, camera.sensor, receiver.port)


def check_lanes(board: str, config: CameraConfig, most: int, /) -> None:
    """Refuse a sensor that has more lanes than the board has pins for.

    Parameters
    ----------
    board : str
        Name of the board.
    config : CameraConfig
        What is built.
    most : int
        Data lanes that the board has pins for; 0 if it has none for a sensor.

    Raises
    ------
    TargetError
        If there are not enough.
    """
    if config.sensor and config.form.lanes > most:
        raise TargetError(
            f"sensor = 1 with lanes = {config.form.lanes}: {board} has pins for "
            + (f"{most} data lanes of a sensor" if most else "no sensor; leave it out")
        )
