# SPDX-License-Identifier: Apache-2.0
"""Finish, in place, the segments that a crash or an error of the disk has cut off."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path

from hueflight.errors import RecordingError
from hueflight.files import PARTIAL_SUFFIX, staged
from hueflight.ingest.report import IngestReport
from hueflight.model.instrument import Instrument
from hueflight.recording.layout import (
    OWN_NAMES,
    Description,
    segment_files,
    segment_path,
    split_segment_path,
)
from hueflight.recording.recovery import Examined, examine, stated_instrument, stream
from hueflight.recording.segment import Segment
from hueflight.recording.segment_reader import SegmentReader
from hueflight.recording.writer import RecordingWriter

_NO_LIMIT = 1 << 62


def finish_recording(path: str | Path, /) -> int:
    """Finish the unfinished segments of a recording that nobody writes any more.

    All intact packets are kept, as by `recover`, which copies the whole recording instead. An
    unfinished file is removed when the finished one is complete. A recording whose segments are
    all finished is left as it is.

    Parameters
    ----------
    path : str or Path
        Path of the recording's first file, such as ``run.mcap``.

    Returns
    -------
    int
        Number of segments that were finished.

    Raises
    ------
    RecordingError
        If a file holds nothing that can be saved, a segment before it is missing, or the finished
        file can't be written; unfinished files are left as they are.
    """
    path = Path(path)
    finished, unfinished = segment_files(path)
    numbers = [_number(each) for each in (*finished, *unfinished)]
    done = 0
    for part in unfinished:
        try:
            done += _finish(path, part, last=_number(part) == max(numbers))
        except OSError as error:
            raise RecordingError(f"can't finish {part}: {error.strerror or error}") from error
    return done


def _number(file: Path) -> int:
    return split_segment_path(file)[1]


def _finish(path: Path, part: Path, *, last: bool) -> bool:
    number = _number(part)
    whole = segment_path(path, number)
    for left in path.parent.glob(f".{whole.name}.*{PARTIAL_SUFFIX}"):
        shutil.rmtree(left, ignore_errors=True)
    if whole.exists():  # it was finished, and the program ended before it removed this file
        SegmentReader(whole).close()
        part.unlink()
        return False
    found = examine(part)
    instrument = stated_instrument([found])
    if instrument is None or found.description is None:
        raise RecordingError(
            f"{part}: its first records are lost: save its packets with 'hueflight recover'"
        )
    first, before = _before(path, number)
    with staged(whole) as target:
        writer = _SegmentWriter(target, instrument, found, first=first, last=last, before=before)
        with writer:
            for piece in stream(found):
                writer.write(piece)
    part.unlink()
    return True


def _before(path: Path, number: int) -> tuple[int, dict[str, int]]:
    """Frames and totals of the segments before one."""
    if number == 0:
        return 0, {}
    reader = SegmentReader(segment_path(path, number - 1))
    reader.close()
    return reader.closing.first + reader.closing.frames, reader.closing.report


class _SegmentWriter(RecordingWriter):
    """Writes one segment of a recording again."""

    def __init__(
        self,
        path: Path,
        instrument: Instrument,
        found: Examined,
        *,
        first: int,
        last: bool,
        before: dict[str, int],
    ) -> None:
        assert found.description is not None
        self._as_before: Description = found.description
        self._first, self._last, self._before = first, last, before
        super().__init__(
            path,
            instrument,
            attachments={
                name: data for name, data in found.attachments.items() if name not in OWN_NAMES
            },
            segment_bytes=_NO_LIMIT,
        )

    @property
    def report(self) -> IngestReport:
        """Totals of the whole stream up to the end of this segment."""
        own = super().report
        return IngestReport(
            **{
                each.name: getattr(own, each.name) + self._before.get(each.name, 0)
                for each in fields(IngestReport)
            }
        )

    def _start_segment(self) -> Segment:
        return Segment(
            self.path, self._as_before, self._instrument_json, self._attachments, first=self._first
        )

    def _finish_segment(self, *, last: bool) -> None:
        super()._finish_segment(last=last and self._last)
