# SPDX-License-Identifier: Apache-2.0
"""Finding the end of a packet: header checks, and the walk over a frame's chunks.

A frame packet carries no length, so that the camera can stream it without a frame buffer.
Its end is found by stepping from chunk word to chunk word; everything that can be checked
without looking into payloads is checked on the way.
"""

from dataclasses import dataclass, field

from .checksum import xor_words
from .errors import PacketError
from .wire import (
    ALIGNMENT,
    CHUNK_WORD,
    END_WORD,
    FRAME_HEADER,
    FRAME_TRAILER,
    MAGIC,
    MAX_BODY_BYTES,
    MAX_CHUNKS,
    MAX_CODE_BITS,
    MAX_COLS,
    MAX_HEADER_BYTES,
    MAX_ROWS,
    MAX_RUN,
    MIN_RUN,
    PACKET_HEADER,
    RUN_MULTIPLE,
    STREAMED,
    VERSION,
    ChunkKind,
    FrameFlags,
    PacketType,
    TrailerStatus,
    dense_from,
    padded,
)

PREFIX_BYTES = 8
"""Magic, version, type and header size: enough to know how long the header is."""

Buffer = bytes | bytearray | memoryview


def header_size(buffer: Buffer, start: int, /) -> int:
    """Return the size of the header at `start`, of which `PREFIX_BYTES` are there.

    Raises
    ------
    PacketError
        If magic, version, type or size are not those of a packet.
    """
    if bytes(buffer[start : start + 4]) != MAGIC:
        raise PacketError(
            f"magic is {bytes(buffer[start : start + 4]).hex(' ')}", rule="P2", offset=0
        )
    version, kind = buffer[start + 4], buffer[start + 5]
    size = int.from_bytes(buffer[start + 6 : start + 8], "little")
    if version != VERSION:
        raise PacketError(f"version {version}, this parser reads {VERSION}", rule="P3", offset=4)
    known = {kind.value: PACKET_HEADER.size for kind in PacketType} | {
        PacketType.FRAME.value: FRAME_HEADER.size
    }
    expected = known.get(kind)
    if expected is not None and size != expected:
        raise PacketError(
            f"header of type {kind} has {size} bytes, not {expected}", rule="P4", offset=6
        )
    if size % ALIGNMENT or not PACKET_HEADER.size <= size <= MAX_HEADER_BYTES:
        raise PacketError(f"header size is {size}", rule="P4", offset=6)
    return size


def check_header(buffer: Buffer, start: int, size: int, /) -> None:
    """Check the exclusive or over a whole header (rule P5)."""
    check = xor_words(buffer[start : start + size])
    if check:
        raise PacketError(f"header words give {check:#010x}, not 0", rule="P5", offset=size - 4)


@dataclass(frozen=True, slots=True)
class Chunk:
    """One chunk as its word says: kind, place and sizes."""

    kind: int
    index: int
    hits: int
    pixels: int
    offset: int
    """Byte of the chunk word within the packet."""
    bitmap_size: int
    """Bytes of bitmap; 0 in a dense chunk."""
    packed_size: int
    """Bytes of packed codes, padding not counted."""
    size: int
    """Payload bytes, padding included."""


@dataclass(slots=True)
class FrameWalk:
    """The walk over a frame packet, which can pause where bytes are missing.

    Parameters
    ----------
    position : int
        How far into the packet the walk has come; its length at the end.
    needed : int
        Bytes of the packet that must be there before `advance` can go on.
    """

    position: int = 0
    needed: int = FRAME_HEADER.size
    header: dict[str, int] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    aborted: bool = False

    def advance(self, buffer: Buffer, start: int = 0, /) -> bool:
        """Go on with the packet at `start`; return whether it is all there.

        Raises
        ------
        PacketError
            If the packet breaks a rule.
        """
        while len(buffer) - start >= self.needed:
            if not self.header:
                self._read_header(buffer, start)
            elif self._read_word(buffer, start):
                return True
        return False

    def _read_header(self, buffer: Buffer, start: int) -> None:
        size = header_size(buffer, start)
        if buffer[start + 5] != PacketType.FRAME:
            raise PacketError(f"type {buffer[start + 5]} is not a frame", rule="P4", offset=5)
        check_header(buffer, start, size)
        header = FRAME_HEADER.unpack(buffer, start)
        check_frame_fields(header)
        self.header = header
        self.position = size
        self.needed = size + 4

    def _read_word(self, buffer: Buffer, start: int) -> bool:
        at = start + self.position
        word = int.from_bytes(buffer[at : at + 4], "little")
        kind = word & CHUNK_WORD["kind"].mask
        if kind == ChunkKind.END:
            self.needed = self.position + FRAME_TRAILER.size
            if len(buffer) - start < self.needed:
                return False
            self._read_trailer(FRAME_TRAILER.unpack(buffer, at))
            return True
        if kind == ChunkKind.PAD:
            self._read_pad(buffer, start, word)
            return False
        chunk = self._read_chunk(word)
        self.needed = self.position + 4 + chunk.size + 4
        self.position += 4 + chunk.size
        self.chunks.append(chunk)
        return False

    def _read_pad(self, buffer: Buffer, start: int, word: int) -> None:
        if word:
            raise PacketError(f"chunk word is {word:#010x}", rule="F6", offset=self.position)
        self.needed = self.position + 8
        if len(buffer) - start < self.needed:
            return
        at = start + self.position + 4
        if buffer[at] & CHUNK_WORD["kind"].mask != ChunkKind.END:
            raise PacketError("padding before a chunk", rule="F6", offset=self.position)
        self.position += 4

    def _read_chunk(self, word: int) -> Chunk:
        kind = word & CHUNK_WORD["kind"].mask
        index = word >> CHUNK_WORD["index"].shift & CHUNK_WORD["index"].mask
        hits = word >> CHUNK_WORD["hits"].shift
        header = self.header
        run, code_bits = header["run"], header["code_bits"]
        pixels = min(run, header["rows"] * header["cols"] - index * run)
        if pixels <= 0:
            raise PacketError(f"chunk {index} is out of range", rule="F7", offset=self.position)
        if self.chunks and index <= self.chunks[-1].index:
            raise PacketError(
                f"chunk {index} follows chunk {self.chunks[-1].index}",
                rule="F7",
                offset=self.position,
            )
        if not 1 <= hits <= pixels:
            raise PacketError(
                f"chunk {index} says {hits} hits in {pixels} pixels",
                rule="F8",
                offset=self.position,
            )
        dense = hits >= dense_from(pixels, code_bits)
        if dense != (kind == ChunkKind.DENSE):
            raise PacketError(
                f"chunk {index} with {hits} hits in {pixels} pixels has kind {kind}",
                rule="F9",
                offset=self.position,
            )
        bitmap_size = 0 if dense else -(-pixels // 8)
        packed_size = -(-(pixels if dense else hits) * code_bits // 8)
        size = padded(bitmap_size + packed_size, 4)
        return Chunk(kind, index, hits, pixels, self.position, bitmap_size, packed_size, size)

    def _read_trailer(self, trailer: dict[str, int]) -> None:
        end = END_WORD.unpack(trailer["end"])
        at = self.position
        if at % ALIGNMENT:
            raise PacketError("end word without padding before it", rule="F6", offset=at)
        if end["status"] & ~int(TrailerStatus.ABORTED):
            raise PacketError(f"status is {end['status']:#x}", rule="F12", offset=at)
        if end["chunks"] != len(self.chunks):
            raise PacketError(
                f"trailer says {end['chunks']} chunks, there are {len(self.chunks)}",
                rule="F12",
                offset=at,
            )
        hits = sum(chunk.hits for chunk in self.chunks)
        if trailer["hits"] != hits:
            raise PacketError(
                f"trailer says {trailer['hits']} hits, the chunks {hits}", rule="F12", offset=at + 4
            )
        size = at + FRAME_TRAILER.size
        if trailer["packet_words"] * 4 != size:
            raise PacketError(
                f"trailer says {trailer['packet_words']} words, the packet has {size // 4}",
                rule="P7",
                offset=at + 8,
            )
        self.aborted = bool(end["status"] & TrailerStatus.ABORTED)
        self.position = size


def check_frame_fields(header: dict[str, int], /) -> None:
    """Check the fields of a frame header against one another (rules F1 to F4)."""

    def refuse(name: str, rule: str) -> PacketError:
        offset = FRAME_HEADER.offset(name)
        return PacketError(f"{name} is {header[name]}", rule=rule, offset=offset)

    if header["length"] != STREAMED:
        raise refuse("length", "F1")
    if not 1 <= header["rows"] <= MAX_ROWS:
        raise refuse("rows", "F2")
    if not 1 <= header["cols"] <= MAX_COLS:
        raise refuse("cols", "F2")
    if not 1 <= header["code_bits"] <= MAX_CODE_BITS:
        raise refuse("code_bits", "F2")
    run = header["run"]
    if run % RUN_MULTIPLE or not MIN_RUN <= run <= MAX_RUN:
        raise refuse("run", "F3")
    if header["rows"] * header["cols"] > run * MAX_CHUNKS:
        raise refuse("run", "F3")
    if header["flags"] & ~sum(FrameFlags):
        raise refuse("flags", "F4")


def check_length(length: int, /) -> None:
    """Check the body length of a packet that is not a frame (rule P8)."""
    if length > MAX_BODY_BYTES:
        raise PacketError(f"length is {length}", rule="P8", offset=8)
