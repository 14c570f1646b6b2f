# SPDX-License-Identifier: Apache-2.0
"""Declarations of the wire format, camera to host: the definition of version 1.

Every packet starts with a header that carries magic, version, type and its own size, and
ends with the packet's length in words and a CRC-32C over all bytes before it. See
``docs/protocol.md`` for the rules in prose.
"""

from enum import IntEnum, IntFlag

from construct import BitsInteger, BitStruct, Const, Struct

from .layout import I32, I64, U8, U16, U32, U64, BitLayout, Layout

MAGIC = b"\xa7Hue"
VERSION = 1
ALIGNMENT = 8
"""Packets start and end on multiples of this many bytes."""
STREAMED = 0xFFFF_FFFF
"""Value of ``length`` in packets whose end is found by walking their chunks."""

MAX_ROWS = 1024
MAX_COLS = 1024
MAX_CODE_BITS = 16
MIN_RUN = 8
MAX_RUN = 4096
RUN_MULTIPLE = 8
"""Eight codes fill a whole number of bytes at every code width."""
DEFAULT_RUN = 512
MAX_CHUNKS = 1 << 14
MAX_BODY_BYTES = 1 << 20
MAX_HEADER_BYTES = 256


class PacketType(IntEnum):
    """What a packet carries; types not listed are reserved and skipped by their length."""

    FRAME = 1
    EVENT = 2
    STATUS = 3
    TEST = 4
    SUMS = 5


class FrameFlags(IntFlag):
    """What the camera did to a frame, and what it is."""

    NONE = 0
    MASKED = 1 << 0
    """Codes of masked pixels were replaced by 0."""
    ROI = 1 << 1
    """Codes outside the region of interest were replaced by 0."""
    GATED = 1 << 2
    """Codes outside the time gate were replaced by 0."""
    SATURATED = 1 << 3
    """A counter in this header stands at its largest value and may be short."""
    TEST_PATTERN = 1 << 4
    """Codes come from the camera's pattern generator, not from its sensor."""
    SIMULATED = 1 << 5
    """The packet was written by software."""
    TRIGGER_LOST = 1 << 6
    """The illuminator missed at least one trigger since the previous frame."""


class ChunkKind(IntEnum):
    """The two low bits of a chunk word."""

    PAD = 0
    BITMAP = 1
    DENSE = 2
    END = 3


class TrailerStatus(IntFlag):
    """Status bits of a frame packet's end word."""

    ABORTED = 1 << 0
    """The camera gave the frame up; its packet is well-formed but is not data."""


FRAME_HEADER = Layout(
    Struct(
        "magic" / Const(int.from_bytes(MAGIC, "little"), U32) * "bytes `A7 48 75 65`",
        "version" / Const(VERSION, U8) * "of the wire format",
        "type" / Const(int(PacketType.FRAME), U8) * "1 = frame",
        "header_bytes" / Const(64, U16) * "size of this header",
        "length" / Const(STREAMED, U32) * "unknown in advance: the chunks lead to the end (F1)",
        "sequence" / U32 * "number of the packet since reset, modulo 2^32",
        "timestamp" / U64 * "device clock at the start of the exposure, in clock ticks",
        "frame" / U64 * "number of the frame since the capture began; dropped frames count too",
        "periods" / U32 * "periods per exposure",
        "dropped" / U32 * "frames dropped whole since the capture began, saturating",
        "rows" / U16 * "1 to 1024",
        "cols" / U16 * "1 to 1024",
        "run" / U16 * "pixels per chunk, a multiple of 8 from 8 to 4096",
        "code_bits" / U8 * "width of a code, 1 to 16",
        "geometry" / U8 * "identity of the sensor's geometry; 0 = not stated",
        "flags" / U16 * "see frame flags",
        "step" / U16 * "step marker of the illuminator during the exposure",
        "capture" / U32 * "label of the capture, as the host set it",
        "clock_hz" / U32 * "clock ticks per second",
        "check" / U32 * "exclusive or of the 15 words before it",
    )
)
"""Header of a frame packet."""

PACKET_HEADER = Layout(
    Struct(
        "magic" / Const(int.from_bytes(MAGIC, "little"), U32) * "bytes `A7 48 75 65`",
        "version" / Const(VERSION, U8) * "of the wire format",
        "type" / U8 * "see packet types",
        "header_bytes" / Const(32, U16) * "size of this header",
        "length" / U32 * "bytes of body, 0 to 2^20, padding not counted",
        "sequence" / U32 * "number of the packet since reset, modulo 2^32",
        "timestamp" / U64 * "device clock when the packet was made, in clock ticks",
        "capture" / U32 * "label of the capture, as the host set it",
        "check" / U32 * "exclusive or of the 7 words before it",
    )
)
"""Header of every packet that is not a frame."""

FRAME_TRAILER = Layout(
    Struct(
        "end" / U32 * "end word: kind 3, status, number of chunks",
        "hits" / U32 * "sum of the chunks' hits",
        "packet_words" / U32 * "length of the whole packet in 32-bit words",
        "crc" / U32 * "CRC-32C over all bytes before it",
    )
)
"""The last bytes of a frame packet."""

PACKET_TRAILER = Layout(
    Struct(
        "packet_words" / U32 * "length of the whole packet in 32-bit words",
        "crc" / U32 * "CRC-32C over all bytes before it",
    )
)
"""The last bytes of every packet that is not a frame."""

CHUNK_WORD = BitLayout(
    BitStruct(
        "hits" / BitsInteger(16) * "pixels in the run with a code other than 0",
        "index" / BitsInteger(14) * "number of the run, rising through the packet",
        "kind" / BitsInteger(2) * "1 = bitmap, 2 = dense",
    )
)
"""First word of a chunk."""

END_WORD = BitLayout(
    BitStruct(
        "chunks" / BitsInteger(16) * "number of chunks in the packet",
        "status" / BitsInteger(14) * "bit 0: aborted; others 0",
        "kind" / BitsInteger(2) * "3 = end",
    )
)
"""First word of a frame packet's trailer."""


class EventCode(IntEnum):
    """What an event packet reports; codes not listed are delivered as plain numbers."""

    RUN_STARTED = 1
    RUN_STOPPED = 2
    OVERFLOW = 3
    TRIGGER_LOST = 4
    TEMPERATURE = 5
    SENSOR_FAULT = 6
    LINK_ERROR = 7


class EventLevel(IntEnum):
    """How grave an event is."""

    INFO = 0
    WARNING = 1
    ERROR = 2


EVENT_BODY = Layout(
    Struct(
        "code" / U16 * "see event codes",
        "level" / U8 * "0 = info, 1 = warning, 2 = error",
        "reserved" / Const(0, U8) * "reserved for later versions",
        "count" / U32 * "occurrences since the capture began, saturating",
        "value" / I64 * "depends on the code",
    )
)
"""Body of an event packet."""

STATUS_BODY = Layout(
    Struct(
        "frames_sent" / U64 * "whole frames sent since the capture began",
        "frames_dropped" / U32 * "frames dropped whole since the capture began, saturating",
        "frames_aborted" / U32 * "frames aborted since the capture began, saturating",
        "triggers_lost" / U32 * "triggers that the illuminator missed, saturating",
        "stall_clocks" / U32 * "clocks in which the link took no data, saturating",
        "buffer_peak" / U32 * "most bytes ever waiting for the link since the capture began",
        "temperature_mdeg" / I32 * "millidegrees Celsius; -2^31 = not measured",
    )
)
"""Body of a status packet."""

SUMS_BODY = Layout(
    Struct(
        "picture" / U32 * "number of the picture since the capture began, modulo 2^32",
        "first_pixel" / U32 * "number of the first pixel of this packet, in readout order",
        "pixels" / U32 * "pixels of this packet, 1 or more",
        "rows" / U16 * "of the picture, 1 to 1024",
        "cols" / U16 * "of the picture, 1 to 1024",
        "frames" / U32 * "frames that the sums of this packet hold; 0 or more",
        "missed" / U32 * "frames that came meanwhile and are not in them, saturating",
        "photons" / U64 * "codes that were added, over all pixels of this packet",
        "saturated" / U32 * "pixels of this packet with a saturated sum",
        "tables" / U32 * "hash of the tables",
        "offsets" / U32 * "CRC-32C of the offsets, a signed byte for each pixel; 0 = none is moved",
        "periods" / U32 * "periods per exposure",
        "code_bits" / U8 * "width of a code, 1 to 16",
        "sums" / U8 * "sums per pixel, 1 to 32",
        "flags" / U16 * "see frame flags",
        "reserved" / U32 * "0",
    )
)
"""Start of the body of a packet of sums; the widths and the packed sums follow."""

TEMPERATURE_UNKNOWN = -(1 << 31)


class PatternKind(IntEnum):
    """How the words of a test packet follow from its seed."""

    COUNTER = 0
    XORSHIFT = 1


TEST_BODY = Layout(
    Struct(
        "pattern" / U32 * "0 = counter, 1 = xorshift32",
        "seed" / U32 * "the first word; not 0 for xorshift32",
    )
)
"""Start of a test packet's body; the pattern's 32-bit words follow."""


def padded(size: int, multiple: int, /) -> int:
    """Return `size` rounded up to a multiple of `multiple`."""
    return -(-size // multiple) * multiple


def dense_bytes(pixels: int, code_bits: int, /) -> int:
    """Return the payload bytes of a dense chunk, padding included."""
    return padded(-(-pixels * code_bits // 8), 4)


def dense_from(pixels: int, code_bits: int, /) -> int:
    """Return the fewest hits at which a run of `pixels` is sent dense (rule F9).

    The dense form is chosen when it is no longer than the bitmap form; this is the
    constant that the gateware compares against.
    """
    # The bitmap form is shorter by a whole word while its packed codes fit into these bits.
    spare_bits = 8 * (dense_bytes(pixels, code_bits) - 4 - -(-pixels // 8))
    return 1 + max(0, spare_bits) // code_bits


MAX_PACKET_BYTES = (
    FRAME_HEADER.size
    + 4 * MAX_CHUNKS
    + MAX_ROWS * MAX_COLS * MAX_CODE_BITS // 8
    + FRAME_TRAILER.size
)
"""Every pixel of the largest geometry lit, in the shortest runs: it bounds a reader's memory."""
