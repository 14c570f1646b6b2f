# SPDX-License-Identifier: Apache-2.0
"""Sums in recordings: the tables that they were made with, and their totals."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import RecordingError
from hueflight.recording.reader import Recording
from hueflight_protocol import PacketParser, PictureAssembler, Sums, SumsPicture
from hueflight_protocol.errors import ProtocolError
from hueflight_protocol.reduction import MOST_SUM_BITS, ReductionTables, offsets_hash

ATTACHMENT = "sums_tables.npz"


@dataclass(frozen=True, eq=False)
class SumsDescription:
    """What the sums of a recording were made with.

    Attributes
    ----------
    tables : ReductionTables
        Tables of the reduction.
    offsets : ndarray of int, shape (row, col)
        Offset of each pixel in the tables, codes.
    middle_ns, reach_ns : float
        Delays that the tables are designed for, as `hueflight.reconstruction.SumsDesign` has them.
    """

    tables: ReductionTables
    offsets: NDArray[np.int64]
    middle_ns: float
    reach_ns: float

    def to_bytes(self) -> bytes:
        """Return the content of the attachment.

        Returns
        -------
        bytes
            An NPZ file.
        """
        file = io.BytesIO()
        np.savez_compressed(
            file,
            entries=self.tables.entries,
            widths=np.array(self.tables.widths, np.uint8),
            codes=np.array([self.tables.first, self.tables.last], np.uint16),
            offsets=self.offsets.astype(np.int8),
            delays_ns=np.array([self.middle_ns, self.reach_ns]),
        )
        return file.getvalue()

    @classmethod
    def from_bytes(cls, content: bytes, /, *, where: str) -> SumsDescription:
        """Read the attachment.

        Parameters
        ----------
        content : bytes
            Its content.
        where : str
            Where it stood, for errors.

        Returns
        -------
        SumsDescription
            What it says.

        Raises
        ------
        RecordingError
            If it is damaged.
        """
        try:
            with np.load(io.BytesIO(content), allow_pickle=False) as file:
                first, last = (int(code) for code in file["codes"])
                widths = tuple(int(width) for width in file["widths"])
                middle_ns, reach_ns = (float(delay) for delay in file["delays_ns"])
                tables = ReductionTables(file["entries"], widths, first, last)
                return cls(tables, file["offsets"].astype(np.int64), middle_ns, reach_ns)
        except (ValueError, KeyError, OSError, BadZipFile, ProtocolError) as error:
            raise RecordingError(f"{where}: {ATTACHMENT} can't be read: {error}") from None


@dataclass(frozen=True, eq=False)
class RecordedSums:
    """Totals of the sums of a recording.

    Attributes
    ----------
    values : ndarray of uint64, shape (row, col, sum)
        Totals over all pictures; the greatest value of 32 bits where a sum was saturated.
    frames : ndarray of int, shape (row, col)
        Frames behind them: fewer where a part of a picture is missing. They also differ where the
        camera ends the windows of a picture one after another.
    description : SumsDescription
        What the sums were made with; the widths are those of the totals, 32 bits.
    pictures : int
        Pictures of which at least a part is there.
    losses : dict of int
        Packets that are damaged or missing and frames that the camera could not add to the sums of
        some pixel, by kind, without those that are 0.
    """

    values: NDArray[np.uint64]
    frames: NDArray[np.int64]
    description: SumsDescription
    pictures: int
    losses: dict[str, int]


def holds_recorded_sums(recording: Recording, /) -> bool:
    """Tell whether a recording holds sums and the tables that they were made with.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    bool
        True if it does.
    """
    return ATTACHMENT in recording.info().attachments


class SumsTotal:
    """Adds up pictures of sums of one recording.

    Parameters
    ----------
    description : SumsDescription
        What the sums were made with.
    where : str
        Path of the recording, for errors.

    Attributes
    ----------
    pictures : int
        Pictures added so far.
    """

    def __init__(self, description: SumsDescription, /, *, where: str) -> None:
        tables, offsets = description.tables, description.offsets
        self._description, self._where = description, where
        self._stated = tables.hash, offsets_hash(offsets.reshape(-1)), tables.widths
        self._values = np.zeros((*offsets.shape, tables.sums), np.uint64)
        self._frames = np.zeros(offsets.shape, np.int64)
        self._missed = np.zeros(offsets.shape, np.int64)
        self._saturated = np.zeros(offsets.shape, bool)
        self.pictures = 0

    def add(self, picture: SumsPicture, /) -> None:
        """Add a picture.

        Parameters
        ----------
        picture : SumsPicture
            The picture, complete or not.

        Raises
        ------
        RecordingError
            If it has sums of other tables than those of the description.
        """
        first, tables = picture.first, self._description.tables
        if (first.tables, first.offsets, first.widths) != self._stated:
            raise RecordingError(
                f"{self._where}: picture {first.picture} has sums of other tables "
                f"({first.tables:#010x}) than those attached ({tables.hash:#010x})"
            )
        self.pictures += 1
        self._values += picture.values
        self._frames += picture.frames
        self._missed += picture.missed
        self._saturated[(picture.values == tables.limits).any(axis=-1)] = True

    def finish(self, *, damaged: int = 0, missing: int = 0) -> RecordedSums:
        """Return the totals so far, in arrays that later pictures do not change.

        Parameters
        ----------
        damaged, missing : int
            Packets of these pictures that were damaged or missing.

        Returns
        -------
        RecordedSums
            Totals.
        """
        made = self._description
        most = (1 << MOST_SUM_BITS) - 1
        values = np.minimum(self._values, most)
        values[self._saturated] = most
        widths = (MOST_SUM_BITS,) * made.tables.sums
        losses = {"damaged": damaged, "missing": missing, "dropped": int(self._missed.max())}
        return RecordedSums(
            values,
            self._frames.copy(),
            replace(made, tables=replace(made.tables, widths=widths)),
            self.pictures,
            {kind: count for kind, count in losses.items() if count},
        )


def describe_recorded_sums(recording: Recording, /) -> SumsDescription:
    """Return what the sums of a recording were made with.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    SumsDescription
        Tables, offsets and delays.

    Raises
    ------
    RecordingError
        If it holds no sums, or the description is damaged.
    """
    if not holds_recorded_sums(recording):
        raise RecordingError(f"{recording.path} holds no sums: it was recorded as codes")
    return SumsDescription.from_bytes(recording.attachment(ATTACHMENT), where=str(recording.path))


def read_sums(recording: Recording, /) -> RecordedSums:
    """Add up the sums of all pictures of a recording.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    RecordedSums
        Totals.

    Raises
    ------
    RecordingError
        If it holds no sums, or such that were made with other tables than those attached.
    """
    total = SumsTotal(describe_recorded_sums(recording), where=str(recording.path))
    parser = PacketParser(keep_damage=0)
    for picture in pictures_of(parser, recording.raw()):
        total.add(picture)
    return total.finish(damaged=parser.report.damaged, missing=parser.report.missing)


def pictures_of(parser: PacketParser, pieces: Iterable[bytes], /) -> Iterator[SumsPicture]:
    """Find the pictures of sums in a stream.

    Parameters
    ----------
    parser : PacketParser
        Finds the packets, and counts those that are damaged or missing.
    pieces : iterable of bytes
        The stream.

    Yields
    ------
    SumsPicture
        Each picture, complete or not.
    """
    assembler = PictureAssembler()
    for piece in pieces:
        for packet in parser.feed(piece):
            if isinstance(packet.content, Sums):
                picture = assembler.feed(packet.content)
                if picture is not None:
                    yield picture
    picture = assembler.finish()
    if picture is not None:
        yield picture
