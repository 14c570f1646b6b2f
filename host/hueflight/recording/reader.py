# SPDX-License-Identifier: Apache-2.0
"""Reading recordings: any slice of frames or time, without reading the rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.arguments import PATH, takes
from hueflight.errors import RecordingError, RecordingNotFoundError
from hueflight.ingest import kernels as backends
from hueflight.ingest.accumulate import checked_threads, frames_by_step
from hueflight.ingest.accumulator import Counts, HistogramAccumulator
from hueflight.ingest.buffer import BUFFER_BYTES, LEAST_BYTES, PacketBuffer
from hueflight.ingest.kernels import STATE, Kernels
from hueflight.ingest.report import IngestReport
from hueflight.model.instrument import Instrument
from hueflight.recording.layout import INSTRUMENT, OWN_NAMES, part_path, segment_files
from hueflight.recording.segment_reader import SegmentReader
from hueflight_protocol.wire import FRAME_HEADER


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingInfo:
    """Facts about a recording that are known without counting photons.

    Parameters
    ----------
    path : str
        Path of the first file.
    segments : int
        Number of files.
    complete : bool
        True if the recording was ended, so that no segment can be missing at its end.
    instrument : str
        Name of the instrument.
    started : str
        Time at which the recording started, ISO 8601 in UTC.
    frames : int
        Number of frames.
    size : int
        Bytes of all files together.
    seconds : float or None
        Time from the first to the last frame by the device clock; None if the packets state no
        clock rate, or one of the last ones is damaged.
    metadata : dict of str
        Notes of the user about the capture.
    attachments : tuple of str
        Names of the user's attachments.
    report : dict of int
        Totals of the stream when the last segment was finished.
    """

    path: str
    segments: int
    complete: bool
    instrument: str
    started: str
    frames: int
    size: int
    seconds: float | None
    metadata: dict[str, str]
    attachments: tuple[str, ...]
    report: dict[str, int]

    def as_dict(self) -> dict[str, Any]:
        """Return all facts as a dictionary, ready for JSON.

        Returns
        -------
        dict
            Facts by name.
        """
        return asdict(self)


class Recording:
    """A finished recording, as `open_recording` returns it.

    Frames are numbered from 0, in the order in which they arrived, whatever their numbers in the
    camera.

    Parameters
    ----------
    path : Path
        First file.
    segments : list of SegmentReader
        Open segments in order.
    kernels : Kernels or None
        Kernels that count photons; None for the fastest available.

    Attributes
    ----------
    instrument : Instrument
        Instrument that took the recording.
    metadata : dict of str
        Notes of the user about the capture.
    frames : int
        Number of frames.
    """

    def __init__(self, path: Path, segments: list[SegmentReader], kernels: Kernels | None) -> None:
        self.path = path
        self._segments = segments
        self._kernels = kernels or backends.choose()
        first = segments[0]
        self.instrument = Instrument.from_json(first.attachment(INSTRUMENT), where=str(path))
        self.metadata = dict(first.description.metadata)
        self.frames = sum(segment.closing.frames for segment in segments)
        # every chunk of every file, in order; `file` says which
        self._index = np.concatenate([segment.index for segment in segments])
        self._index["first"] -= first.closing.first  # a later segment may be opened alone
        counts = [len(segment.index) for segment in segments]
        self._file = np.repeat(np.arange(len(segments)), counts)

    # -- public interface --------------------------------------------------------------------------

    def histogram(self, start: int = 0, stop: int | None = None, *, threads: int = 1) -> Counts:
        """Return the histogram of a slice of frames.

        Parameters
        ----------
        start : int
            First frame. See `frame_at` for slices of time.
        stop : int, optional
            Frame after the last one; by default the end of the recording.
        threads : int
            Threads over pixels.

        Returns
        -------
        array of uint16 or uint32, shape (row, col, code)
            Counts of each pixel.

        Raises
        ------
        RecordingError
            If there are no such frames, or the files can't be read.
        """
        return self.accumulate(start, stop, threads=threads)[0]

    def histograms_by_step(
        self, start: int = 0, stop: int | None = None, *, threads: int = 1
    ) -> Counts:
        """Return one histogram for each step of the illuminator, such as one LED at a time.

        Parameters
        ----------
        start : int
            First frame.
        stop : int, optional
            Frame after the last one; by default the end of the recording.
        threads : int
            Threads over pixels.

        Returns
        -------
        array of uint16 or uint32, shape (step, row, col, code)
            Counts in rising order of the steps that occur.

        Raises
        ------
        RecordingError
            If there are no such frames, or the files can't be read.
        """
        by_step, _ = self.accumulate_by_step(start, stop, threads=threads)
        if not by_step:
            return np.zeros((0, *self.instrument.histogram_shape), np.uint16)
        return np.stack(list(by_step.values()))

    def accumulate(
        self, start: int = 0, stop: int | None = None, *, threads: int = 1
    ) -> tuple[Counts, IngestReport]:
        """Return the histogram of a slice of frames and the totals of its stream.

        Parameters
        ----------
        start : int
            First frame.
        stop : int, optional
            Frame after the last one; by default the end of the recording.
        threads : int
            Threads over pixels.

        Returns
        -------
        tuple of (array of uint16 or uint32, shape (row, col, code), IngestReport)
            Counts of each pixel, and packets that were intact, damaged or missing.

        Raises
        ------
        RecordingError
            If there are no such frames, or the files can't be read.
        """
        tables, report = self._count(start, stop, by_step=False, threads=threads)
        return tables[0], report

    def accumulate_by_step(
        self, start: int = 0, stop: int | None = None, *, threads: int = 1
    ) -> tuple[dict[int, Counts], IngestReport]:
        """Return the histograms of a slice of frames by step, and the totals of its stream.

        Parameters
        ----------
        start : int
            First frame.
        stop : int, optional
            Frame after the last one; by default the end of the recording.
        threads : int
            Threads over pixels.

        Returns
        -------
        tuple of (dict of int to array, shape (row, col, code), IngestReport)
            Counts by step of the illuminator, and packets that were intact, damaged or missing.

        Raises
        ------
        RecordingError
            If there are no such frames, or the files can't be read.
        """
        return self._count(start, stop, by_step=True, threads=threads)

    def packets(self, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Iterate over the frame packets of a slice.

        Parameters
        ----------
        start : int
            First frame.
        stop : int, optional
            Frame after the last one; by default the end of the recording.

        Yields
        ------
        bytes
            A packet exactly as received.

        Raises
        ------
        RecordingError
            If there are no such frames, or the files can't be read.
        """
        for buffer in self._frames(*self._checked(start, stop)):
            places = buffer.scanner.places[: buffer.scanner.frames].tolist()
            yield from (bytes(buffer.data[offset : offset + size]) for offset, size in places)

    @property
    def chunks(self) -> NDArray[np.void]:
        """Place, frames and time of each chunk, as `hueflight.recording.layout.FRAME_INDEX`."""
        return self._index

    def segment_of(self, chunk: int, /) -> int:
        """Return the number of the file that holds a chunk.

        Parameters
        ----------
        chunk : int
            Number of the chunk.

        Returns
        -------
        int
            Number of the file, from 0.
        """
        return int(self._file[chunk])

    def raw(self, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Iterate over everything that was received: all packets, and the bytes between them.

        Parameters
        ----------
        start : int
            First chunk.
        stop : int, optional
            Chunk after the last one; by default the end of the recording.

        Yields
        ------
        bytes
            The next piece of the stream, a chunk.
        """
        for entry, file in zip(self._index[start:stop], self._file[start:stop], strict=True):
            yield self._segments[file].read(int(entry["offset"]), int(entry["size"]))

    def beginning(self, chunk: int, size: int, /) -> bytes:
        """Return the first bytes of a chunk.

        Parameters
        ----------
        chunk : int
            Number of the chunk.
        size : int
            Number of bytes, at most.

        Returns
        -------
        bytes
            The bytes; fewer if the chunk is shorter.
        """
        entry = self._index[chunk]
        file = self._segments[self._file[chunk]]
        return file.read(int(entry["offset"]), min(size, int(entry["size"])))

    def frame_at(self, seconds: float, /) -> int:
        """Return the first frame that began at a given time.

        Parameters
        ----------
        seconds : float
            Time since the start of the first frame, by the device clock.

        Returns
        -------
        int
            Number of the frame.

        Raises
        ------
        RecordingError
            If the packets state no clock rate, or the clock was set back in the recording.
        """
        ticks, clock_hz = self._clock()
        due = int(ticks[0]) + round(seconds * clock_hz)
        chunks = self._index[self._index["frames"] > 0]
        chunk = max(int(np.searchsorted(ticks, due)) - 1, 0)
        first, frames = int(chunks["first"][chunk]), int(chunks["frames"][chunk])
        heads = b"".join(p[: FRAME_HEADER.size] for p in self.packets(first, first + frames))
        inside = np.frombuffer(heads, FRAME_HEADER.dtype)["timestamp"]
        return first + int(np.searchsorted(inside, due))

    def attachment(self, name: str, /) -> bytes:
        """Return the content of an attachment, such as a calibration.

        Parameters
        ----------
        name : str
            Name of the attachment.

        Returns
        -------
        bytes
            Its content.

        Raises
        ------
        RecordingError
            If there is no such attachment, or it is damaged.
        """
        return self._segments[0].attachment(name)

    def info(self) -> RecordingInfo:
        """Return the facts that are known without counting photons.

        Returns
        -------
        RecordingInfo
            Facts about the recording.
        """
        first, last = self._segments[0], self._segments[-1]
        return RecordingInfo(
            path=str(self.path),
            segments=len(self._segments),
            complete=last.closing.last,
            instrument=self.instrument.name,
            started=first.description.started,
            frames=self.frames,
            size=sum(segment.size for segment in self._segments),
            seconds=self._seconds(),
            metadata=self.metadata,
            attachments=tuple(name for name in first.attachments if name not in OWN_NAMES),
            report=last.closing.report,
        )

    def close(self) -> None:
        """Close all files."""
        for segment in self._segments:
            segment.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # -- frames ------------------------------------------------------------------------------------

    def _checked(self, start: int, stop: int | None) -> tuple[int, int]:
        end = self.frames if stop is None else stop
        if not 0 <= start <= end <= self.frames:
            raise RecordingError(
                f"frames {start} to {end}: {self.path} has frames 0 to {self.frames}"
            )
        return start, end

    def _count(
        self, start: int, stop: int | None, *, by_step: bool, threads: int
    ) -> tuple[dict[int, Counts], IngestReport]:
        accumulators: dict[int, HistogramAccumulator] = {}

        def accumulator(step: int) -> HistogramAccumulator:
            if step not in accumulators:
                accumulators[step] = HistogramAccumulator(
                    *self.instrument.image_shape,
                    self.instrument.sensor.code_bits,
                    kernels=self._kernels,
                    overflow="widen",
                    threads=checked_threads(threads),
                )
            return accumulators[step]

        report = IngestReport()
        for buffer in self._frames(*self._checked(start, stop)):
            for step, position, chosen in frames_by_step(buffer.scanner):
                first_row = position * self.instrument.sensor.rows
                accumulator(step if by_step else 0).add(
                    buffer.data, buffer.scanner, chosen, first_row=first_row
                )
            photons = sum(each.photons for each in accumulators.values())
            report = IngestReport.from_state(buffer.scanner.state, photons=photons)
        if not by_step:
            accumulator(0)
        return {step: accumulators[step].finish() for step in sorted(accumulators)}, report

    def _frames(self, start: int, stop: int) -> Iterator[PacketBuffer]:
        """Bring frames to hand, as many at a time as fit; the totals are those of the slice."""
        if start == stop:
            return
        index = self._index
        begin = int(np.searchsorted(index["first"], start, side="right")) - 1
        end = int(np.searchsorted(index["first"], stop))
        capacity = max(BUFFER_BYTES, int(index["size"][begin:end].max()) + LEAST_BYTES)
        buffer = PacketBuffer(self.instrument.sensor, self._kernels, capacity=capacity)
        scanner = buffer.scanner
        for name in ("sequence", "has_sequence"):
            scanner.state[STATE.index(name)] = index[name][begin]
        for chunk in range(begin, end):
            first, frames = int(index["first"][chunk]), int(index["frames"][chunk])
            if int(index["size"][chunk]) > buffer.room and scanner.frames:
                yield buffer
                buffer.release()
            self._read_chunk(buffer, chunk)
            if start > first:
                self._skip(buffer, start - first)
            wanted = min(stop - first, frames) - max(start - first, 0)
            while True:
                before = scanner.frames
                limit = min(before + wanted, scanner.limit) if stop < first + frames else None
                ended = buffer.scan(limit=limit or scanner.limit)
                wanted -= scanner.frames - before
                done = ended or (limit is not None and not wanted)
                if not done or (done and chunk == end - 1):
                    yield buffer
                    buffer.release()
                if done:
                    break

    def _read_chunk(self, buffer: PacketBuffer, chunk: int) -> None:
        size = int(self._index["size"][chunk])
        segment = self._segments[self._file[chunk]]
        segment.read_into(buffer.writable()[:size], int(self._index["offset"][chunk]))
        buffer.commit(size)

    @staticmethod
    def _skip(buffer: PacketBuffer, frames: int) -> None:
        """Pass over frames that come before the slice, and forget what they brought."""
        scanner = buffer.scanner
        while frames:
            ended = buffer.scan(limit=min(frames, scanner.limit))
            frames -= scanner.frames
            buffer.release()
            if ended:
                break
        scanner.reset_totals()

    # -- time --------------------------------------------------------------------------------------

    def _clock(self) -> tuple[NDArray[np.int64], int]:
        """Device clock at the first frame of each chunk that has frames, and its rate."""
        chunks = self._index[self._index["frames"] > 0]
        ticks = chunks["tick"].astype(np.int64)
        rates = np.unique(chunks["clock_hz"]).tolist()
        if len(rates) != 1 or not rates[0]:
            raise RecordingError(
                f"{self.path}: the packets state {'no' if not any(rates) else 'several'} clock "
                "rates: slice by frames"
            )
        if (np.diff(ticks) < 0).any():
            raise RecordingError(f"{self.path}: the device clock was set back: slice by frames")
        return ticks, rates[0]

    def _seconds(self) -> float | None:
        try:
            ticks, clock_hz = self._clock()
        except RecordingError:
            return None
        last = next(self.packets(self.frames - 1, self.frames), None)
        if last is None:  # a packet of the last chunk is damaged
            return None
        return (FRAME_HEADER.unpack(last)["timestamp"] - int(ticks[0])) / clock_hz


@takes(path=PATH)
def open_recording(path: str | Path, /, *, kernels: Kernels | None = None) -> Recording:
    """Open a recording, with all segments that belong to it.

    Parameters
    ----------
    path : str or Path
        Path of the first file, such as ``run.mcap``. The path of a later segment opens that segment
        alone.
    kernels : Kernels, optional
        Kernels that count photons; by default the fastest available.

    Returns
    -------
    Recording
        The open recording, which is also a context manager.

    Raises
    ------
    RecordingError
        If there is no such file, it is not a recording, it was not finished, or a segment between
        others is missing.
    """
    path = Path(path)
    finished, unfinished = segment_files(path)
    if path not in finished:
        if part_path(path) in unfinished:
            raise RecordingError(
                f"{path} was not finished: save its intact packets with: hueflight recover {path}"
            )
        raise RecordingNotFoundError(f"there is no recording {str(path)!r}")
    segments: list[SegmentReader] = []
    try:
        for number, file in enumerate(finished):
            segments.append(SegmentReader(file))
            here, first = segments[-1].description, segments[0].description
            if here.recording != first.recording:
                raise RecordingError(
                    f"{file} does not belong to the recording {path}: move it to another folder"
                )
            if here.segment != first.segment + number:
                raise RecordingError(
                    f"{path}: segment {first.segment + number} is missing before {file.name}; "
                    "try recover"
                )
        return Recording(path, segments, kernels)
    except BaseException:
        for segment in segments:
            segment.close()
        raise
