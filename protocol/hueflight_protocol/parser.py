# SPDX-License-Identifier: Apache-2.0
"""The reference parser: bytes in any pieces in, intact packets and counted damage out.

After damage it looks for the next magic at any byte, inside the damaged packet too, so
that no more than the damaged packet is lost. Its memory is bounded by the longest packet.
"""

from collections import deque
from dataclasses import dataclass

from .errors import AbortedFrameError, PacketError
from .frame import Frame
from .frame_decoder import read_frame
from .packets import Event, Opaque, Status, Sums, TestPattern, decode_packet, packet_size
from .walk import PREFIX_BYTES, FrameWalk, header_size
from .wire import MAGIC, PacketType

Content = Frame | Event | Status | TestPattern | Sums | Opaque


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """One intact packet.

    Parameters
    ----------
    offset : int
        Byte of the stream at which it starts.
    data : bytes
        The packet as it was received.
    content : Frame, Event, Status, TestPattern, Sums or Opaque
        What it carries.
    """

    offset: int
    data: bytes
    content: Content


@dataclass(frozen=True, slots=True)
class Damage:
    """A place in the stream where a packet should have been.

    Parameters
    ----------
    offset : int
        Byte of the stream at which the damaged packet starts.
    rule : str
        Rule of the specification that it breaks.
    reason : str
        The error in words.
    """

    offset: int
    rule: str
    reason: str


@dataclass(slots=True)
class ParserReport:
    """What a parser has seen so far.

    Parameters
    ----------
    packets : int
        Intact packets, aborted and repeated ones included.
    frames : int
        Frames delivered.
    aborted : int
        Well-formed packets of frames that the camera gave up: lost frames.
    repeated : int
        Packets that came twice in a row; delivered once.
    damaged : int
        Packets that were recognised and broke a rule.
    skipped_bytes : int
        Bytes that belong to no intact packet.
    missing : int
        Packets that never came intact, by gaps in the sequence numbers.
    restarts : int
        Steps back of the sequence number: the device was reset.
    dropped : int
        Frames the camera says it dropped, since the first frame seen or the capture's start.
    dropped_before : int
        Frames the camera had dropped in this capture before the first frame seen.
    """

    packets: int = 0
    frames: int = 0
    aborted: int = 0
    repeated: int = 0
    damaged: int = 0
    skipped_bytes: int = 0
    missing: int = 0
    restarts: int = 0
    dropped: int = 0
    dropped_before: int = 0


class PacketParser:
    """Finds packets in a byte stream that comes in arbitrary pieces.

    Parameters
    ----------
    keep_damage : int
        How many of the latest `Damage` records to keep.

    Attributes
    ----------
    report : ParserReport
        Running totals.
    damage : deque of Damage
        The latest damaged places.
    """

    def __init__(self, *, keep_damage: int = 64) -> None:
        self.report = ParserReport()
        self.damage: deque[Damage] = deque(maxlen=keep_damage)
        self._buffer = bytearray()
        self._base = 0  # stream offset of the buffer's first byte
        self._at = 0  # where in the buffer the next packet is looked for
        self._expected = True  # a packet must start right here: the stream is in step
        self._walk: FrameWalk | None = None
        self._needed = 0  # buffer size below which there is nothing to do
        self._sequence: int | None = None
        self._dropped: tuple[int, int] | None = None  # (capture, count) of the last frame

    @property
    def pending_bytes(self) -> int:
        """Bytes held back until their packet is complete."""
        return len(self._buffer)

    def feed(self, data: bytes | bytearray | memoryview, /) -> list[Packet]:
        """Take the next bytes of the stream.

        Parameters
        ----------
        data : bytes-like
            Next bytes.

        Returns
        -------
        list of Packet
            The packets that they complete.
        """
        self._buffer += data
        packets: list[Packet] = []
        while len(self._buffer) >= self._needed and self._step(packets):
            pass
        del self._buffer[: self._at]
        self._base += self._at
        self._needed -= self._at
        self._at = 0
        return packets

    def finish(self) -> list[Packet]:
        """Parse what is left when the stream has ended.

        Returns
        -------
        list of Packet
            Packets found inside one that was cut short.
        """
        packets: list[Packet] = []
        while self._at < len(self._buffer):
            while self._step(packets):
                pass
            if self._at < len(self._buffer):
                left = len(self._buffer) - self._at
                if left >= len(MAGIC):
                    self._lose(
                        PacketError(f"stream ends after {left} bytes", rule="P7", offset=left)
                    )
                else:
                    self._skip(left)
        self._base += self._at
        self._buffer.clear()
        self._at = self._needed = 0
        self._walk = None
        self._expected = True
        return packets

    def _step(self, packets: list[Packet]) -> bool:
        """Take one step at the current place; return False if more bytes are needed."""
        if self._walk is None and not self._find_magic():
            return False
        try:
            size = self._packet_size()
            if size is None:
                return False
            if len(self._buffer) - self._at < size:
                self._needed = self._at + size
                return False
            self._read(size, packets)
        except PacketError as error:
            self._lose(error)
        return True

    def _find_magic(self) -> bool:
        """Move to the next magic; return False if there is none yet."""
        found = self._buffer.find(MAGIC, self._at)
        if found < 0:
            # Keep what may be the start of a magic.
            kept = next(
                (n for n in range(len(MAGIC) - 1, 0, -1) if self._buffer.endswith(MAGIC[:n])), 0
            )
            found = max(self._at, len(self._buffer) - kept)
        if found > self._at:
            self._skip(found - self._at)
        self._needed = self._at + PREFIX_BYTES
        return len(self._buffer) >= self._needed

    def _skip(self, count: int) -> None:
        self.report.skipped_bytes += count
        self._at += count
        self._expected = False

    def _packet_size(self) -> int | None:
        size = header_size(self._buffer, self._at)
        if len(self._buffer) - self._at < size:
            self._needed = self._at + size
            return None
        if self._buffer[self._at + 5] != PacketType.FRAME:
            return packet_size(self._buffer, self._at)
        if self._walk is None:
            self._walk = FrameWalk()
        if not self._walk.advance(self._buffer, self._at):
            self._needed = self._at + self._walk.needed
            return None
        return self._walk.position

    def _read(self, size: int, packets: list[Packet]) -> None:
        data = bytes(self._buffer[self._at : self._at + size])
        content: Content | None
        try:
            content = read_frame(data, self._walk) if self._walk else decode_packet(data)
        except AbortedFrameError:
            content = None
        offset = self._base + self._at
        self._at += size
        self._needed = self._at + PREFIX_BYTES
        self._expected = True
        self.report.packets += 1
        sequence = int.from_bytes(data[12:16], "little")
        fresh = self._count_sequence(sequence)
        walk, self._walk = self._walk, None
        if not fresh:
            return
        if walk is not None:
            self._count_dropped(walk.header["capture"], walk.header["dropped"])
        if content is None:
            self.report.aborted += 1
            return
        self.report.frames += isinstance(content, Frame)
        packets.append(Packet(offset, data, content))

    def _count_sequence(self, sequence: int) -> bool:
        """Book a sequence number; return False if the packet is the last one again."""
        last, self._sequence = self._sequence, sequence
        if last is None:
            return True
        gap = (sequence - last - 1) % (1 << 32)
        if gap == (1 << 32) - 1:
            self.report.repeated += 1
            return False
        if gap < 1 << 31:
            self.report.missing += gap
        else:
            self.report.restarts += 1
        return True

    def _count_dropped(self, capture: int, dropped: int) -> None:
        if self._dropped is None:
            self.report.dropped_before = dropped
        else:
            last_capture, last = self._dropped
            same_capture = capture == last_capture and dropped >= last
            self.report.dropped += dropped - last if same_capture else dropped
        self._dropped = (capture, dropped)

    def _lose(self, error: PacketError) -> None:
        """Give up the packet at the current place and look for the next one inside it."""
        self._walk = None
        # A magic at a place where no packet is due is data unless its header holds.
        if self._expected or error.rule not in ("P2", "P3", "P4", "P5"):
            self.report.damaged += 1
            self.damage.append(Damage(self._base + self._at, error.rule, str(error)))
        self._skip(1)
        self._needed = 0
