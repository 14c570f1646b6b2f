"""The camera on ECP5 boards: clocks, pins of the illuminator, and what every link leaves."""

from __future__ import annotations

from amaranth.build import Platform
from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module, Signal
from amaranth.lib.cdc import ResetSynchronizer

from ..designs.camera import Camera, CameraConfig
from ..frame.format import FrameFormat
from ..sensor.scene import default_scene
from ..source import source_hash
from .ecp5_clocks import AIM
from .pins import drive_pin, read_pin

SYNC_HZ = 100e6
_VCO_HZ = 600e6
LANES = 8
FAST_ROUTES = {
    # A bank is never read while it is written, as a proof shows (see `frame.store`): yosys need
    # not emulate what that would give.
    "script_after_read": "setparam -set COLLISION_X_MASK 1'1 *.store/t:$memrd_v2",
    # no resets made of choices: those are the slowest wires
    "synth_opts": "-run begin:map_ffs",
    "script_after_synth": "dffunmap -srst-only; synth_ecp5 -run map_ffs: -top top",
}


def camera_config(lanes: int | None = None) -> CameraConfig:
    """Return the configuration of a board without a sensor: the paper's geometry, and a scene."""
    form = FrameFormat(lanes=LANES if lanes is None else lanes, clock_hz=round(SYNC_HZ))
    return CameraConfig(form=form, scene=default_scene(form), source=source_hash())


class CameraClocks(Elaboratable):
    """Domain `sync` (100 MHz) from 25 MHz, or as it comes from an oscillator of 100 MHz.

    # Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL.
    """

    def __init__(self, clock: Signal, clock_hz: float) -> None:
        self.clock = clock
        self.clock_hz = clock_hz

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the domains to a module, and with them what makes them."""
        m.domains.sync = sync = ClockDomain()
        platform.add_clock_constraint(sync.clk, SYNC_HZ * AIM)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        ready = Signal()
        if self.clock_hz == SYNC_HZ:
            m.d.comb += [ClockSignal().eq(self.clock), ready.eq(1)]
        else:
            m.submodules.pll = Instance(
                "EHXPLLL",
                a_FREQUENCY_PIN_CLKI=f"{self.clock_hz / 1e6:g}",
                a_FREQUENCY_PIN_CLKOP=f"{SYNC_HZ / 1e6:g}",
                a_ICP_CURRENT="12",
                a_LPF_RESISTOR="8",
                p_PLLRST_ENA="DISABLED",
                p_INTFB_WAKE="DISABLED",
                p_STDBY_ENABLE="DISABLED",
                p_DPHASE_SOURCE="DISABLED",
                p_OUTDIVIDER_MUXA="DIVA",
                p_OUTDIVIDER_MUXB="DIVB",
                p_OUTDIVIDER_MUXC="DIVC",
                p_OUTDIVIDER_MUXD="DIVD",
                p_CLKI_DIV=1,
                p_CLKFB_DIV=round(SYNC_HZ / self.clock_hz),
                p_FEEDBK_PATH="CLKOP",
                p_CLKOP_ENABLE="ENABLED",
                p_CLKOP_DIV=round(_VCO_HZ / SYNC_HZ),
                p_CLKOP_CPHASE=0,
                p_CLKOP_FPHASE=0,
                i_RST=Const(0),
                i_STDBY=Const(0),
                i_CLKI=self.clock,
                i_CLKFB=ClockSignal(),
                i_PHASESEL0=Const(0),
                i_PHASESEL1=Const(0),
                i_PHASEDIR=Const(1),
                i_PHASESTEP=Const(1),
                i_PHASELOADREG=Const(1),
                i_PLLWAKESYNC=Const(0),
                i_ENCLKOP=Const(0),
                o_CLKOP=ClockSignal(),
                o_LOCK=ready,
            )
        m.submodules.reset = ResetSynchronizer(~ready, domain="sync")
        return m


def add_camera(m: Module, config: CameraConfig, platform: Platform) -> Camera:
    """Add a camera on the pins that every board names alike; its link is left to connect."""
    m.submodules.camera = camera = Camera(config)
    drive_pin(m, platform, "trigger", camera.trigger)
    drive_pin(m, platform, "frame_sync", camera.frame_sync)
    m.d.comb += [
        camera.marker.eq(read_pin(m, platform, "marker")),
        camera.missed.eq(read_pin(m, platform, "missed")),
    ]
    return camera
