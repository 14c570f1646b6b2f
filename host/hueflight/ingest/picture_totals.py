# SPDX-License-Identifier: Apache-2.0
"""Frames behind the pictures of sums in a stream, without unpacking the sums."""

from __future__ import annotations

from fractions import Fraction
from math import ceil

from hueflight_protocol.wire import PACKET_HEADER, SUMS_BODY, PacketType

_TYPE_AT = PACKET_HEADER.offset("type")


def holds_sums(packet: bytes, /) -> bool:
    """Tell whether a packet is one of sums.

    Parameters
    ----------
    packet : bytes
        An intact packet of any type.

    Returns
    -------
    bool
        True for a packet of sums.
    """
    return packet[_TYPE_AT] == PacketType.SUMS


class PictureTotals:
    """Counts the frames of pictures of which every packet came.

    Where the packets of a picture hold other frames each, its frames are the mean over its pixels,
    and so are those that the camera missed. Rounded down and up, both together are never more than
    the frames of the captures, and as many if no packet is lost.

    Attributes
    ----------
    pictures, photons : int
        Complete pictures, and the codes that were added.
    """

    def __init__(self) -> None:
        self.pictures = self.photons = 0
        self._frames = self._missed = Fraction(0)
        self._picture: tuple[int, int] | None = None  # capture and number
        self._pixels = 0  # of it that came without a gap; less than 0 if there was one
        self._pixel_frames = self._photons = 0  # of it

    @property
    def frames(self) -> int:
        """Frames that the complete pictures hold."""
        return int(self._frames)

    @property
    def missed(self) -> int:
        """Frames that the camera could not add to the sums, as packets told."""
        return ceil(self._missed)

    def feed(self, packet: bytes, /) -> None:
        """Count a packet.

        Parameters
        ----------
        packet : bytes
            An intact packet of sums.
        """
        head = SUMS_BODY.unpack(packet[PACKET_HEADER.size :][: SUMS_BODY.size])
        picture = PACKET_HEADER.unpack(packet[: PACKET_HEADER.size])["capture"], head["picture"]
        if picture != self._picture:
            self._picture, self._pixels = picture, 0
            self._pixel_frames = self._photons = 0
        pixels = head["rows"] * head["cols"]
        self._missed += Fraction(head["missed"] * head["pixels"], pixels)
        if head["first_pixel"] != self._pixels:
            self._pixels = -1
            return
        self._pixels += head["pixels"]
        self._pixel_frames += head["frames"] * head["pixels"]
        self._photons += head["photons"]
        if self._pixels == pixels:
            self.pictures += 1
            self._frames += Fraction(self._pixel_frames, self._pixels)
            self.photons += self._photons

    def interrupt(self) -> None:
        """Take the present picture for incomplete: some of its packets are not kept."""
        self._pixels = -1
