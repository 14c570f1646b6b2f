"""The illuminator between its pins: what every board has in common."""

from __future__ import annotations

from dataclasses import dataclass

from amaranth.build import Platform
from amaranth.hdl import Module, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ..designs.illuminator import Illuminator, IlluminatorConfig
from ..gearing.seam import Gearing
from ..gearing.simulated import SimulatedGearing
from .pins import drive, drive_pin, input_of, read_pin


@dataclass(frozen=True)
class GearedPorts:
    """Pins that go through the gearing."""

    trigger: object
    channels: tuple[object, ...]
    trigger_out: object


def add_illuminator(
    m: Module, config: IlluminatorConfig, gearing: Gearing, ports: GearedPorts
) -> Illuminator:
    """Add an illuminator and its gearing to a module; its plain pins are left to connect."""
    m.submodules.illuminator = illuminator = Illuminator(config)
    m.d.comb += illuminator.trigger.eq(gearing.add_input(m, "trigger", ports.trigger))
    for number, port in enumerate(ports.channels):
        gearing.add_output(m, f"channel{number}", port, Value.cast(illuminator.levels[number]))
    gearing.add_output(m, "trigger_out", ports.trigger_out, illuminator.trigger_out)
    return illuminator


def add_from_platform(
    m: Module, config: IlluminatorConfig, gearing: Gearing, platform: Platform
) -> Illuminator:
    """Add an illuminator on the pins that every board names alike; its lamp is left to connect."""
    pulses = platform.request("led_pulse", 0, dir="-")
    ports = GearedPorts(
        trigger=platform.request("trigger", 0, dir="-"),
        channels=tuple(pulses[channel] for channel in range(config.pulse.channels)),
        trigger_out=platform.request("trigger_out", 0, dir="-"),
    )
    illuminator = add_illuminator(m, config, gearing, ports)
    uart = platform.request("uart", 0, dir="-")
    m.d.comb += [
        illuminator.rx.eq(input_of(m, "rx", uart.rx)),
        illuminator.frame_sync.eq(read_pin(m, platform, "frame_sync")),
    ]
    drive(m, "tx", uart.tx, illuminator.tx)
    for name in ("marker", "missed"):
        drive_pin(m, platform, name, getattr(illuminator, name))
    return illuminator


class GearedTwin(wiring.Component):
    """An illuminator with simulated gearing: a pin's ticks are a word a clock.

    Parameters
    ----------
    config : IlluminatorConfig
    gearing : Gearing
        Of the board; its twin is simulated.
    members : dict of str to wiring.Member
        What it has besides `trigger`, `levels`, `missed` and `armed`.
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


class IlluminatorTwin(GearedTwin):
    """The illuminator from pin to pin."""

    def __init__(self, config: IlluminatorConfig, gearing: Gearing) -> None:
        members = {
            "rx": In(1),
            "tx": Out(1, init=1),
            "frame_sync": In(1),
            "trigger_out": Out(config.pulse.lanes),
            "marker": Out(8),
        }
        super().__init__(config, gearing, members)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        levels = [Signal(self.config.pulse.lanes) for _ in range(self.config.pulse.channels)]
        ports = GearedPorts(self.trigger, tuple(levels), self.trigger_out)
        illuminator = add_illuminator(m, self.config, self.gearing, ports)
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
