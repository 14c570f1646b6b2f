# SPDX-License-Identifier: Apache-2.0
"""Reads and drives pins of a board through plain I/O buffers."""

from __future__ import annotations

from typing import Any

from amaranth.build import Platform
from amaranth.hdl import Module, Value, ValueLike
from amaranth.lib import io


def input_of(m: Module, name: str, port: Any, /) -> Value:
    """Add an input buffer for a port and return its value."""
    m.submodules[f"{name}_pins"] = buffer = io.Buffer("i", port)
    return buffer.i


def drive(m: Module, name: str, port: Any, value: ValueLike, /) -> None:
    """Add an output buffer that drives a port."""
    m.submodules[f"{name}_pins"] = buffer = io.Buffer("o", port)
    m.d.comb += buffer.o.eq(value)


def read_pin(m: Module, platform: Platform, name: str, /) -> Value:
    """Request a resource by name, add an input buffer and return its value."""
    return input_of(m, name, platform.request(name, 0, dir="-"))


def drive_pin(m: Module, platform: Platform, name: str, value: ValueLike, /) -> None:
    """Request a resource by name and add an output buffer that drives it."""
    drive(m, name, platform.request(name, 0, dir="-"), value)
