# SPDX-License-Identifier: Apache-2.0
"""Reduction of codes to sums in the emulated camera, by the definition that gateware follows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hueflight.emulation.frame_template import Template, empty_headers, stamp_all
from hueflight.ingest import kernels as backends
from hueflight.ingest.accumulator import HistogramAccumulator
from hueflight.ingest.scanner import Scanner, batches
from hueflight.model.instrument import Sensor
from hueflight_protocol import FrameFlags, PacketHeader, ReductionMode, RegisterFile, Sums
from hueflight_protocol.reduction import MOST_SUMS, ReductionTables, reduce_histogram
from hueflight_protocol.sums_packet import pack_sums
from hueflight_protocol.typed_registers import camera as registers
from hueflight_protocol.wire import FRAME_HEADER, SUMS_BODY

PART_BITS = 1 << 19  #: of the sums in one packet, about, so that a lost one costs few pixels


class ReductionMemory:
    """Tables and offsets of the camera, which keep their content from run to run.

    Parameters
    ----------
    sensor : Sensor
        Geometry and code width.

    Attributes
    ----------
    entries : ndarray of uint16, shape (sum, code)
        Tables.
    offsets : ndarray of int8, shape (pixel,)
        Offset of each pixel.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.entries = np.zeros((MOST_SUMS, 1 << sensor.code_bits), np.uint16)
        self.offsets = np.zeros(sensor.rows * sensor.cols, np.int8)

    def store_entries(self, file: RegisterFile, code: int) -> None:
        """Store the entries of one code.

        Parameters
        ----------
        file : RegisterFile
            Registers of the camera, which hold them.
        code : int
            The code; one that the sensor does not have is left alone.
        """
        if code < self.entries.shape[1]:
            words = _words(file, registers.ReductionEntries.NAME, MOST_SUMS // 2)
            self.entries[:, code] = words.view("<u2")

    def store_offsets(self, file: RegisterFile, group: int) -> None:
        """Store the offsets of one group of pixels.

        Parameters
        ----------
        file : RegisterFile
            Registers of the camera, which hold them.
        group : int
            The group; what lies beyond the sensor is left alone.
        """
        size = file.load(registers.ReductionRoom).group
        here = self.offsets[group * size : (group + 1) * size]
        here[:] = _words(file, registers.ReductionOffsets.NAME, size // 4).view("i1")[: here.size]


class PictureReduction:
    """Gathers the frames of a run to pictures of sums.

    Parameters
    ----------
    sensor : Sensor
        Geometry and code width.
    file : RegisterFile
        Registers of the camera, as they are when the run begins.
    memory : ReductionMemory
        Tables and offsets.
    keep : int
        Whole pictures that are kept and sent in turn, so that a camera that repeats frames takes
        little time; 0 to add up each picture.

    Attributes
    ----------
    with_codes : bool
        True if codes are sent as well.
    """

    def __init__(
        self, sensor: Sensor, file: RegisterFile, memory: ReductionMemory, *, keep: int = 0
    ) -> None:
        self._keep = keep
        self._kept: list[list[bytes]] = []
        self._waiting: list[Template] = []  # of a picture that may be a kept one
        chosen, codes = file.load(registers.Reduction), file.load(registers.ReductionCodes)
        self.with_codes = chosen.mode == ReductionMode.BOTH
        widths = _words(file, registers.ReductionWidth.NAME, chosen.sums)
        entries = memory.entries[: chosen.sums].copy()
        entries[:, : codes.first] = entries[:, codes.last + 1 :] = 0
        self._tables = ReductionTables(entries, tuple(widths.tolist()), codes.first, codes.last)
        self._offsets = memory.offsets.astype(np.intp)
        self._stated = {
            "tables": file.load(registers.ReductionTables).value,
            "offsets": file.load(registers.ReductionMoved).value,
            "rows": sensor.rows, "cols": sensor.cols, "code_bits": sensor.code_bits,
            "widths": self._tables.widths,
        }  # fmt: skip
        self._sensor = sensor
        self._frames_wanted = max(1, file.load(registers.ReductionFrames).value)
        self._rows = max(1, PART_BITS // (sensor.cols * sum(self._tables.widths)))
        self._kernels = backends.choose()
        self._scanner = Scanner(sensor, self._kernels)
        self._number = 0
        self._begin()

    @classmethod
    def of(
        cls, sensor: Sensor, file: RegisterFile, memory: ReductionMemory, *, keep: int = 0
    ) -> PictureReduction | None:
        """Return the reduction that the registers ask for.

        Parameters
        ----------
        sensor : Sensor
            Geometry and code width.
        file : RegisterFile
            Registers of the camera.
        memory : ReductionMemory
            Tables and offsets.
        keep : int
            Whole pictures that are kept and sent in turn; 0 to add up each picture.

        Returns
        -------
        PictureReduction or None
            None if only codes are sent.
        """
        chosen = file.load(registers.Reduction)
        if chosen.mode not in (ReductionMode.SUMS, ReductionMode.BOTH) or not chosen.sums:
            return None
        return cls(sensor, file, memory, keep=keep)

    def _begin(self) -> None:
        self._frames = self._missed = 0
        self._flags, self._periods = FrameFlags.NONE, 1
        sensor = self._sensor
        self._counts = HistogramAccumulator(
            sensor.rows, sensor.cols, sensor.code_bits, kernels=self._kernels, overflow="widen"
        )

    @property
    def bytes(self) -> int:
        """Bytes of a picture, about."""
        pixels = self._sensor.rows * self._sensor.cols
        parts = -(-self._sensor.rows // self._rows)
        return pixels * sum(self._tables.widths) // 8 + 256 * parts

    @property
    def frames_left(self) -> int:
        """Frames until the picture is over."""
        return self._frames_wanted - self._frames

    def add(self, templates: Sequence[Template], /) -> None:
        """Add frames to the picture.

        Parameters
        ----------
        templates : sequence of Template
            The frames, after mask, region and gate.
        """
        self._frames += len(templates)
        if self._keep and len(self._kept) == self._keep:
            self._waiting += templates
        elif templates:
            self._count(templates)

    def _count(self, templates: Sequence[Template]) -> None:
        numbers = empty_headers(len(templates))
        numbers["sequence"] = numbers["frame"] = np.arange(len(templates))
        for data in batches(self._scanner, stamp_all(templates, numbers)):
            every = np.arange(self._scanner.frames, dtype=np.uint32)
            self._counts.add(data, self._scanner, every)
            headers = self._scanner.headers[: every.size].view(FRAME_HEADER.dtype)
            self._flags |= FrameFlags(int(np.bitwise_or.reduce(headers["flags"], axis=None)))
            self._periods = int(headers["periods"][-1, 0])

    def miss(self, frames: int, /) -> None:
        """Note frames that come and can't be added, because there is no room for a picture.

        Parameters
        ----------
        frames : int
            Number of frames.
        """
        self._missed += frames

    def bodies(self) -> list[bytes]:
        """End the picture, if a frame came since the one before, gathered or missed.

        Returns
        -------
        list of bytes
            Bodies of its packets.
        """
        if not self._frames and not self._missed:
            return []
        whole = self._frames == self._frames_wanted
        if self._waiting and whole:
            numbers = {"picture": self._number, "missed": self._missed}
            found = [_numbered(body, numbers) for body in self._kept[self._number % self._keep]]
        else:
            if self._waiting:
                self._count(self._waiting)
            found = [pack_sums(part) for part in self._parts()]
            if whole and len(self._kept) < self._keep:
                self._kept.append(found)
        self._waiting = []
        self._number += 1
        self._begin()
        return found

    def _parts(self) -> Iterator[Sums]:
        counts = self._counts.finish()
        flat = counts.reshape(-1, counts.shape[-1])
        values = reduce_histogram(flat, self._tables, offsets=self._offsets).astype(np.uint32)
        timed = flat[:, self._tables.first : self._tables.last + 1]
        about = self._stated | {
            "picture": self._number, "frames": self._frames, "missed": self._missed,
            "flags": self._flags,
            "periods": self._periods,
        }  # fmt: skip
        photons = timed.sum(axis=1, dtype=np.uint64)
        step = self._rows * self._sensor.cols
        for first in range(0, len(values), step):
            yield Sums(
                header=PacketHeader(sequence=0), values=values[first : first + step],
                first_pixel=first, photons=int(photons[first : first + step].sum()), **about,
            )  # fmt: skip


def _numbered(body: bytes, numbers: dict[str, int]) -> bytes:
    """The body of a packet of sums with other numbers."""
    head = SUMS_BODY.unpack(body[: SUMS_BODY.size]) | numbers
    return SUMS_BODY.pack(head) + body[SUMS_BODY.size :]


def _words(file: RegisterFile, name: str, count: int) -> NDArray[np.uint32]:
    """First elements of an array of registers."""
    return np.array([file.get(name, number) for number in range(count)], "<u4")
