# SPDX-License-Identifier: Apache-2.0
"""Timing jitter of a train relative to its trigger, from simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..illuminator.pulse_generator.config import PulseConfig
from ..illuminator.pulse_generator.reference import Pulse, Schedule
from .pulse_generator import PulseTestbench, Stimulus

_CHUNK = 2000
_LEAD_CLOCKS = 60


@dataclass(frozen=True)
class Jitter:
    """Spread of the time from a trigger to its LED.

    Parameters
    ----------
    tick_ns : float
        Step of the outputs.
    peak_to_peak_ns, rms_ns : float
    """

    tick_ns: float
    peak_to_peak_ns: float
    rms_ns: float


def trigger_jitter(
    *, lanes: int, tick_ns: float, synchronous: bool, triggers: int = 20_000, seed: int = 1
) -> Jitter:
    """Trigger the pulse generator at random times and see when its LED rises.

    Parameters
    ----------
    lanes : int
        Ticks per clock.
    tick_ns : float
    synchronous : bool
        Triggers come at a fixed phase of the tick, rather than at any.
    triggers : int
    seed : int

    Notes
    -----
    Pins and clocks are ideal: what clock and input buffer add (some ten picoseconds) comes on
    top.
    """
    bench = PulseTestbench(PulseConfig(channels=1, pulses=1, steps=1, lanes=lanes))
    rng = np.random.default_rng(seed)
    schedule = Schedule(8 * lanes, 1, [[Pulse(0, 1)]])
    delays = []
    for _ in range(0, triggers, _CHUNK):
        gaps = rng.uniform(16 * lanes, 32 * lanes, _CHUNK)
        times = _LEAD_CLOCKS * lanes + np.cumsum(gaps)  # in ticks
        if synchronous:
            times = np.floor(times) + 0.5
        seen = np.ceil(times).astype(int)
        ticks = int(seen[-1] // lanes + 16) * lanes
        level = np.zeros(ticks, bool)
        for later in range(4 * lanes):
            level[seen + later] = True
        out = bench.run(Stimulus((schedule, schedule), level)).levels[0]
        rises = 1 + np.flatnonzero(~out[:-1] & out[1:])
        delays.append((rises - times) * tick_ns)
    spread = np.concatenate(delays)
    return Jitter(tick_ns, float(np.ptp(spread)), float(spread.std()))


ROWS = (
    ("Hueflight on ECP5, 200 MHz, 4:1", 4, 1.25),
    ("Hueflight on iCE40-HX8K, 100.5 MHz, 2:1", 2, 1e3 / 201),
    ("A plain sampler, 200 MHz (the same design, 1:1)", 1, 5.0),
)
"""What is compared: name, lanes, tick in ns."""


def jitter_table() -> list[str]:
    """Return the rows of the table in ``docs/illuminator.md``."""
    lines = []
    for name, lanes, tick_ns in ROWS:
        free = trigger_jitter(lanes=lanes, tick_ns=tick_ns, synchronous=False)
        tied = trigger_jitter(lanes=lanes, tick_ns=tick_ns, synchronous=True)
        lines.append(
            f"| {name} | {tick_ns:.2f} | {free.peak_to_peak_ns:.2f} | {free.rms_ns:.2f} | "
            f"{tied.peak_to_peak_ns:.2f} |"
        )
    return lines
