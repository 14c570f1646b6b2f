# SPDX-License-Identifier: Apache-2.0
"""The camera on ECP5 boards: clocks and the pins that connect it to the illuminator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from amaranth.build import Platform
from amaranth.hdl import (
    ClockDomain,
    ClockSignal,
    Elaboratable,
    Instance,
    Module,
    ResetSignal,
    Signal,
    Value,
)
from amaranth.lib.cdc import AsyncFFSynchronizer, FFSynchronizer

from ..camera.camera import Camera, CameraConfig
from ..camera.frame_format import FrameFormat
from ..camera.sensor.scene import default_scene
from ..common.version import source_hash
from .ecp5_clocks import AIM, RECOVERY_CLOCKS
from .ecp5_pll import PllOutput, ecp5_pll
from .ecp5_reference import Ecp5Reference, conversion, reference_from_pins
from .ecp5_temperature import add_temperature
from .pins import drive_pin, read_pin
from .sensor_lanes import FABRIC_CLOCK, SENSOR_HZ, check_lanes
from .settings import camera_settings, refuse_reference, set_camera
from .target import Options, Target, TargetError

SYNC_HZ = 100e6
STOP_CLOCKS = 16
"""Clocks of the oscillator in which the clock `sync` is stopped before its PLL is reset."""
_VCO_HZ = 600e6
LANES = 8
FAST_ROUTES = {
    # no resets made of choices: those are the slowest wires
    "synth_opts": "-run begin:map_ffs",
    "script_after_synth": "dffunmap -srst-only; synth_ecp5 -run map_ffs: -top top",
}


def no_collisions(config: CameraConfig, /) -> str:
    """Return what tells yosys that it need not emulate memories read while they are written.

    A bank is never read while it is written, which is formally verified (see
    `camera.formatter.chunk_buffer`); so is that sums which are read while they are written begin
    anew. Tables and offsets are not written while frames come.

    Parameters
    ----------
    config : CameraConfig
        What is built.

    Returns
    -------
    str
        A command of yosys, for the netlist as it was read.
    """
    modules = ["*.formatter.store"]
    if config.reduction is not None:
        modules += ["*.reducer.core", "*.reducer.core.slice*"]
    return " ".join(["setparam -set COLLISION_X_MASK 1'1", *(f"{m}/t:$memrd_v2" for m in modules)])


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

    With an external clock there is a PLL in any case. When the clock is exchanged, `sync` is
    stopped first, without a short pulse, and the PLL is reset `STOP_CLOCKS` later. So registers
    keep their values, and go on from them when the PLL has locked again.

    # Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL.

    Parameters
    ----------
    clock : Signal
        From the oscillator.
    clock_hz : float
        Its frequency.
    reference : Ecp5Reference, optional
        An external clock that the host may choose instead.

    Attributes
    ----------
    failed : Signal
        With an external clock: high while the PLL has not locked and for `RECOVERY_CLOCKS` after.
        It rises without a clock and falls with one of `sync`.
    """

    def __init__(
        self, clock: Signal, clock_hz: float, *, reference: Ecp5Reference | None = None
    ) -> None:
        self.clock = clock
        self.clock_hz = clock_hz
        self.reference = reference
        self.failed = Signal(init=1)

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them."""
        m.domains.sync = sync = ClockDomain(reset_less=True)
        platform.add_clock_constraint(sync.clk, SYNC_HZ * AIM)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        chosen = self.reference is not None
        m.domains.free = ClockDomain(local=True, reset_less=not chosen, async_reset=chosen)
        ready = Signal()
        if self.reference is not None:
            good = self._choose(m, self.reference, ready)
        elif self.clock_hz == SYNC_HZ:
            good = ready
            m.d.comb += [ClockSignal("free").eq(self.clock), ready.eq(1)]
        else:
            good = ready
            m.submodules.pll = ecp5_pll(
                PllOutput(self.clock, self.clock_hz),
                PllOutput(ClockSignal("free"), SYNC_HZ),
                vco_hz=_VCO_HZ,
                locked=ready,
            )
        running = Signal()
        m.submodules.running = FFSynchronizer(
            good, running, o_domain="free", stages=3, reset_less=not chosen
        )
        m.submodules.sync = Instance(
            "DCCA", i_CLKI=ClockSignal("free"), i_CE=running, o_CLKO=ClockSignal()
        )
        return m

    def _choose(self, m: Module, reference: Ecp5Reference, ready: Signal) -> Value:
        """Make the clock from the chosen one; return whether `sync` may run."""
        m.submodules.reference = reference
        m.domains.stop = stop = ClockDomain(local=True, reset_less=True)
        held = Signal(range(STOP_CLOCKS + 1))
        reset = Signal()
        m.d.comb += stop.clk.eq(self.clock)
        with m.If(~reference.hold):
            m.d.stop += held.eq(0)
        with m.Elif(held != STOP_CLOCKS):
            m.d.stop += held.eq(held + 1)
        m.d.stop += reset.eq(held == STOP_CLOCKS)
        good = ready & ~reference.hold & ~reset
        m.d.comb += [
            reference.locked.eq(ready),
            # if the clock to be stopped stands still, only the reset reaches what stops it
            ResetSignal("free").eq(reset),
        ]
        m.submodules.pll = ecp5_pll(
            PllOutput(reference.chosen, self.clock_hz),
            PllOutput(ClockSignal("free"), SYNC_HZ),
            vco_hz=_VCO_HZ,
            locked=ready,
            reset=reset,
        )
        m.submodules.failed = AsyncFFSynchronizer(
            ~good, self.failed, o_domain="sync", stages=RECOVERY_CLOCKS
        )
        return good


def add_clocks(
    m: Module, config: CameraConfig, platform: Platform, clock: Signal, /
) -> CameraClocks:
    """Add the clocks of a camera, with the pins of an external one if it has that.

    Parameters
    ----------
    m : Module
        The board's top module.
    config : CameraConfig
        What is built.
    platform : Platform
        Has the pins.
    clock : Signal
        From the oscillator.
    """
    reference = None
    if config.reference_hz:
        reference = reference_from_pins(m, platform, clock, config.reference_hz)
    clocks = CameraClocks(clock, platform.default_clk_frequency, reference=reference)
    clocks.add_to(m, platform)
    return clocks


def add_camera(
    m: Module, config: CameraConfig, platform: Platform, clocks: CameraClocks | None = None, /
) -> Camera:
    """Add a camera and connect the pins that all boards share; its link is left to the caller.

    Parameters
    ----------
    m : Module
        The board's top module.
    config : CameraConfig
        What is built.
    platform : Platform
        Has the pins.
    clocks : CameraClocks, optional
        From `add_clocks`, for boards with an external clock.
    """
    m.submodules.camera = camera = Camera(config)
    drive_pin(m, platform, "trigger", camera.trigger)
    drive_pin(m, platform, "frame_sync", camera.frame_sync)
    m.d.comb += [
        camera.marker.eq(read_pin(m, platform, "marker")),
        camera.missed.eq(read_pin(m, platform, "missed")),
    ]
    if config.temperature:
        m.d.comb += camera.temperature.eq(add_temperature(m, config.form.clock_hz))
    if clocks is not None and clocks.reference is not None:
        m.d.comb += [
            clocks.reference.wanted.eq(camera.reference_wanted),
            camera.reference_state.eq(clocks.reference.state),
            camera.clock_failed.eq(clocks.failed),
            camera.time_sync.eq(read_pin(m, platform, "time_sync")),
        ]
        if ("time_sync_out", 0) in platform.resources:
            drive_pin(m, platform, "time_sync_out", camera.time_sync_out)
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

    Raises
    ------
    TargetError
        If the sensor has more lanes, or an external clock cannot be used.
    """
    config = replace(camera_config(options), temperature=True)
    check_lanes(board, config, sensor_lanes)
    if config.reference_hz:
        made = platform()
        if not {("reference", 0), ("time_sync", 0)} <= made.resources.keys():
            refuse_reference(board, config.reference_hz, "pins named reference and time_sync")
        conversion(round(made.default_clk_frequency), config.reference_hz)
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
        options={
            "script_after_read": no_collisions(config),
            **FAST_ROUTES,
            **(FABRIC_CLOCK if config.sensor else {}),
        },
    )
