# SPDX-License-Identifier: Apache-2.0
"""The camera on ECP5 boards: clocks and the pins that connect it to the illuminator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from amaranth.build import Platform
from amaranth.hdl import ClockDomain, ClockSignal, Elaboratable, Instance, Module, Signal
from amaranth.lib.cdc import FFSynchronizer

from ..camera.camera import Camera, CameraConfig
from ..camera.frame_format import FrameFormat
from ..camera.sensor.scene import default_scene
from ..common.version import source_hash
from .ecp5_clocks import AIM
from .ecp5_pll import PllOutput, ecp5_pll
from .pins import drive_pin, read_pin
from .sensor_lanes import FABRIC_CLOCK, SENSOR_HZ, check_lanes
from .settings import camera_settings, set_camera
from .target import Options, Target, TargetError

SYNC_HZ = 100e6
_VCO_HZ = 600e6
LANES = 8
FAST_ROUTES = {
    # A bank is never read while it is written, which is formally verified (see
    # `camera.formatter.chunk_buffer`), so yosys need not emulate the result of such a collision.
    "script_after_read": "setparam -set COLLISION_X_MASK 1'1 *.store/t:$memrd_v2",
    # no resets made of choices: those are the slowest wires
    "synth_opts": "-run begin:map_ffs",
    "script_after_synth": "dffunmap -srst-only; synth_ecp5 -run map_ffs: -top top",
}


def camera_config(options: Options | None = None) -> CameraConfig:
    """Return the configuration for a board without a sensor: the paper's geometry and a scene.

    Raises
    ------
    TargetError
        If `options` has the number of lanes twice.
    """
    options = options or Options()
    settings = dict(options.settings)
    if options.lanes is not None:
        if settings.get("lanes", options.lanes) != options.lanes:
            raise TargetError(f"--lanes {options.lanes}: the settings say {settings['lanes']}")
        settings["lanes"] = options.lanes
    form = FrameFormat(lanes=LANES, clock_hz=round(SYNC_HZ))
    config = set_camera(CameraConfig(form=form, source=source_hash()), settings)
    return replace(config, scene=default_scene(config.form))


class CameraClocks(Elaboratable):
    """Domain `sync` (100 MHz) from 25 MHz, or as it comes from an oscillator of 100 MHz.

    It has no reset, which would cost an input of most logic cells and a net with thousands of
    sinks. Instead its clock is stopped until the PLL has locked, so that every register leaves
    its configured value on the same clean edge.

    # Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL.
    """

    def __init__(self, clock: Signal, clock_hz: float) -> None:
        self.clock = clock
        self.clock_hz = clock_hz

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them."""
        m.domains.sync = sync = ClockDomain(reset_less=True)
        platform.add_clock_constraint(sync.clk, SYNC_HZ * AIM)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        m.domains.free = ClockDomain(local=True, reset_less=True)
        ready = Signal()
        if self.clock_hz == SYNC_HZ:
            m.d.comb += [ClockSignal("free").eq(self.clock), ready.eq(1)]
        else:
            m.submodules.pll = ecp5_pll(
                PllOutput(self.clock, self.clock_hz),
                PllOutput(ClockSignal("free"), SYNC_HZ),
                vco_hz=_VCO_HZ,
                locked=ready,
            )
        running = Signal()
        m.submodules.running = FFSynchronizer(ready, running, o_domain="free", stages=3)
        m.submodules.sync = Instance(
            "DCCA", i_CLKI=ClockSignal("free"), i_CE=running, o_CLKO=ClockSignal()
        )
        return m


def add_camera(m: Module, config: CameraConfig, platform: Platform) -> Camera:
    """Add a camera and connect the pins that all boards share; its link is left to the caller."""
    m.submodules.camera = camera = Camera(config)
    drive_pin(m, platform, "trigger", camera.trigger)
    drive_pin(m, platform, "frame_sync", camera.frame_sync)
    m.d.comb += [
        camera.marker.eq(read_pin(m, platform, "marker")),
        camera.missed.eq(read_pin(m, platform, "missed")),
    ]
    return camera


def camera_target(
    board: str,
    platform: Callable[[], Platform],
    top: Callable[[CameraConfig], Elaboratable],
    options: Options,
    /,
    *,
    link_mhz: dict[str, float],
    sensor_lanes: int = 0,
) -> Target:
    """Return the camera on an ECP5 board.

    Parameters
    ----------
    board : str
    platform : callable
    top : callable
        From the configuration.
    options : Options
        Choices of the user.
    link_mhz : dict of str to float
        The clocks of its link, and what they run at.
    sensor_lanes : int
        Data lanes that the board has pins for, see `sensor_lanes`.
    """
    config = camera_config(options)
    check_lanes(board, config, sensor_lanes)
    sensor_mhz = {"sensor": SENSOR_HZ / 1e6} if config.sensor else {}
    return Target(
        design="camera",
        board=board,
        platform=platform,
        top=lambda: top(config),
        clocks_mhz={"sync": SYNC_HZ / 1e6, **link_mhz, **sensor_mhz},
        lanes=config.form.lanes,
        settings=camera_settings(config),
        registers=config.registers(),
        family="ecp5",
        options={**FAST_ROUTES, **(FABRIC_CLOCK if config.sensor else {})},
    )
