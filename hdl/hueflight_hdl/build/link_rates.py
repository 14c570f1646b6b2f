# SPDX-License-Identifier: Apache-2.0
"""How many frames a second the links carry, and what rates serial lines can have.

Tables of the documentation.
"""

from __future__ import annotations

from collections.abc import Iterable

from hueflight_protocol.links import LINKS
from hueflight_protocol.links import packet_bytes as mean_packet_bytes

from ..boards.settings import MAX_BAUD
from ..boards.target import Target
from ..camera.frame_format import FrameFormat
from ..link.uart import FEWEST_CLOCKS_PER_BIT

OCCUPANCIES = (0.05, 0.1, 0.3, 0.5, 1.0)
SERIAL_BOARDS = ("ulx3s-85f", "ecpix5-85f", "hx8k")


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
    return mean_packet_bytes(
        form.rows, form.cols, occupancy, code_bits=form.code_bits, run=form.run
    )


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
