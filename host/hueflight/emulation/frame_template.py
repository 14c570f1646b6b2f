# SPDX-License-Identifier: Apache-2.0
"""Ready-made frame packets, of which many are given their numbers in a few array operations.

A CRC is linear: that of a packet whose header has other numbers is that of the packet without them,
combined by exclusive or with what the numbers contribute. That depends on their bytes and on how
many bytes follow the header, so that the rest of a packet need not be read again.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from hueflight_protocol.wire import FRAME_HEADER

_NUMBERS = ("sequence", "timestamp", "frame", "dropped", "capture", "clock_hz", "check")
CRC_BYTES = 4
_CHECK_AT = FRAME_HEADER.offset("check") // 4  #: in words of 32 bits
_BITS = np.arange(32, dtype=np.uint32)
_LENGTHS_KEPT = 4096  #: packet sizes of which `_before_zeros` is kept
#: header and CRC of a packet whose numbers are zeros, and what each bit of a header's CRC becomes
#: up to the packet's end
FACTS = np.dtype([("head", "<u4", FRAME_HEADER.size // 4), ("crc", "<u4"), ("crc_bits", "<u4", 32)])


class Template:
    """One frame packet whose numbers are still to be filled in.

    Parameters
    ----------
    packet : bytes
        A complete frame packet.

    Attributes
    ----------
    size : int
        Number of bytes of the packet.
    body : bytes
        What is between header and CRC.
    facts : bytes
        What `stamp_all` must know besides, laid out as `FACTS`.
    """

    __slots__ = ("body", "facts", "filtered", "size")

    def __init__(self, packet: bytes) -> None:
        self.filtered: tuple[object, Template] | None = None  #: by which filter, and the result
        head = np.frombuffer(packet[: FRAME_HEADER.size], np.uint8).copy()
        head[_number_bytes()] = 0
        words = head.view("<u4")
        words[_CHECK_AT] = np.bitwise_xor.reduce(words)
        self.size, self.body = len(packet), packet[FRAME_HEADER.size : -CRC_BYTES]
        facts = np.zeros((), FACTS)
        facts["head"] = words
        facts["crc"] = google_crc32c.value(head.tobytes() + self.body)
        facts["crc_bits"] = _before_zeros(len(self.body))
        self.facts = facts.tobytes()

    def stamp(
        self,
        *,
        sequence: int,
        timestamp: int,
        frame: int,
        dropped: int = 0,
        capture: int = 0,
        clock_hz: int = 0,
    ) -> bytes:
        """Return the packet with these numbers and with a correct check word and CRC.

        Parameters
        ----------
        sequence, timestamp, frame, dropped, capture, clock_hz : int
            Fields of the frame header.

        Returns
        -------
        bytes
            The packet.
        """
        numbers = empty_headers(1)
        numbers["sequence"], numbers["timestamp"], numbers["frame"] = sequence, timestamp, frame
        numbers["dropped"], numbers["capture"] = dropped, capture
        numbers["clock_hz"] = clock_hz
        return stamp_all([self], numbers)


def empty_headers(count: int, /) -> NDArray[np.void]:
    """Return frame headers in which all is 0, to be given numbers.

    Parameters
    ----------
    count : int
        Number of headers.

    Returns
    -------
    structured array, shape (count,)
        The headers.
    """
    return np.zeros(count, FRAME_HEADER.dtype)


def stamp_all(templates: Sequence[Template], numbers: NDArray[np.void], /) -> bytes:
    """Return packets one after another, with numbers and with correct check words and CRCs.

    Parameters
    ----------
    templates : sequence of Template
        The frames.
    numbers : structured array, shape (frame,)
        Headers with the numbers of each frame, in which all else is 0; their check words are
        filled in.

    Returns
    -------
    bytes
        The packets.
    """
    facts = np.frombuffer(b"".join([template.facts for template in templates]), FACTS)
    changes = numbers.view("<u4").reshape(len(templates), -1)
    numbers["check"] = np.bitwise_xor.reduce(changes, axis=1)
    heads = (facts["head"] ^ changes).tobytes()
    crcs = (facts["crc"] ^ _contributions(changes, facts["crc_bits"])).tobytes()
    parts: list[bytes] = []
    head_at = crc_at = 0
    for template in templates:
        head_end, crc_end = head_at + FRAME_HEADER.size, crc_at + CRC_BYTES
        parts += (heads[head_at:head_end], template.body, crcs[crc_at:crc_end])
        head_at, crc_at = head_end, crc_end
    return b"".join(parts)


def _contributions(changes: NDArray[np.uint32], crc_bits: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """What numbers and check words contribute to the CRCs of whole packets.

    Parameters
    ----------
    changes : array of uint32, shape (frame, 16)
        Headers with numbers and check words, in which all else is 0.
    crc_bits : array of uint32, shape (frame, 32)
        What each bit of the headers' CRCs becomes up to the end of the packets.
    """
    table = _header_table()
    octets = changes.view(np.uint8)[:, _number_bytes()]
    of_headers = np.bitwise_xor.reduce(table[np.arange(len(table)), octets], axis=1)
    return np.bitwise_xor.reduce(crc_bits * (of_headers[:, None] >> _BITS & 1), axis=1)


@cache
def _number_bytes() -> NDArray[np.intp]:
    """Places in a header of the bytes of numbers and check word."""
    dtype = FRAME_HEADER.dtype
    places = [FRAME_HEADER.offset(name) + np.arange(dtype[name].itemsize) for name in _NUMBERS]
    return np.sort(np.concatenate(places))


@cache
def _header_table() -> NDArray[np.uint32]:
    """What each value of each byte in `_number_bytes` contributes to the CRC of the header.

    Returns
    -------
    array of uint32, shape (byte, 256)
        The contributions.
    """
    without = google_crc32c.value(bytes(FRAME_HEADER.size))

    def of_bit(place: int, bit: int) -> int:
        header = bytearray(FRAME_HEADER.size)
        header[place] = 1 << bit
        return google_crc32c.value(bytes(header)) ^ without

    places = _number_bytes().tolist()
    bits = np.array([[of_bit(place, bit) for bit in range(8)] for place in places], np.uint32)
    table = np.zeros((len(places), 1), np.uint32)
    for bit in range(8):  # values of one more bit each time
        table = np.concatenate((table, table ^ bits[:, bit, None]), axis=1)
    return table


@lru_cache(_LENGTHS_KEPT)
def _before_zeros(length: int) -> NDArray[np.uint32]:
    """What each bit of a CRC becomes where so many bytes of zeros follow, shape (32,)."""
    zeros = bytes(length)
    without = google_crc32c.extend(0, zeros)
    words = [google_crc32c.extend(1 << bit, zeros) ^ without for bit in range(32)]
    return np.array(words, np.uint32)
