# SPDX-License-Identifier: Apache-2.0
"""Build-time format of frames: geometry, code width, lanes, run length, chunk banks."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

from amaranth.lib import data

from hueflight_protocol.errors import HueflightError, ProtocolError
from hueflight_protocol.frame import FrameHeader
from hueflight_protocol.wire import (
    CHUNK_WORD,
    DEFAULT_RUN,
    FRAME_HEADER,
    FRAME_TRAILER,
    dense_bytes,
    dense_from,
)

GROUP = 8
"""Codes in a group; eight codes of any width fill whole bytes."""
LANES = (1, 2, 4, 8)
BANKS = (2, 4, 8, 16)
WRITE_LATENCY = 16
"""Clocks from a chunk's last beat until it can be read, at most."""


class FormatError(HueflightError):
    """A frame format is out of range or inconsistent."""


@dataclass(frozen=True, kw_only=True)
class FrameFormat:
    """Format of the frames that a camera is built for.

    Parameters
    ----------
    rows, cols : int
        Geometry in pixels, each 1 to 1024.
    code_bits : int
        Width of a code, 1 to 16.
    lanes : int
        Codes per clock at the sensor port: 1, 2, 4 or 8.
    run : int
        Pixels per chunk, a multiple of 8 from 8 to 4096.
    geometry : int
        Identity of the geometry, as in frame headers; 0 = not stated.
    clock_hz : int
        Frequency of the device clock, as in frame headers.
    banks : int
        Chunks that are held between sensor and link: 2, 4, 8 or 16. Eight chunks of 512
        nine-bit codes just fill ECP5's block memories.

    Raises
    ------
    FormatError
        If a number is out of its range.
    """

    rows: int = 192
    cols: int = 128
    code_bits: int = 9
    lanes: int = 8
    run: int = DEFAULT_RUN
    geometry: int = 0
    clock_hz: int = 100_000_000
    banks: int = 8

    def __post_init__(self) -> None:
        if self.lanes not in LANES:
            raise FormatError(f"lanes = {self.lanes}: must be one of {LANES}")
        if self.banks not in BANKS:
            raise FormatError(f"banks = {self.banks}: must be one of {BANKS}")
        try:
            self.header()
        except ProtocolError as error:
            raise FormatError(str(error)) from error

    def header(self) -> bytes:
        """Return a frame header with all that is fixed by the build, the rest 0."""
        return FrameHeader(
            sequence=0,
            frame=0,
            timestamp=0,
            rows=self.rows,
            cols=self.cols,
            code_bits=self.code_bits,
            run=self.run,
            geometry=self.geometry,
            clock_hz=self.clock_hz,
            periods=0,
        ).pack()

    @property
    def pixels(self) -> int:
        """Pixels of a frame."""
        return self.rows * self.cols

    @property
    def chunks(self) -> int:
        """Runs of a frame, empty ones too."""
        return -(-self.pixels // self.run)

    @property
    def beats(self) -> int:
        """Clocks in which a frame comes from the sensor; the last one may be partly unused."""
        return -(-self.pixels // self.lanes)

    @property
    def last_lanes(self) -> int:
        """Lanes that carry a pixel in a frame's last beat."""
        return self.pixels - self.lanes * (self.beats - 1)

    def chunk(self, *, last: bool) -> ChunkFormat:
        """Return the sizes of a frame's last chunk, or of all others."""
        pixels = self.pixels - self.run * (self.chunks - 1) if last else self.run
        return ChunkFormat(pixels, self.code_bits, self.lanes)

    @property
    def max_packet_words(self) -> int:
        """Words of eight bytes in the longest packet: that of a frame with all pixels lit."""
        chunks = (self.chunks - 1) * self.chunk(last=False).dense_bytes
        chunks += self.chunk(last=True).dense_bytes
        return -(-(FRAME_HEADER.size + chunks + FRAME_TRAILER.size) // 8)

    @property
    def burst_banks(self) -> int:
        """Banks that must be free for a frame of lit pixels that comes without a pause.

        Dense chunks of wide codes come faster than eight bytes a clock can carry off; the rest
        waits in the banks. If there are not enough, such a frame has to come more slowly.
        """
        chunk = self.chunk(last=False)
        comes = chunk.beats
        goes = max(1 + chunk.groups, chunk.dense_bytes / 8 + 0.5)  # half a word is no word
        behind = self.chunks * max(0.0, goes - comes) / goes
        return min(self.banks, ceil(behind + WRITE_LATENCY / comes + 1))

    @property
    def least_banks(self) -> int:
        """Banks without which not even an empty frame can come without a pause."""
        return min(self.chunks, ceil(WRITE_LATENCY / self.chunk(last=False).beats + 1))

    @property
    def bank_groups(self) -> int:
        """Groups that a bank has addresses for."""
        return 1 << (self.run // GROUP - 1).bit_length()

    @property
    def hit_bits(self) -> int:
        """Width of a chunk's number of hits."""
        return self.run.bit_length()

    def codes_layout(self, count: int) -> data.ArrayLayout:
        """Return the layout of `count` codes side by side, the first in the low bits."""
        return data.ArrayLayout(self.code_bits, count)

    @property
    def beat_layout(self) -> data.StructLayout:
        """One clock of the sensor, once it is known what it ends."""
        return data.StructLayout(
            {
                "codes": self.codes_layout(self.lanes),
                "first": 1,  # beat of a frame
                "chunk_end": 1,
                "frame_end": 1,
                "abort": 1,  # no codes; what there is of the chunk is void
            }
        )

    @property
    def group_layout(self) -> data.StructLayout:
        """Eight codes in readout order."""
        return data.StructLayout(
            {
                "codes": self.codes_layout(GROUP),
                "chunk_end": 1,
                "frame_end": 1,
                "abort": 1,
            }
        )


@dataclass(frozen=True)
class ChunkFormat:
    """Sizes of one chunk.

    Parameters
    ----------
    pixels, code_bits, lanes : int
        As in `FrameFormat`.
    """

    pixels: int
    code_bits: int
    lanes: int

    @property
    def beats(self) -> int:
        """Clocks at the sensor port."""
        return -(-self.pixels // self.lanes)

    @property
    def groups(self) -> int:
        """Groups, the last one filled up with 0."""
        return -(-self.pixels // GROUP)

    @property
    def dense_from(self) -> int:
        """Hits from which on the chunk is sent dense."""
        return dense_from(self.pixels, self.code_bits)

    @property
    def dense_bytes(self) -> int:
        """Bytes of the chunk if it is sent dense, its chunk word included; it is never longer."""
        return CHUNK_WORD.size + dense_bytes(self.pixels, self.code_bits)

    @property
    def bitmap_bytes(self) -> int:
        """Bytes of the bitmap."""
        return -(-self.pixels // 8)


def tail_bytes(codes: int, code_bits: int, /) -> int:
    """Return the bytes that the last group of `codes` codes takes, 1 to `code_bits`."""
    left = (codes - 1) % GROUP + 1
    return -(-left * code_bits // 8)


INFO_LAYOUT = data.StructLayout(
    {
        "timestamp": 64,
        "frame": 64,
        "periods": 32,
        "dropped": 32,
        "flags": 16,
        "step": 16,
        "capture": 32,
    }
)
"""Fields of the frame header that change from frame to frame; sampled with the first beat."""
