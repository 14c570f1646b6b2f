# SPDX-License-Identifier: Apache-2.0
"""The serial line at any rate, off by as much as two clocks of boards can be, and in noise."""

from __future__ import annotations

import numpy as np
import pytest

from hueflight_hdl.link.uart import UartError, UartReceiver, UartTransmitter, bit_increment
from hueflight_hdl.testbench.cxxrtl import simulate
from hueflight_hdl.testbench.serial_line import LineReader, line_levels

# clock and rate: the boards' own, the fewest clocks a bit, and many
RATES = [(100e6, 3e6), (50e6, 3e6), (50.25e6, 3e6), (80e6, 10e6), (100e6, 115_200)]


def received(clock_hz: float, baud: float, levels: np.ndarray) -> list[tuple[int, bool]]:
    simulation = simulate(UartReceiver(bit_increment(clock_hz, baud)))
    records = simulation.inputs(len(levels))
    records["rx"] = levels
    outputs = simulation.run(records)
    beats = outputs["line__payload"][outputs["line__valid"] == 1]
    return [(int(beat) & 0xFF, bool(beat >> 8)) for beat in beats]


@pytest.mark.parametrize(("clock_hz", "baud"), RATES)
@pytest.mark.parametrize("off", [-0.02, 0.0, 0.02])
def test_receiver(simulator: None, clock_hz: float, baud: float, off: float):
    data = np.random.default_rng(1).integers(0, 256, 200, dtype=np.uint8).tobytes()
    levels = line_levels(data, clocks_per_bit=clock_hz / baud * (1 + off), idle_bits=3)
    assert received(clock_hz, baud, levels) == [(byte, False) for byte in data]


@pytest.mark.parametrize(("clock_hz", "baud"), RATES)
def test_transmitter(simulator: None, clock_hz: float, baud: float):
    data = np.random.default_rng(2).integers(0, 256, 12, dtype=np.uint8).tobytes()
    simulation = simulate(UartTransmitter(bit_increment(clock_hz, baud)))
    clocks_per_bit = clock_hz / baud
    reader, out, at = LineReader(clocks_per_bit=clocks_per_bit), b"", 0
    levels = []
    while len(out) < len(data):
        records = simulation.inputs(1)
        records["line__valid"] = at < len(data)
        records["line__payload"] = data[min(at, len(data) - 1)]
        result = simulation.run(records)[0]
        at += bool(result["line__ready"]) and at < len(data)
        levels.append(result["tx"])
        if len(levels) >= 20 * clocks_per_bit:
            out += reader.feed(np.array(levels))
            levels = []
    assert out == data


def test_glitches_are_no_bytes(simulator: None):
    """One-clock glitches of either level vanish in the majority of three samples."""
    rng = np.random.default_rng(3)
    data = bytes(range(100))
    levels = line_levels(data, clocks_per_bit=33.3, idle_bits=20)
    flips = np.arange(5, len(levels), 7) + rng.integers(0, 3, len(np.arange(5, len(levels), 7)))
    levels[flips[flips < len(levels)]] ^= 1
    assert [byte for byte, _ in received(100e6, 3e6, levels)] == list(data)


@pytest.mark.parametrize("clocks", [4, 8, 15])
def test_less_than_half_a_start_bit_is_no_byte(simulator: None, clocks: int):
    """Between bytes; the filter passes pulses of so many of 33.3 clocks."""
    data = bytes([0x00, 0x55, 0xFF, 0xA3])
    low = np.concatenate((np.zeros(clocks), np.ones(100))).astype(np.uint8)
    bytes_apart = [line_levels(data[k : k + 1], clocks_per_bit=33.3, idle_bits=2) for k in range(4)]
    levels = np.concatenate([part for byte in bytes_apart for part in (byte, low, low)])
    assert received(100e6, 3e6, levels) == [(byte, False) for byte in data]


def test_a_line_held_low_is_one_bad_byte(simulator: None):
    levels = np.concatenate((np.ones(50), np.zeros(2000), np.ones(50)))
    following = line_levels(b"\x55", clocks_per_bit=33.3, idle_bits=2)
    beats = received(100e6, 3e6, np.concatenate((levels, following)).astype(np.uint8))
    assert beats == [(0, True), (0x55, False)]


def test_rates_that_the_clock_does_not_allow():
    with pytest.raises(UartError, match="at most 12500000 baud"):
        bit_increment(100e6, 20e6)
    with pytest.raises(UartError, match="too slow"):
        bit_increment(100e6, 9600)
