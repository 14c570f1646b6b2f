# SPDX-License-Identifier: Apache-2.0
"""Header of every packet that is not a frame."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketHeader:
    """What the header of a packet that is not a frame says.

    Parameters
    ----------
    sequence : int
        Number of the packet since the device's reset, modulo 2**32.
    timestamp : int
        Device clock when the packet was made, in clock ticks.
    capture : int
        Label of the capture, as the host set it.
    """

    sequence: int
    timestamp: int = 0
    capture: int = 0
