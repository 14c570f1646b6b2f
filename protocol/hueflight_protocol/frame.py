# SPDX-License-Identifier: Apache-2.0
"""A decoded frame and what its packet's header says about it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .checksum import xor_words
from .errors import ProtocolError
from .wire import (
    DEFAULT_RUN,
    FRAME_HEADER,
    MAX_CHUNKS,
    MAX_CODE_BITS,
    MAX_COLS,
    MAX_ROWS,
    MAX_RUN,
    MIN_RUN,
    RUN_MULTIPLE,
    FrameFlags,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameHeader:
    """What the header of a frame packet says.

    Parameters
    ----------
    sequence : int
        Number of the packet since the device's reset, modulo 2**32.
    frame : int
        Number of the frame since the capture began; dropped frames count too.
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
        Frames the camera dropped whole since the capture began.
    geometry : int
        Identity of the sensor's geometry; 0 = not stated.
    flags : FrameFlags
        What the camera did to the frame.
    step : int
        Step marker of the illuminator.
    capture : int
        Label of the capture, as the host set it.
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
        unknown = self.flags & ~sum(FrameFlags)
        if unknown:
            raise ProtocolError(f"flags = {self.flags:#x}: bits {unknown:#x} have no meaning")
        if self.run % RUN_MULTIPLE:
            raise ProtocolError(f"run = {self.run}: must be a multiple of {RUN_MULTIPLE}")
        if self.chunks > MAX_CHUNKS:
            raise ProtocolError(
                f"run = {self.run}: {self.pixels} pixels make {self.chunks} chunks, "
                f"more than {MAX_CHUNKS}; choose a longer run"
            )

    @classmethod
    def from_wire(cls, values: Mapping[str, int], /) -> Self:
        """Return the header whose fields `FRAME_HEADER` has unpacked.

        Parameters
        ----------
        values : Mapping of str to int
            Fields by name.

        Returns
        -------
        FrameHeader
            The header.
        """
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
        """Return the header's 64 bytes.

        Returns
        -------
        bytes
            The header with its check word.
        """
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
