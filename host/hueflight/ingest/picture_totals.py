# SPDX-License-Identifier: Apache-2.0
"""Frames behind the pictures of sums in a stream, without unpacking the sums."""

from __future__ import annotations

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

    Attributes
    ----------
    pictures, frames, photons : int
        Complete pictures, the frames that they hold, and the codes that were added.
    missed : int
        Frames that the camera could not add, as far as packets told.
    """

    def __init__(self) -> None:
        self.pictures = self.frames = self.photons = self.missed = 0
        self._picture: tuple[int, int] | None = None  # capture and number
        self._pixels = 0  # of it that came without a gap; less than 0 if there was one

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
            self.missed += head["missed"]
        if head["first_pixel"] != self._pixels:
            self._pixels = -1
            return
        self._pixels += head["pixels"]
        if self._pixels == head["rows"] * head["cols"]:
            self.pictures += 1
            self.frames += head["frames"]
            self.photons += head["photons"]

    def interrupt(self) -> None:
        """Take the present picture for incomplete: some of its packets are not kept."""
        self._pixels = -1
