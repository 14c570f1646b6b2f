"""Frame packets: codes in, bytes out, and back.

`encode_frame` is the reference that the gateware's formatter equals bit for bit;
`decode_frame` is strict, so that every packet it accepts is exactly what `encode_frame`
makes of the codes it returns.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checksum import crc32c, xor_words
from .errors import AbortedFrameError, PacketError, ProtocolError
from .packing import pack_codes, unpack_codes
from .walk import Chunk, FrameWalk
from .wire import (
    ALIGNMENT,
    CHUNK_WORD,
    DEFAULT_RUN,
    END_WORD,
    FRAME_HEADER,
    FRAME_TRAILER,
    MAX_CHUNKS,
    MAX_CODE_BITS,
    MAX_COLS,
    MAX_ROWS,
    MAX_RUN,
    MIN_RUN,
    RUN_MULTIPLE,
    ChunkKind,
    FrameFlags,
    TrailerStatus,
    dense_from,
    padded,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameHeader:
    """What the header of a frame packet says.

    Parameters
    ----------
    sequence : int
        Number of the packet since the device's reset, modulo 2**32.
    frame : int
        Number of the frame since the run began; dropped frames count too.
    timestamp : int
        Device clock at the start of the exposure, in clock ticks.
    rows, cols : int
        Geometry in pixels, each 1 to 1024.
    code_bits : int
        Width of a code, 1 to 16.
    run : int
        Pixels per chunk, a multiple of 8 from 8 to 4096.
    periods : int
        Periods per exposure.
    dropped : int
        Frames the camera dropped whole since the run began.
    geometry : int
        Identity of the sensor's geometry; 0 = not stated.
    flags : FrameFlags
        What the camera did to the frame.
    step : int
        Step marker of the illuminator.
    capture : int
        Label of the run, as the host set it.
    clock_hz : int
        Clock ticks per second.
    """

    sequence: int
    frame: int
    timestamp: int
    rows: int
    cols: int
    code_bits: int = 9
    run: int = DEFAULT_RUN
    periods: int = 1
    dropped: int = 0
    geometry: int = 0
    flags: FrameFlags = FrameFlags.NONE
    step: int = 0
    capture: int = 0
    clock_hz: int = 0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("rows", 1, MAX_ROWS),
            ("cols", 1, MAX_COLS),
            ("code_bits", 1, MAX_CODE_BITS),
            ("run", MIN_RUN, MAX_RUN),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ProtocolError(f"{name} = {value}: must be from {low} to {high}")
        if self.run % RUN_MULTIPLE:
            raise ProtocolError(f"run = {self.run}: must be a multiple of {RUN_MULTIPLE}")
        if self.chunks > MAX_CHUNKS:
            raise ProtocolError(
                f"run = {self.run}: {self.pixels} pixels make {self.chunks} chunks, "
                f"more than {MAX_CHUNKS}; choose a longer run"
            )

    @classmethod
    def from_wire(cls, values: Mapping[str, int], /) -> Self:
        """Return the header whose fields `FRAME_HEADER` has unpacked."""
        named: dict[str, Any] = {field.name: values[field.name] for field in fields(cls)}
        return cls(**named | {"flags": FrameFlags(values["flags"])})

    @property
    def pixels(self) -> int:
        """Number of pixels in the frame."""
        return self.rows * self.cols

    @property
    def chunks(self) -> int:
        """Number of runs in the frame, empty ones too."""
        return -(-self.pixels // self.run)

    def pack(self) -> bytes:
        """Return the header's 64 bytes."""
        values = {field.name: int(getattr(self, field.name)) for field in fields(self)}
        head = FRAME_HEADER.pack(values | {"check": 0})
        return head[:-4] + xor_words(head).to_bytes(4, "little")


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One decoded frame.

    Parameters
    ----------
    header : FrameHeader
        What the packet's header says.
    codes : array of uint16, (rows, cols)
        One code per pixel, 0 = no photon. Read-only.
    """

    header: FrameHeader
    codes: NDArray[np.uint16]


def encode_frame(
    codes: ArrayLike,
    /,
    *,
    sequence: int,
    frame: int,
    timestamp: int,
    code_bits: int = 9,
    run: int = DEFAULT_RUN,
    periods: int = 1,
    dropped: int = 0,
    geometry: int = 0,
    flags: FrameFlags = FrameFlags.NONE,
    step: int = 0,
    capture: int = 0,
    clock_hz: int = 0,
    abort_at: int | None = None,
) -> bytes:
    """Return the frame packet that holds `codes`.

    Parameters
    ----------
    codes : array of integers, (rows, cols)
        One code per pixel, 0 = no photon, below 2**code_bits. Masked pixels and codes outside
        a region or gate are already 0; `flags` says that this was so.
    sequence, frame, timestamp, code_bits, run, periods, dropped, geometry, flags, step, \
capture, clock_hz
        Fields of `FrameHeader`.
    abort_at : int, optional
        Make the packet of a frame that the camera gave up before this run: chunks of lower
        index are sent, and the trailer says *aborted*.

    Returns
    -------
    bytes
        A multiple of 8 bytes.

    Raises
    ------
    ProtocolError
        If a value does not fit the wire format.
    """
    values = _checked_codes(codes, code_bits)
    header = FrameHeader(
        sequence=sequence,
        frame=frame,
        timestamp=timestamp,
        rows=values.shape[0],
        cols=values.shape[1],
        code_bits=code_bits,
        run=run,
        periods=periods,
        dropped=dropped,
        geometry=geometry,
        flags=flags,
        step=step,
        capture=capture,
        clock_hz=clock_hz,
    )
    if abort_at is not None and not 0 <= abort_at <= header.chunks:
        raise ProtocolError(f"abort_at = {abort_at}: must be from 0 to {header.chunks}")
    head = header.pack()
    chunks, count, hits = _encode_chunks(values.reshape(-1), code_bits, run, abort_at)
    body = head + chunks
    body += bytes(padded(len(body), ALIGNMENT) - len(body))
    status = TrailerStatus(0) if abort_at is None else TrailerStatus.ABORTED
    trailer = FRAME_TRAILER.pack(
        {
            "end": END_WORD.pack(kind=ChunkKind.END, status=status, chunks=count),
            "hits": hits,
            "packet_words": (len(body) + FRAME_TRAILER.size) // 4,
            "crc": 0,
        }
    )
    packet = body + trailer[:-4]
    return packet + crc32c(packet).to_bytes(4, "little")


def _checked_codes(codes: ArrayLike, code_bits: int) -> NDArray[np.uint16]:
    values = np.asarray(codes)
    if values.ndim != 2:
        raise ProtocolError(f"codes has shape {values.shape}: must be (rows, cols)")
    if not np.issubdtype(values.dtype, np.integer):
        raise ProtocolError(f"codes are {values.dtype}: must be integers")
    if not 1 <= code_bits <= MAX_CODE_BITS:
        raise ProtocolError(f"code_bits = {code_bits}: must be from 1 to {MAX_CODE_BITS}")
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    if low < 0 or high >> code_bits:
        bad = low if low < 0 else high
        raise ProtocolError(f"code {bad}: must be from 0 to {(1 << code_bits) - 1}")
    return values.astype(np.uint16)


def _encode_chunks(
    codes: NDArray[np.uint16], code_bits: int, run: int, abort_at: int | None
) -> tuple[bytes, int, int]:
    """Return all chunks as bytes, their number, and their hits."""
    count = -(-codes.size // run)
    table = np.zeros((count, run), np.uint16)
    table.reshape(-1)[: codes.size] = codes
    pixels = np.full(count, run)
    pixels[-1] = codes.size - run * (count - 1)
    hits = np.count_nonzero(table, axis=1)

    kept = np.flatnonzero(hits[:abort_at])
    table, pixels, hits = table[kept], pixels[kept], hits[kept]
    threshold = np.where(
        pixels == run, dense_from(run, code_bits), dense_from(codes.size % run or run, code_bits)
    )
    dense = hits >= threshold

    lit = table != 0
    compact = np.zeros_like(table)
    compact[np.arange(run) < hits[:, None]] = table[lit]
    packed = pack_codes(np.where(dense[:, None], table, compact), code_bits)
    bitmaps = np.packbits(lit, axis=1, bitorder="little")

    # One row per chunk: word | bitmap | packed codes | padding, of which each chunk keeps the
    # bytes that it has.
    bitmap_size = np.where(dense, 0, -(-pixels // 8))
    packed_size = -(-np.where(dense, pixels, hits) * code_bits // 8)
    pad_size = -(bitmap_size + packed_size) % 4
    kind = np.where(dense, int(ChunkKind.DENSE), int(ChunkKind.BITMAP))
    word = (
        kind << CHUNK_WORD["kind"].shift
        | kept << CHUNK_WORD["index"].shift
        | hits << CHUNK_WORD["hits"].shift
    )
    parts = (
        (word.astype("<u4").view(np.uint8).reshape(-1, 4), np.full(kept.size, 4)),
        (bitmaps, bitmap_size),
        (packed, packed_size),
        (np.zeros((kept.size, 3), np.uint8), pad_size),
    )
    rows = np.concatenate([part for part, _ in parts], axis=1)
    used = np.concatenate(
        [np.arange(part.shape[1]) < size[:, None] for part, size in parts], axis=1
    )
    return rows[used].tobytes(), int(kept.size), int(hits.sum())


def decode_frame(packet: bytes | bytearray | memoryview, /) -> Frame:
    """Return the frame in one whole frame packet.

    Parameters
    ----------
    packet : bytes-like
        Exactly one packet, from magic to CRC.

    Raises
    ------
    AbortedFrameError
        If the packet is well-formed but says that the camera gave the frame up.
    PacketError
        If the packet breaks a rule; the message names the rule, the value and the byte.
    """
    data = bytes(packet)
    walk = FrameWalk()
    if not walk.advance(data):
        raise PacketError(f"packet ends after {len(data)} bytes", rule="P7", offset=len(data))
    if walk.position != len(data):
        raise PacketError(
            f"{len(data) - walk.position} bytes follow the packet", rule="P7", offset=walk.position
        )
    return read_frame(data, walk)


def read_frame(data: bytes, walk: FrameWalk, /) -> Frame:
    """Return the frame in `data`, whose chunks `walk` has found."""
    stored = int.from_bytes(data[-4:], "little")
    computed = crc32c(data[:-4])
    if stored != computed:
        raise PacketError(
            f"CRC is {stored:#010x}, the bytes give {computed:#010x}",
            rule="P6",
            offset=len(data) - 4,
        )
    header = FrameHeader.from_wire(walk.header)
    codes = np.zeros(header.chunks * header.run, np.uint16)
    for chunk in walk.chunks:
        first = chunk.index * header.run
        codes[first : first + header.run] = _read_chunk(data, chunk, header)
    if walk.aborted:
        raise AbortedFrameError(
            f"frame {header.frame} was aborted by the camera",
            rule="F12",
            offset=len(data) - FRAME_TRAILER.size,
        )
    codes = codes[: header.pixels].reshape(header.rows, header.cols)
    codes.flags.writeable = False
    return Frame(header, codes)


def _read_chunk(data: bytes, chunk: Chunk, header: FrameHeader) -> NDArray[np.uint16]:
    """Return a full run of codes, the pixels beyond the frame's end being 0."""
    payload = np.frombuffer(data, np.uint8, chunk.size, chunk.offset + 4)
    out = np.zeros(header.run, np.uint16)
    if chunk.kind == ChunkKind.DENSE:
        out[:] = _unpack(payload, chunk.pixels, header, chunk.offset + 4)
        hits = np.count_nonzero(out)
        if hits != chunk.hits:
            raise PacketError(
                f"chunk {chunk.index} says {chunk.hits} hits but has {hits} codes other than 0",
                rule="F11",
                offset=chunk.offset,
            )
        return out
    bitmap_size = -(-chunk.pixels // 8)
    bits = np.unpackbits(payload[:bitmap_size], bitorder="little").view(bool)
    lit = np.flatnonzero(bits)
    if lit.size != chunk.hits:
        raise PacketError(
            f"chunk {chunk.index} says {chunk.hits} hits but its bitmap has {lit.size} ones",
            rule="F11",
            offset=chunk.offset,
        )
    if lit[-1] >= chunk.pixels:
        raise PacketError(
            f"chunk {chunk.index} has a bit for pixel {lit[-1]} of {chunk.pixels}",
            rule="F10",
            offset=chunk.offset + 4 + int(lit[-1]) // 8,
        )
    offset = chunk.offset + 4 + bitmap_size
    values = _unpack(payload[bitmap_size:], chunk.hits, header, offset)[: chunk.hits]
    if not values.all():
        raise PacketError(
            f"hit {int(np.argmin(values))} of chunk {chunk.index} has code 0",
            rule="F11",
            offset=offset,
        )
    out[lit] = values
    return out


def _unpack(
    payload: NDArray[np.uint8], count: int, header: FrameHeader, offset: int
) -> NDArray[np.uint16]:
    """Unpack `count` codes into a full run, and see that what follows them is 0."""
    whole = np.zeros(max(header.run * header.code_bits // 8, payload.size), np.uint8)
    whole[: payload.size] = payload
    used_bits = count * header.code_bits
    tail = whole[used_bits // 8 :].copy()
    if tail.size:
        tail[0] &= 0xFF << used_bits % 8 & 0xFF
    if tail.any():
        at = used_bits // 8 + int(np.flatnonzero(tail)[0])
        raise PacketError(
            f"padding is {int(whole[at]):#04x}, must be 0", rule="F10", offset=offset + at
        )
    return unpack_codes(whole[: header.run * header.code_bits // 8], header.code_bits)
