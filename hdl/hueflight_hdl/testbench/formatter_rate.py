# SPDX-License-Identifier: Apache-2.0
"""How many clocks a frame takes in the formatter, by occupancy.

    python -m hueflight_hdl.testbench.formatter_rate [lanes ...]

prints the table of ``docs/camera.md``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..camera.formatter.reference import SensorFrame
from ..camera.frame_format import FrameFormat
from .formatter import SimulatedFormatter

OCCUPANCIES = (0.0, 0.05, 0.3, 0.7, 0.85, 0.9, 1.0)
SETTLING = 4
"""Frames until the banks are as full as they will be."""


@dataclass(frozen=True)
class Rate:
    """Clocks from the end of one packet to the end of the next.

    Parameters
    ----------
    lanes : int
    occupancy : float
        Share of pixels with a photon.
    clocks_mean : float
    clocks_max : int
        Of the frames measured.
    packet_bytes : float
        Mean size of a packet.
    """

    lanes: int
    occupancy: float
    clocks_mean: float
    clocks_max: int
    packet_bytes: float


def random_codes(
    rng: np.random.Generator, form: FrameFormat, occupancy: float, /
) -> NDArray[np.uint16]:
    """Draw a frame, (rows, cols), of which a share of pixels has a code other than 0."""
    shape = form.rows, form.cols
    codes = rng.integers(1, 1 << form.code_bits, shape, np.uint16)
    return np.where(rng.random(shape) < occupancy, codes, np.uint16(0))


def measure_rates(
    form: FrameFormat, /, *, occupancies: Sequence[float] = OCCUPANCIES, frames: int = 12
) -> Iterator[Rate]:
    """Send frames without a pause through a formatter whose link takes every word.

    Parameters
    ----------
    form : FrameFormat
    occupancies : sequence of float
    frames : int
        Measured at each, after a few that fill the banks.
    """
    formatter = SimulatedFormatter(form)
    rng = np.random.default_rng(1)
    try:
        for occupancy in occupancies:
            drawn = [
                SensorFrame(random_codes(rng, form, occupancy)) for _ in range(frames + SETTLING)
            ]
            formatter.ended.clear()
            packets = list(formatter.packets(drawn))
            clocks = np.diff(formatter.ended)[SETTLING - 1 :]
            yield Rate(
                form.lanes,
                occupancy,
                float(clocks.mean()),
                int(clocks.max()),
                float(np.mean([len(packet) for packet in packets])),
            )
    finally:
        formatter.close()


def table(rates: Sequence[Rate], /, *, clock_hz: int) -> str:
    """Return rates as a table in Markdown."""
    lines = [
        "| lanes | occupancy | clocks per frame | largest | bytes per frame "
        f"| frames/s at {clock_hz / 1e6:g} MHz |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {rate.lanes} | {rate.occupancy:g} | {rate.clocks_mean:.0f} | {rate.clocks_max} "
        f"| {rate.packet_bytes:.0f} | {clock_hz / rate.clocks_mean:.0f} |"
        for rate in rates
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> None:
    """Print the table for the sensor of the paper."""
    rates: list[Rate] = []
    for lanes in [int(word) for word in arguments] or [8]:
        rates += measure_rates(FrameFormat(lanes=lanes))
    print(table(rates, clock_hz=FrameFormat().clock_hz))


if __name__ == "__main__":
    main(sys.argv[1:])
