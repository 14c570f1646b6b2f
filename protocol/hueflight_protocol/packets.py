# SPDX-License-Identifier: Apache-2.0
"""Packets that are not frames: events, status, test patterns, and types not known yet.

They carry the length of their body, so that a reader can skip a type it does not know.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from .checksum import crc32c, xor_words
from .errors import PacketError, ProtocolError
from .packet_header import PacketHeader
from .sums_packet import Sums, pack_sums, unpack_sums
from .walk import check_header, check_length, header_size
from .wire import (
    ALIGNMENT,
    EVENT_BODY,
    MAX_BODY_BYTES,
    PACKET_HEADER,
    PACKET_TRAILER,
    STATUS_BODY,
    TEMPERATURE_UNKNOWN,
    TEST_BODY,
    EventLevel,
    PacketType,
    PatternKind,
    padded,
)


@dataclass(frozen=True, slots=True)
class Event:
    """Something happened in the camera, once.

    Parameters
    ----------
    header : PacketHeader
        Sequence, timestamp, capture.
    code : int
        An `EventCode`, or a number that this version does not know.
    level : EventLevel
        How grave it is.
    count : int
        Occurrences since the capture began.
    value : int
        Number whose meaning depends on the code, such as bytes lost or millidegrees.
    """

    header: PacketHeader
    code: int
    level: EventLevel = EventLevel.INFO
    count: int = 1
    value: int = 0


@dataclass(frozen=True, slots=True)
class Status:
    """Counters of the camera, sent from time to time.

    Parameters
    ----------
    header : PacketHeader
        Sequence, timestamp, capture.
    frames_sent, frames_dropped, frames_aborted, triggers_lost : int
        Since the capture began.
    stall_clocks : int
        Clocks in which the link took no data.
    buffer_peak : int
        Most bytes ever waiting for the link.
    temperature_mdeg : int or None
        Millidegrees Celsius; None where it is not measured.
    """

    header: PacketHeader
    frames_sent: int = 0
    frames_dropped: int = 0
    frames_aborted: int = 0
    triggers_lost: int = 0
    stall_clocks: int = 0
    buffer_peak: int = 0
    temperature_mdeg: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TestPattern:
    """Known words, for checking a link.

    Parameters
    ----------
    header : PacketHeader
        Sequence, timestamp, capture.
    pattern : PatternKind
        How each word follows from the one before.
    words : array of uint32
        What arrived; the first is the seed.
    """

    __test__ = False  # not a test, whatever pytest makes of its name

    header: PacketHeader
    pattern: PatternKind
    words: NDArray[np.uint32]

    def errors(self) -> int:
        """Return how many words do not follow from the word before them.

        Returns
        -------
        int
            Number of words.
        """
        return int(np.count_nonzero(next_words(self.words[:-1], self.pattern) != self.words[1:]))


@dataclass(frozen=True, slots=True)
class Opaque:
    """An intact packet of a type that this version does not interpret.

    Parameters
    ----------
    header : PacketHeader
        Sequence, timestamp, capture.
    type : int
        As in the packet.
    body : bytes
        Without padding.
    """

    header: PacketHeader
    type: int
    body: bytes


def next_words(words: NDArray[np.uint32], pattern: PatternKind, /) -> NDArray[np.uint32]:
    """Return the word that follows each of `words` in a test pattern.

    # Ref: G. Marsaglia, Xorshift RNGs, Journal of Statistical Software 8(14), 2003:
    # the triple (13, 17, 5).
    """
    if pattern == PatternKind.COUNTER:
        return words + np.uint32(1)
    words = words ^ words << np.uint32(13)
    words = words ^ words >> np.uint32(17)
    return words ^ words << np.uint32(5)


def encode_event(event: Event, /) -> bytes:
    """Return the packet of an event.

    Parameters
    ----------
    event : Event
        The event.

    Returns
    -------
    bytes
        The packet.
    """
    body = EVENT_BODY.pack(
        {
            "code": event.code,
            "level": event.level,
            "count": event.count,
            "value": event.value,
        }
    )
    return encode_packet(PacketType.EVENT, body, event.header)


def encode_status(status: Status, /) -> bytes:
    """Return the packet of a status.

    Parameters
    ----------
    status : Status
        The status.

    Returns
    -------
    bytes
        The packet.
    """
    values = {field.name: getattr(status, field.name) for field in fields(status)[1:]}
    if values["temperature_mdeg"] is None:
        values["temperature_mdeg"] = TEMPERATURE_UNKNOWN
    return encode_packet(PacketType.STATUS, STATUS_BODY.pack(values), status.header)


def encode_test_pattern(
    header: PacketHeader, /, *, pattern: PatternKind, seed: int, words: int
) -> bytes:
    """Return a packet with a test pattern.

    Parameters
    ----------
    header : PacketHeader
        Sequence, timestamp, capture.
    pattern : PatternKind
        How each word follows from the one before.
    seed : int
        First word.
    words : int
        Number of words.

    Returns
    -------
    bytes
        The packet.
    """
    if words < 1 or 4 + 4 * words > MAX_BODY_BYTES:
        raise ProtocolError(f"words = {words}: must be from 1 to {MAX_BODY_BYTES // 4 - 1}")
    if pattern == PatternKind.XORSHIFT and seed == 0:
        raise ProtocolError("seed = 0: xorshift32 would stay at 0")
    values = np.empty(words, np.uint32)
    values[:1] = seed
    for i in range(1, words):
        values[i : i + 1] = next_words(values[i - 1 : i], pattern)
    head = TEST_BODY.pack({"pattern": pattern, "seed": seed})
    return encode_packet(PacketType.TEST, head + values[1:].astype("<u4").tobytes(), header)


def encode_sums(sums: Sums, /) -> bytes:
    """Return a packet of sums.

    Parameters
    ----------
    sums : Sums
        The sums.

    Returns
    -------
    bytes
        The packet.
    """
    return encode_packet(PacketType.SUMS, pack_sums(sums), sums.header)


def encode_packet(kind: int, body: bytes, header: PacketHeader, /) -> bytes:
    """Return a packet of any type but a frame.

    Parameters
    ----------
    kind : int
        A `PacketType` other than FRAME, or a reserved number.
    body : bytes
        At most 2**20 bytes; padded with zeros to a multiple of 8.
    header : PacketHeader
        Sequence, timestamp, capture.

    Returns
    -------
    bytes
        The packet.
    """
    if kind == PacketType.FRAME:
        raise ProtocolError("type 1 is a frame: use encode_frame")
    if len(body) > MAX_BODY_BYTES:
        raise ProtocolError(f"body has {len(body)} bytes: at most {MAX_BODY_BYTES}")
    head = PACKET_HEADER.pack(
        {
            "type": kind,
            "length": len(body),
            "sequence": header.sequence,
            "timestamp": header.timestamp,
            "capture": header.capture,
            "check": 0,
        }
    )
    head = head[:-4] + xor_words(head).to_bytes(4, "little")
    inner = head + body + bytes(-len(body) % ALIGNMENT)
    words = (len(inner) + PACKET_TRAILER.size) // 4
    packet = inner + words.to_bytes(4, "little")
    return packet + crc32c(packet).to_bytes(4, "little")


def packet_size(buffer: bytes | bytearray, start: int, /) -> int | None:
    """Return the size of the packet at `start`, which is not a frame; None if its header is cut.

    Raises
    ------
    PacketError
        If the header breaks a rule.
    """
    size = header_size(buffer, start)
    if len(buffer) - start < size:
        return None
    check_header(buffer, start, size)
    length = int.from_bytes(buffer[start + 8 : start + 12], "little")
    check_length(length)
    return size + padded(length, ALIGNMENT) + PACKET_TRAILER.size


def decode_packet(packet: bytes, /) -> Event | Status | TestPattern | Sums | Opaque:
    """Return what one whole packet that is not a frame carries.

    Parameters
    ----------
    packet : bytes
        Exactly one packet.

    Returns
    -------
    Event, Status, TestPattern, Sums or Opaque
        The content; `Opaque` for a type that this version does not know.

    Raises
    ------
    PacketError
        If the packet breaks a rule; the message names the rule, the value and the byte.
    """
    size = packet_size(packet, 0) if len(packet) >= PACKET_HEADER.size else None
    if size is None or len(packet) != size:
        raise PacketError(
            f"packet has {len(packet)} bytes, its header says {size}", rule="P7", offset=len(packet)
        )
    head = PACKET_HEADER.unpack(packet)
    trailer = PACKET_TRAILER.unpack(packet, size - PACKET_TRAILER.size)
    computed = crc32c(packet[:-4])
    if trailer["crc"] != computed:
        raise PacketError(
            f"CRC is {trailer['crc']:#010x}, the bytes give {computed:#010x}",
            rule="P6",
            offset=size - 4,
        )
    if trailer["packet_words"] * 4 != size:
        raise PacketError(
            f"trailer says {trailer['packet_words']} words, the packet has {size // 4}",
            rule="P7",
            offset=size - 8,
        )
    first = head["header_bytes"]
    body = packet[first : first + head["length"]]
    padding = packet[first + len(body) : size - PACKET_TRAILER.size]
    if any(padding):
        raise PacketError(
            f"padding is {padding.hex(' ')}, must be 0", rule="P8", offset=first + len(body)
        )
    header = PacketHeader(
        sequence=head["sequence"], timestamp=head["timestamp"], capture=head["capture"]
    )
    return _read_body(head["type"], body, header, first)


def _read_body(
    kind: int, body: bytes, header: PacketHeader, at: int
) -> Event | Status | TestPattern | Sums | Opaque:
    if kind == PacketType.EVENT:
        return _read_event(body, header, at)
    if kind == PacketType.STATUS:
        _check_body(len(body) == STATUS_BODY.size, len(body), "status")
        values: dict[str, int | None] = {**STATUS_BODY.unpack(body)}
        if values["temperature_mdeg"] == TEMPERATURE_UNKNOWN:
            values["temperature_mdeg"] = None
        return Status(header, **values)  # pyright: ignore[reportArgumentType]
    if kind == PacketType.TEST:
        return _read_test(body, header, at)
    if kind == PacketType.SUMS:
        return unpack_sums(body, header, at)
    return Opaque(header, kind, body)


def _check_body(right: bool, size: int, name: str) -> None:
    if not right:
        raise PacketError(f"{name} body has {size} bytes", rule="E1", offset=8)


def _read_event(body: bytes, header: PacketHeader, at: int) -> Event:
    _check_body(len(body) == EVENT_BODY.size, len(body), "event")
    values = EVENT_BODY.unpack(body)
    if values["level"] > max(EventLevel):
        raise PacketError(f"level is {values['level']}", rule="E2", offset=at + 2)
    if values["reserved"]:
        raise PacketError(f"reserved byte is {values['reserved']}", rule="E2", offset=at + 3)
    level = EventLevel(values["level"])
    return Event(header, values["code"], level, values["count"], values["value"])


def _read_test(body: bytes, header: PacketHeader, at: int) -> TestPattern:
    _check_body(len(body) >= TEST_BODY.size and len(body) % 4 == 0, len(body), "test")
    values = TEST_BODY.unpack(body)
    if values["pattern"] > max(PatternKind):
        raise PacketError(f"pattern is {values['pattern']}", rule="E4", offset=at)
    words = np.frombuffer(body[TEST_BODY.offset("seed") :], "<u4")
    return TestPattern(header, PatternKind(values["pattern"]), words)
