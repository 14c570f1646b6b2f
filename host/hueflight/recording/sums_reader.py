# SPDX-License-Identifier: Apache-2.0
"""Pictures of sums in a recording, any of them without reading the rest."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

import numpy as np

from hueflight.errors import RecordingError
from hueflight.recording.reader import Recording
from hueflight.recording.recorded_sums import (
    RecordedSums,
    SumsTotal,
    describe_recorded_sums,
    pictures_of,
)
from hueflight_protocol import PacketParser, Sums, SumsPicture

CLOCK = "clock_hz"  #: note with the rate of the device clock, which packets of sums do not state
KEPT_BYTES = 128 << 20  #: of the pictures that were read last, which are not read again
_BEGINNING = 4096  # bytes of a chunk in which its first packet of sums is looked for first


class SumsReader:
    """Reads pictures of sums by their number, which counts from 0.

    Pictures of which nothing arrived count as well, as far as the numbers in the packets tell, so
    that the number goes on with time. Only the first packet of each chunk is read beforehand, and
    all packets of the last chunk and of those in which the camera began anew.

    Parameters
    ----------
    recording : Recording
        Open recording of sums.

    Attributes
    ----------
    description : SumsDescription
        What the sums were made with.
    pictures : int
        Number of pictures.
    picture_frames : int
        Frames of a picture: the median of those that were looked at.
    seconds : float
        Time from the first picture to the last, by the device clock if its rate is in the metadata
        and it was not set back, otherwise by the host's.

    Raises
    ------
    RecordingError
        If the recording holds no sums, or can't be read.
    """

    def __init__(self, recording: Recording, /) -> None:
        self._recording = recording
        self._kept: dict[int, SumsPicture | None] = {}  # None: nothing of it arrived
        self.description = describe_recorded_sums(recording)
        places: list[tuple[int, int]] = []  # chunks with sums, and their first picture
        ticks: list[int] = []
        frames: list[int] = []
        number, before = 0, None
        for chunk, heads in self._heads():
            for place, head in enumerate(heads):
                number += 0 if before is None else _steps(before, head)
                frames.append(head.frames)
                before = head
                ticks.append(head.header.timestamp)
                if not place:
                    places.append((chunk, number))
        self._chunks, self._firsts = np.array(places, np.int64).reshape(-1, 2).T
        self.pictures = 0 if before is None else number + 1
        self.picture_frames = sorted(frames)[len(frames) // 2] if frames else 0
        self.seconds = self._seconds(ticks)

    def read(self, start: int, stop: int, /) -> RecordedSums:
        """Add up pictures.

        Parameters
        ----------
        start, stop : int
            First picture, and the picture after the last one.

        Returns
        -------
        RecordedSums
            Totals.

        Raises
        ------
        RecordingError
            If there are no such pictures, or they can't be read.
        """
        total = SumsTotal(self.description, where=str(self._recording.path))
        self.add_to(total, start, stop)
        return total.finish()

    def add_to(self, total: SumsTotal, start: int, stop: int, /) -> None:
        """Add pictures to a total.

        Parameters
        ----------
        total : SumsTotal
            Total to which they are added.
        start, stop : int
            First picture, and the picture after the last one.

        Raises
        ------
        RecordingError
            If there are no such pictures, or they can't be read.
        """
        if not 0 <= start <= stop <= self.pictures:
            raise RecordingError(
                f"pictures {start} to {stop}: {self._recording.path} has pictures 0 to "
                f"{self.pictures}"
            )
        number = start
        while number < stop:
            if number in self._kept:
                picture = self._kept[number]
                number += 1
                if picture is not None:
                    total.add(picture)
                continue
            end = next((each for each in range(number, stop) if each in self._kept), stop)
            for found, picture in self._pictures(number, end):
                self._keep(number, found, picture)
                number = found + 1
                total.add(picture)
            self._keep(number, end, None)
            number = end

    def chunk_of(self, number: int, /) -> int:
        """Return the chunk that holds the last packet of a picture.

        Parameters
        ----------
        number : int
            Number of the picture.

        Returns
        -------
        int
            Number of the chunk.
        """
        return int(self._chunks[np.searchsorted(self._firsts, number, side="right") - 1])

    def _keep(self, start: int, number: int, picture: SumsPicture | None) -> None:
        """Keep a picture, and that there are none from `start` to before it; forget older ones."""
        self._kept |= dict.fromkeys(range(start, number))
        if picture is not None:
            self._kept[number] = picture
            most = max(1, KEPT_BYTES // picture.values.nbytes)
            while len(self._kept) > most:
                del self._kept[next(iter(self._kept))]

    def _pictures(self, start: int, stop: int) -> Iterator[tuple[int, SumsPicture]]:
        """Number and content of the pictures of which anything arrived."""
        begin = max(int(np.searchsorted(self._firsts, start)) - 1, 0)
        end = int(np.searchsorted(self._firsts, stop)) - 1
        pieces = self._recording.raw(int(self._chunks[begin]), int(self._chunks[end]) + 1)
        number, before = 0, None
        for picture in pictures_of(PacketParser(keep_damage=0), pieces):
            here = picture.first
            number = int(self._firsts[begin]) if before is None else number + _steps(before, here)
            before = here
            if number >= stop:
                return
            if number >= start:
                yield number, picture

    def _heads(self) -> Iterator[tuple[int, list[Sums]]]:
        """The first packet of sums in each chunk, or one of each picture where that is needed."""
        chunks = len(self._recording.chunks)
        here = self._first(0) if chunks else None
        for chunk in range(chunks):
            after = self._first(chunk + 1) if chunk + 1 < chunks else None
            if after is not None and here is not None and _goes_on(here, after):
                yield chunk, [here]
            else:
                yield chunk, self._all(chunk)
            here = after

    def _first(self, chunk: int) -> Sums | None:
        """The first packet of sums in a chunk."""
        size, whole = _BEGINNING, int(self._recording.chunks["size"][chunk])
        while True:
            for packet in PacketParser(keep_damage=0).feed(self._recording.beginning(chunk, size)):
                if isinstance(packet.content, Sums):
                    return packet.content
            if size >= whole:
                return None
            size *= 8

    def _all(self, chunk: int) -> list[Sums]:
        pieces = self._recording.raw(chunk, chunk + 1)
        return [each.first for each in pictures_of(PacketParser(keep_damage=0), pieces)]

    def _seconds(self, ticks: list[int]) -> float:
        rate = self._recording.metadata.get(CLOCK, "")
        if rate.isdigit() and int(rate) and (np.diff(np.array(ticks, np.int64)) >= 0).all():
            return (ticks[-1] - ticks[0]) / int(rate) if ticks else 0.0
        times = self._recording.chunks["log_time"]
        began_s = datetime.fromisoformat(self._recording.info().started).timestamp()
        return max(float(times[-1]) * 1e-9 - began_s, 0.0) if len(times) else 0.0


def _goes_on(before: Sums, here: Sums) -> bool:
    """Whether a packet comes from the same or a later picture of the same capture."""
    same = before.header.capture == here.header.capture
    return same and (here.picture - before.picture) % (1 << 32) < 1 << 31


def _steps(before: Sums, here: Sums) -> int:
    """Pictures from one packet to a later one; 1 where the camera has begun anew."""
    return (here.picture - before.picture) % (1 << 32) if _goes_on(before, here) else 1
