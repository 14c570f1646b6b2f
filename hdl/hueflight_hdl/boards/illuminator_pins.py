# SPDX-License-Identifier: Apache-2.0
"""Connects an illuminator to its pins, in the way that all boards share."""

from __future__ import annotations

from dataclasses import dataclass

from amaranth.build import Platform
from amaranth.hdl import Module, Value

from ..illuminator.gearing.interface import Gearing
from ..illuminator.illuminator import Illuminator, IlluminatorConfig
from .pins import drive, drive_pin, input_of, read_pin


@dataclass(frozen=True)
class GearedPorts:
    """Pins that go through the gearing."""

    trigger: object
    channels: tuple[object, ...]
    trigger_out: object


def add_illuminator(
    m: Module,
    config: IlluminatorConfig,
    gearing: Gearing,
    ports: GearedPorts,
    clock_failed: Value | None = None,
) -> Illuminator:
    """Add an illuminator and its gearing to a module; other pins are left to the caller.

    Parameters
    ----------
    m : Module
        The module.
    config : IlluminatorConfig
        What is built.
    gearing : Gearing
        Gearing of the board.
    ports : GearedPorts
        Pins behind the gearing.
    clock_failed : Value, optional
        See `IlluminatorCore`; the pins of the LEDs are not driven while it is high.

    Returns
    -------
    Illuminator
        The illuminator.
    """
    m.submodules.illuminator = illuminator = Illuminator(config)
    m.d.comb += illuminator.trigger.eq(gearing.add_input(m, "trigger", ports.trigger))
    for number, port in enumerate(ports.channels):
        gearing.add_output(
            m,
            f"channel{number}",
            port,
            Value.cast(illuminator.levels[number]),
            enable=None if clock_failed is None else ~clock_failed,
        )
    if clock_failed is not None:
        m.d.comb += illuminator.clock_failed.eq(clock_failed)
    gearing.add_output(m, "trigger_out", ports.trigger_out, illuminator.trigger_out)
    return illuminator


def add_from_platform(
    m: Module,
    config: IlluminatorConfig,
    gearing: Gearing,
    platform: Platform,
    clock_failed: Value | None = None,
) -> Illuminator:
    """Add an illuminator and connect the pins that all boards share, except the indicator LED."""
    pulses = platform.request("led_pulse", 0, dir="-")
    ports = GearedPorts(
        trigger=platform.request("trigger", 0, dir="-"),
        channels=tuple(pulses[channel] for channel in range(config.pulse.channels)),
        trigger_out=platform.request("trigger_out", 0, dir="-"),
    )
    illuminator = add_illuminator(m, config, gearing, ports, clock_failed)
    uart = platform.request("uart", 0, dir="-")
    m.d.comb += [
        illuminator.rx.eq(input_of(m, "rx", uart.rx)),
        illuminator.frame_sync.eq(read_pin(m, platform, "frame_sync")),
    ]
    drive(m, "tx", uart.tx, illuminator.tx)
    for name in ("marker", "missed"):
        drive_pin(m, platform, name, getattr(illuminator, name))
    return illuminator
