"""Pins of a board, read and driven through plain buffers."""

from __future__ import annotations

from typing import Any

from amaranth.build import Platform
from amaranth.hdl import Module, Value, ValueLike
from amaranth.lib import io


def input_of(m: Module, name: str, port: Any, /) -> Value:
    """Return what a port reads."""
    m.submodules[f"{name}_pins"] = buffer = io.Buffer("i", port)
    return buffer.i


def drive(m: Module, name: str, port: Any, value: ValueLike, /) -> None:
    """Drive a port."""
    m.submodules[f"{name}_pins"] = buffer = io.Buffer("o", port)
    m.d.comb += buffer.o.eq(value)


def read_pin(m: Module, platform: Platform, name: str, /) -> Value:
    """Return what a resource reads."""
    return input_of(m, name, platform.request(name, 0, dir="-"))


def drive_pin(m: Module, platform: Platform, name: str, value: ValueLike, /) -> None:
    """Drive a resource."""
    drive(m, name, platform.request(name, 0, dir="-"), value)
