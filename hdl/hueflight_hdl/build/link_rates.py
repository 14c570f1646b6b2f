# SPDX-License-Identifier: Apache-2.0
"""How many frames a second the links carry, and what rates serial lines can have.

Tables of the documentation.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hueflight_protocol import encode_frame

from ..boards.settings import MAX_BAUD
from ..boards.target import Target
from ..boards.ulx3s import FT_HZ
from ..boards.xem6310 import OK_HZ
from ..camera.frame_format import FrameFormat
from ..link.uart import FEWEST_CLOCKS_PER_BIT

OCCUPANCIES = (0.05, 0.1, 0.3, 0.5, 1.0)
SERIAL_BOARDS = ("ulx3s-85f", "ecpix5-85f", "hx8k")
_DRAWN = 8
"""Frames drawn for the mean size of a packet."""
LINKS = {
    "USB 2": 13 * 512 * 8000,  # packets of 512 bytes in each microframe
    "FT601": 4 * FT_HZ,
    "Opal Kelly": 4 * OK_HZ,
}
"""Most bytes per second that the links of the camera can carry, by link."""


def packet_bytes(form: FrameFormat, occupancy: float, /) -> float:
    """Return the mean size of a packet of random codes, as the encoder makes it.

    Parameters
    ----------
    form : FrameFormat
        Geometry, code width and run length.
    occupancy : float
        Share of pixels with a photon.

    Returns
    -------
    float
        Bytes.
    """
    rng = np.random.default_rng(1)
    sizes = []
    for _ in range(_DRAWN):
        codes = rng.integers(1, 1 << form.code_bits, (form.rows, form.cols), np.uint16)
        codes[rng.random(codes.shape) >= occupancy] = 0
        packet = encode_frame(
            codes, sequence=0, frame=0, timestamp=0, code_bits=form.code_bits, run=form.run
        )
        sizes.append(len(packet))
    return float(np.mean(sizes))


def frame_table(form: FrameFormat, /) -> str:
    """Return a table of frames per second by link and occupancy, in Markdown."""
    lines = ["| occupancy | bytes per frame | " + " | ".join(LINKS) + " |"]
    lines.append("|---" * (2 + len(LINKS)) + "|")
    for occupancy in OCCUPANCIES:
        size = packet_bytes(form, occupancy)
        rates = [f"{most / size:,.0f}" for most in LINKS.values()]
        lines.append(f"| {occupancy:g} | {size:,.0f} | " + " | ".join(rates) + " |")
    return "\n".join(lines)


def serial_table(targets: Iterable[Target], /) -> str:
    """Return a table of the rates of serial lines by board, in Markdown."""
    lines = ["| board | control clock, MHz | baud by default | most baud |", "|---|---|---|---|"]
    for target in targets:
        clock_hz = target.clocks_mhz["sync"] * 1e6
        most = min(MAX_BAUD, int(clock_hz / FEWEST_CLOCKS_PER_BIT))
        baud = target.settings["baud"]
        lines.append(f"| {target.board} | {clock_hz / 1e6:g} | {baud:,} | {most:,} |")
    return "\n".join(lines)
