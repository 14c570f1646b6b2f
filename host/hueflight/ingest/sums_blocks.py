# SPDX-License-Identifier: Apache-2.0
"""Packets of sums, gathered to pictures; the sums are unpacked by whoever needs them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from hueflight_protocol import PictureAssembler, Sums, SumsPicture, decode_packet
from hueflight_protocol.wire import PACKET_HEADER, SUMS_BODY


@dataclass(frozen=True, eq=False)
class SumsBlock:
    """Packets of one picture of sums.

    Attributes
    ----------
    packets : tuple of bytes
        Intact packets, in the order in which they came; some may be missing.
    frames : int
        Most frames that the sums of a packet hold.
    last_tick : int
        Device clock when the last of the packets was sent, in ticks.
    """

    packets: tuple[bytes, ...]
    frames: int
    last_tick: int

    @cached_property
    def picture(self) -> SumsPicture:
        """The sums; pixels whose packet is missing have none."""
        assembler = PictureAssembler()
        for packet in self.packets:
            part = decode_packet(packet)
            assert isinstance(part, Sums)
            found = assembler.feed(part)
            if found is not None:
                return found
        found = assembler.finish()
        assert found is not None
        return found


class SumsBlocks:
    """Gathers packets of sums to pictures."""

    def __init__(self) -> None:
        self._packets: list[bytes] = []
        self._picture: tuple[int, int] | None = None  # capture and number
        self._frames = self._tick = 0

    def feed(self, packet: bytes, /) -> list[SumsBlock]:
        """Take a packet.

        Parameters
        ----------
        packet : bytes
            An intact packet of sums.

        Returns
        -------
        list of SumsBlock
            Pictures that this packet completes, or shows to be over; see `finish`.
        """
        head = PACKET_HEADER.unpack(packet[: PACKET_HEADER.size])
        body = SUMS_BODY.unpack(packet[PACKET_HEADER.size :][: SUMS_BODY.size])
        picture = head["capture"], body["picture"]
        over = self.finish() if picture != self._picture else []
        self._picture, self._tick = picture, head["timestamp"]
        self._frames = max(self._frames, body["frames"])
        self._packets.append(packet)
        if body["first_pixel"] + body["pixels"] == body["rows"] * body["cols"]:
            over += self.finish()
        return over

    def finish(self) -> list[SumsBlock]:
        """End the picture that is being gathered.

        Returns
        -------
        list of SumsBlock
            The picture, if a packet of it came. One of which no packet holds a frame is left out:
            it tells what the camera missed at the end of a capture.
        """
        packets, self._packets, self._picture = tuple(self._packets), [], None
        frames, self._frames = self._frames, 0
        return [SumsBlock(packets, frames, self._tick)] if frames else []
