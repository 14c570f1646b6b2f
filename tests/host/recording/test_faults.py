# SPDX-License-Identifier: Apache-2.0
"""Full disks, bad disks, short writes: said at once, nothing written is lost, books are kept."""

import errno
import os
import resource
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hueflight.errors import RecordingError
from hueflight.recording import Outcome, RecordingWriter, open_recording, recover

Make = Callable[..., Any]


class Disk:
    """Stands before `os.writev`: writes a few bytes at a time, and fails where it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room: float = float("inf")
        self.most_at_once = 1 << 30
        self.error = errno.ENOSPC
        self._plain = os.writev
        monkeypatch.setattr(os, "writev", self.writev)

    def writev(self, fd: int, parts: list[memoryview]) -> int:
        whole = b"".join(parts)
        size = int(min(len(whole), self.most_at_once, self.room))
        if whole and not size:
            raise OSError(self.error, os.strerror(self.error))
        self.room -= size
        return self._plain(fd, [whole[:size]])


def write_all(writer: RecordingWriter, packets: list[bytes]) -> None:
    for packet in packets:
        writer.write(packet)


def write_and_wait(writer: RecordingWriter, packets: list[bytes]) -> None:
    """Write packets, and let each wait for the disk end before the next one."""
    for packet in packets:
        writer.write(packet)
        writer.flush()
        if writer._settling is not None:
            writer._settling.wait()


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


def test_short_writes_are_completed(disk: Disk, recorded: Make) -> None:
    disk.most_at_once = 7
    path, packets = recorded(chunk_bytes=700)
    with open_recording(path) as recording:
        assert list(recording.packets()) == packets


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("room", [0, 1, 100, 5000])
def test_a_disk_that_fills_up(
    error: int, room: int, disk: Disk, tmp_path: Path, small: Make, frames: Make
) -> None:
    packets = frames(200)
    disk.error = error
    writer = RecordingWriter(tmp_path / "run.mcap", small(), chunk_bytes=700)
    write_all(writer, packets[:50])
    writer.flush()
    disk.room = room
    told: list[RecordingError] = []
    for packet in packets[50:]:
        try:
            writer.write(packet)
        except RecordingError as problem:
            told.append(problem)
    assert len(told) == 1
    assert os.strerror(error) in str(told[0])
    assert f"{writer.frames} frames before it are kept" in str(told[0])
    assert writer.error is not None
    assert writer.report.frames == 200  # the books go on
    assert writer.frames >= 50
    writer.close()
    assert writer.frames + writer.lost_frames == 200
    assert writer.size + writer.lost_bytes == sum(map(len, packets))
    result = recover_on_another_disk(disk, tmp_path)
    with open_recording(result) as recording:
        assert list(recording.packets()) == packets[: writer.frames]


def recover_on_another_disk(disk: Disk, folder: Path) -> Path:
    disk.room = float("inf")
    result = recover(folder / "run.mcap", folder / "out.mcap")
    assert result.outcome == Outcome.WHOLE
    assert result.path is not None
    return result.path


def test_going_on_when_there_is_room_again(
    disk: Disk, tmp_path: Path, small: Make, frames: Make
) -> None:
    packets = frames(90)
    with RecordingWriter(tmp_path / "run.mcap", small(), chunk_bytes=300) as writer:
        write_all(writer, packets[:30])
        writer.flush()
        disk.room = 0
        with pytest.raises(RecordingError, match="No space left"):
            write_all(writer, packets[30:60])
        with pytest.raises(RecordingError, match=r"can't continue .*: No space left"):
            writer.resume()
        kept = writer.frames
        writer.flush()
        disk.room = float("inf")
        writer.resume()
        assert writer.error is None
        write_all(writer, packets[60:])
    lost = writer.lost_frames
    assert lost > 0
    result = recover(tmp_path / "run.mcap")
    assert result.path is not None
    with open_recording(result.path) as recording:
        assert list(recording.packets()) == packets[:kept] + packets[60:]


def test_no_room_for_the_end(disk: Disk, tmp_path: Path, small: Make, frames: Make) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", small())
    write_all(writer, frames(20))
    writer.flush()
    disk.room = 10
    with pytest.raises(RecordingError, match=r"No space left.* 20 frames before it are kept"):
        writer.close()
    assert not (tmp_path / "run.mcap").exists()
    with open_recording(recover_on_another_disk(disk, tmp_path)) as recording:
        assert recording.frames == 20


def test_no_room_for_the_beginning(disk: Disk, tmp_path: Path, small: Make) -> None:
    disk.room = 100
    with pytest.raises(RecordingError, match=r"can't start .*No space left"):
        RecordingWriter(tmp_path / "run.mcap", small())
    assert not list(tmp_path.iterdir())


def test_a_disk_that_can_not_keep_its_promise(
    tmp_path: Path, small: Make, frames: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """fsync fails at the end of a segment: the file keeps the name of an unfinished one."""
    plain = os.fsync
    failing = [True]

    def fsync(fd: int) -> None:
        if failing[0]:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        plain(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    writer = RecordingWriter(tmp_path / "run.mcap", small(), segment_bytes=4000, chunk_bytes=500)
    with pytest.raises(RecordingError, match="Input/output error"):
        write_all(writer, frames(60))
    failing[0] = False
    writer.close()
    assert (tmp_path / "run.mcap.part").exists()
    result = recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert result.frames == writer.frames


class SlowSync:
    """Stands before `os.fsync`: waits until it is let, notes how much of the file it was about."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.let, self.asked = threading.Event(), threading.Event()
        self.sizes: list[int] = []
        self.error = 0
        self._plain = os.fsync
        monkeypatch.setattr(os, "fsync", self.fsync)

    def fsync(self, fd: int) -> None:
        self.asked.set()
        assert self.let.wait(20)
        error, self.error = self.error, 0
        if error:
            raise OSError(error, os.strerror(error))
        self.sizes.append(os.fstat(fd).st_size)
        self._plain(fd)


@pytest.fixture
def sync(monkeypatch: pytest.MonkeyPatch) -> SlowSync:
    return SlowSync(monkeypatch)


def test_the_disk_is_waited_for_beside_the_writing(
    sync: SlowSync, tmp_path: Path, small: Make, frames: Make
) -> None:
    packets = frames(120)
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, small(), chunk_bytes=500, settle_bytes=4000) as writer:
        write_all(writer, packets[:60])
        writer.flush()
        assert sync.asked.wait(20)
        assert writer.frames == 60  # the writer did not wait
        sync.let.set()
        while not sync.sizes:
            time.sleep(0.001)
        write_all(writer, packets[60:])
    assert len(sync.sizes) > 2  # more than the end of the segment and the folder
    with open_recording(path) as recording:
        assert list(recording.packets()) == packets


@pytest.mark.skipif(not hasattr(os, "posix_fadvise"), reason="this system takes no such advice")
def test_what_the_disk_has_leaves_the_cache(
    tmp_path: Path, small: Make, frames: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of each segment, once, and only after it was waited for."""
    told: list[tuple[int, int, int]] = []
    synced: dict[int, int] = {}
    fsync = os.fsync

    def wait(fd: int) -> None:
        fsync(fd)
        synced[os.fstat(fd).st_ino] = os.fstat(fd).st_size

    def forget(fd: int, begin: int, size: int, advice: int) -> None:
        assert advice == os.POSIX_FADV_DONTNEED
        assert begin + size <= synced[os.fstat(fd).st_ino]
        told.append((os.fstat(fd).st_ino, begin, begin + size))

    monkeypatch.setattr(os, "fsync", wait)
    monkeypatch.setattr(os, "posix_fadvise", forget)
    with RecordingWriter(
        tmp_path / "run.mcap", small(), chunk_bytes=500, settle_bytes=4000, segment_bytes=20_000
    ) as writer:
        write_all(writer, frames(300))
    segments = list(tmp_path.iterdir())
    assert len(segments) > 2
    for segment in segments:
        parts = [part for inode, *part in told if inode == segment.stat().st_ino]
        ends = [0, *(end for _, end in parts)]
        assert [begin for begin, _ in parts] == ends[:-1]
        assert ends[-1] == segment.stat().st_size


def test_a_disk_that_fails_amid_a_segment(
    sync: SlowSync, tmp_path: Path, small: Make, frames: Make
) -> None:
    """The system says once that bytes did not reach the disk: the segment must not look whole."""
    packets = frames(60)
    sync.error = errno.EIO
    writer = RecordingWriter(tmp_path / "run.mcap", small(), chunk_bytes=500, settle_bytes=2000)
    write_all(writer, packets)
    assert sync.asked.wait(20)
    sync.let.set()
    with pytest.raises(RecordingError, match="Input/output error"):
        writer.close()
    assert writer.error is not None
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap.part"]
    result = recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert result.frames == writer.frames  # this disk has them after all


def test_no_frame_is_both_stored_and_lost(
    sync: SlowSync, tmp_path: Path, small: Make, frames: Make
) -> None:
    """A wait for the disk fails while later packets are stored."""
    sync.error = errno.EIO
    sync.let.set()
    writer = RecordingWriter(tmp_path / "run.mcap", small(), chunk_bytes=500, settle_bytes=2000)
    with pytest.raises(RecordingError, match="Input/output error"):
        write_and_wait(writer, frames(60))
    written = writer.report.frames
    assert writer.frames == written
    assert writer.lost_frames == 0
    writer.close()
    result = recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert result.frames == writer.frames


def test_a_disk_that_is_full_while_it_is_waited_for(
    sync: SlowSync, disk: Disk, tmp_path: Path, small: Make, frames: Make
) -> None:
    """The file stays open until the wait for it is over."""
    packets = frames(60)
    writer = RecordingWriter(tmp_path / "run.mcap", small(), chunk_bytes=500, settle_bytes=2000)
    write_all(writer, packets[:30])
    writer.flush()
    assert sync.asked.wait(20)
    disk.room = 100
    timer = threading.Timer(0.2, sync.let.set)
    timer.start()
    with pytest.raises(RecordingError, match="No space left"):
        write_all(writer, packets[30:])
    assert sync.sizes  # it had a file to wait for
    timer.join()
    writer.close()
    with open_recording(recover_on_another_disk(disk, tmp_path)) as recording:
        assert list(recording.packets()) == packets[: writer.frames]


@pytest.fixture
def limited_file_size() -> Iterator[Callable[[int], None]]:
    """Function: from here on, the operating system lets no file grow beyond so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_the_real_thing(
    tmp_path: Path, small: Make, frames: Make, limited_file_size: Callable[[int], None]
) -> None:
    """The kernel itself writes short and then refuses."""
    packets = frames(400)
    writer = RecordingWriter(tmp_path / "run.mcap", small(), chunk_bytes=3000)
    limited_file_size(30_000)
    with pytest.raises(RecordingError, match="File too large"):
        write_all(writer, packets)
    limited_file_size(1 << 30)
    writer.close()
    assert 0 < writer.frames < 400
    result = recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert result.path is not None
    with open_recording(result.path) as recording:
        assert list(recording.packets()) == packets[: writer.frames]


def test_a_file_that_can_not_be_read(recorded: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    path, _ = recorded()
    with open_recording(path) as recording:

        def preadv(fd: int, buffers: Any, offset: int) -> int:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        monkeypatch.setattr(os, "preadv", preadv)
        with pytest.raises(RecordingError, match=r"can't read .* at byte \d+: Input/output"):
            recording.histogram()


def test_a_file_that_can_not_be_opened(recorded: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    path, _ = recorded()

    def refuse(*_: Any) -> int:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr("hueflight.recording.segment_reader.open_to_read", refuse)
    with pytest.raises(RecordingError, match=r"can't read .*run.mcap: Permission denied"):
        open_recording(path)


def test_a_file_that_shrinks(recorded: Make) -> None:
    path, _ = recorded()
    with open_recording(path) as recording:
        os.truncate(path, 5000)
        with pytest.raises(RecordingError, match="ends at byte 5000"):
            recording.histogram()


def test_memory_that_is_exhausted(
    tmp_path: Path, small: Make, frames: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    packets = frames(40)
    writer = RecordingWriter(tmp_path / "run.mcap", small())
    write_all(writer, packets[:30])
    writer.flush()

    def lack(*_: Any, **__: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("hueflight.recording.segment.encode_chunk", lack)
    write_all(writer, packets[30:])
    with pytest.raises(RecordingError, match="memory is exhausted; 30 frames before it are kept"):
        writer.flush()
    writer.close()
    assert (writer.frames, writer.lost_frames) == (30, 10)
    with open_recording(tmp_path / "run.mcap") as recording:
        assert list(recording.packets()) == packets[:30]


def test_an_interruption_between_two_segments(
    tmp_path: Path, small: Make, frames: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Control-C when the next file is begun: later packets are lost, and this is said once."""
    packets = frames(40)
    writer = RecordingWriter(tmp_path / "run.mcap", small(), segment_bytes=4000)
    plain = writer._start_segment

    def interrupt() -> None:
        writer._start_segment = plain
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_start_segment", interrupt)
    errors: list[BaseException] = []
    for packet in packets:
        try:
            writer.write(packet)
            writer.flush()
        except (KeyboardInterrupt, RecordingError) as error:
            errors.append(error)
    writer.close()
    assert [type(error) for error in errors] == [KeyboardInterrupt, RecordingError]
    assert "there is no file to write to" in str(errors[1])
    assert 0 < writer.frames < 40
    assert writer.frames + writer.lost_frames == 40
    with open_recording(tmp_path / "run.mcap") as recording:
        assert list(recording.packets()) == packets[: writer.frames]
