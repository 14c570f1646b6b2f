# SPDX-License-Identifier: Apache-2.0
"""Recovery: everything that is intact comes back, nothing is invented, the verdict is right."""

import os
import random
import shutil
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer

from hueflight.errors import RecordingError
from hueflight.recording import Outcome, RecordingWriter, open_recording, recover

Make = Callable[..., Any]
FILES = {"segment_bytes": 4500, "chunk_bytes": 700}


def recovered_packets(path: Path) -> list[bytes]:
    with open_recording(path) as recording:
        return list(recording.packets())


def is_part_of(some: list[bytes], everything: list[bytes]) -> bool:
    """Whether `some` are among `everything`, in order, each once."""
    rest = iter(everything)
    return all(packet in rest for packet in some)


def test_nothing_is_wrong(recorded: Make) -> None:
    path, packets = recorded(attachments={"calibration": b"abc"}, metadata={"a": "b"}, **FILES)
    before = path.read_bytes()
    result = recover(path)
    assert result.outcome == Outcome.WHOLE == 0
    assert (result.frames, result.damaged_bytes, result.missing_segments) == (50, 0, 0)
    assert result.path is not None
    assert result.path.name == "run.recovered.mcap"
    assert recovered_packets(result.path) == packets
    with open_recording(result.path) as recording:
        assert recording.attachment("calibration") == b"abc"
        assert recording.metadata == {"a": "b"}
    assert path.read_bytes() == before
    assert result.as_dict()["outcome"] == "whole"


def test_a_recording_that_did_not_end(tmp_path: Path, small: Make, frames: Make) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", small(), chunk_bytes=700)
    for packet in frames(20):
        writer.write(packet)
    writer.flush()
    result = recover(tmp_path / "run.mcap", tmp_path / "new.mcap")
    assert result.outcome == Outcome.WHOLE
    assert result.unfinished == 1
    assert recovered_packets(tmp_path / "new.mcap") == frames(20)
    writer.close()


def test_a_segment_is_gone(recorded: Make) -> None:
    for number in (0, 1, -1):
        path, packets = recorded(name=f"gone{number}.mcap", **FILES)
        files = sorted(path.parent.glob(f"gone{number}.*"), key=lambda file: len(file.name))
        files[number].unlink()
        result = recover(path)
        assert result.outcome == Outcome.LOSSY == 3
        assert result.missing_segments == 1
        assert result.path is not None
        kept = recovered_packets(result.path)
        assert 0 < len(kept) < 50
        assert is_part_of(kept, packets)


def test_a_damaged_chunk_loses_only_the_packet_that_was_hit(recorded: Make) -> None:
    path, packets = recorded(chunk_bytes=1500)
    octets = bytearray(path.read_bytes())
    at = octets.index(packets[20]) + 100
    octets[at] ^= 1
    path.write_bytes(octets)
    result = recover(path)
    assert result.outcome == Outcome.LOSSY
    assert result.path is not None
    assert recovered_packets(result.path) == packets[:20] + packets[21:]


def test_records_that_say_they_are_something_else(recorded: Make) -> None:
    """A flipped bit in a record's kind: its packets are intact, so they come back."""
    path, packets = recorded(chunk_bytes=700)
    octets = path.read_bytes()
    places = [octets.index(packet) - 80 for packet in packets]
    chunks = [at for at in places if octets[at] == 6 and octets[at + 49] == 5]
    assert len(chunks) > 5
    records = [chunks[0], chunks[3], chunks[3] - 31, chunks[-1], chunks[-1] - 31]
    assert [octets[at] for at in records] == [6, 6, 7, 6, 7]
    for at in records:
        for kind in {4, 6, 7, 0x0F, 0x80} - {octets[at]}:
            path.write_bytes(octets[:at] + bytes([kind]) + octets[at + 1 :])
            result = recover(path, overwrite=True)
            assert result.outcome == Outcome.LOSSY
            assert result.path is not None
            assert recovered_packets(result.path) == packets


def test_disks_with_bad_sectors(recorded: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    path, packets = recorded(400, chunk_bytes=6000)
    bad = range(8192, 12288)
    plain = os.pread

    def pread(fd: int, size: int, at: int) -> bytes:
        if at < bad.stop and at + size > bad.start:
            raise OSError(5, "Input/output error")
        return plain(fd, size, at)

    monkeypatch.setattr(os, "pread", pread)
    result = recover(path)
    assert result.outcome == Outcome.LOSSY
    assert result.path is not None
    kept = recovered_packets(result.path)
    hit = sum(map(len, packets)) / len(packets)
    assert 400 - len(kept) <= 4096 / hit + 2
    assert is_part_of(kept, packets)


def test_nothing_left(tmp_path: Path, recorded: Make) -> None:
    path, _ = recorded()
    octets = path.read_bytes()
    for content in (b"", b"\0" * 5000, octets[:100], b"text\n" * 1000):
        path.write_bytes(content)
        result = recover(path)
        assert result.outcome == Outcome.NOTHING == 1
        assert result.path is None
    assert not list(tmp_path.glob("*recovered*"))


def test_chunks_of_another_program(tmp_path: Path, small: Make, frames: Make) -> None:
    """Chunks that are whole but not ours: their bytes are looked through for packets."""
    packets = frames(10)
    for compression in (CompressionType.NONE, CompressionType.LZ4):
        path = tmp_path / "foreign.mcap"
        with path.open("wb") as file:
            writer = Writer(file, compression=compression)
            writer.start()
            channel = writer.register_channel("/camera", "raw", 0)
            for time, packet in enumerate(packets):
                writer.add_message(channel, time, packet, time)
            writer.finish()
        result = recover(path, tmp_path / "out.mcap", instrument=small(), overwrite=True)
        kept = recovered_packets(result.path) if result.path else []
        assert is_part_of(kept, packets)  # LZ4 may leave some of them as they are
        if compression == CompressionType.NONE:
            assert result.outcome == Outcome.LOSSY
            assert kept == packets


def test_the_instrument_is_gone(recorded: Make, small: Make) -> None:
    path, packets = recorded()
    octets = path.read_bytes()
    path.write_bytes(b"".join(packets) + b"tail")  # packets alone: nothing of a recording
    with pytest.raises(RecordingError, match="states the instrument any more: name the instrument"):
        recover(path)
    result = recover(path, instrument=small())
    assert result.outcome == Outcome.LOSSY
    assert result.path is not None
    assert recovered_packets(result.path) == packets
    damaged = bytearray(octets)
    damaged[octets.index(b'"code_bits"')] ^= 1
    path.write_bytes(damaged)
    result = recover(path, instrument=small(), overwrite=True)
    assert result.frames == 50
    assert result.outcome == Outcome.LOSSY


def test_no_files_and_files_of_several_recordings(recorded: Make, tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match=r"there is no recording .* not even an unfinished one"
    ):
        recover(tmp_path / "none.mcap")
    path, _ = recorded(**FILES)
    other, _ = recorded(name="other.mcap")
    shutil.copy(other, path.with_name("run.000001.mcap"))
    with pytest.raises(RecordingError, match="belong to several recordings"):
        recover(path)
    path, _ = recorded(name="twice.mcap")
    recover(path)
    with pytest.raises(RecordingError, match="exists already: choose another name"):
        recover(path)
    recover(path, overwrite=True)


@pytest.fixture(scope="module")
def tiny(
    tmp_path_factory: pytest.TempPathFactory, small: Make, frames: Make
) -> tuple[bytes, list[bytes], Path]:
    """A small recording, its packets, and a folder to try things in."""
    folder = tmp_path_factory.mktemp("tiny")
    packets = frames(6)
    with RecordingWriter(folder / "run.mcap", small(), chunk_bytes=400) as writer:
        for packet in packets:
            writer.write(packet)
    return (folder / "run.mcap").read_bytes(), packets, folder


def try_to_recover(octets: bytes, tiny: tuple[bytes, list[bytes], Path], small: Make) -> Outcome:
    """Recover from a damaged file; check that all that is whole in it came back, and no more."""
    _, packets, folder = tiny
    path = folder / "try.mcap"
    path.write_bytes(octets)
    result = recover(path, overwrite=True, instrument=small())
    kept = recovered_packets(result.path) if result.path else []
    assert kept == [packet for packet in packets if packet in octets]
    assert (result.outcome == Outcome.NOTHING) == (not kept)
    if result.outcome == Outcome.WHOLE:
        assert kept == packets
        assert len(octets) == len(tiny[0])
    return result.outcome


def try_to_read(octets: bytes, tiny: tuple[bytes, list[bytes], Path]) -> str:
    """Open a damaged file; it must be refused, or what it gives must be true."""
    _, packets, folder = tiny
    path = folder / "read.mcap"
    path.write_bytes(octets)
    try:
        with open_recording(path) as recording:
            kept = list(recording.packets())
    except RecordingError:
        return "refused"
    assert is_part_of(kept, packets)
    return "read" if kept == packets else "read in part"


@pytest.mark.parametrize("step", [19, pytest.param(1, marks=pytest.mark.slow)])
def test_cut_at_any_byte(step: int, tiny: Any, small: Make) -> None:
    octets = tiny[0]
    outcomes = Counter(try_to_recover(octets[:n], tiny, small) for n in range(0, len(octets), step))
    assert set(outcomes) == {Outcome.NOTHING, Outcome.LOSSY}
    assert {try_to_read(octets[:n], tiny) for n in range(0, len(octets), step)} == {"refused"}


@pytest.mark.parametrize("step", [401, pytest.param(29, marks=pytest.mark.slow)])
def test_any_bit_flipped(step: int, tiny: Any, small: Make) -> None:
    """One bit in `step`; tools/fuzz/recordings.py flips each."""
    for bit in range(3, 8 * len(tiny[0]), step):
        octets = bytearray(tiny[0])
        octets[bit // 8] ^= 1 << bit % 8
        try_to_recover(bytes(octets), tiny, small)
        try_to_read(bytes(octets), tiny)


# -- a program that is killed ----------------------------------------------------------------------


def record_until_killed(path: Path, instrument: Any, packets: list[bytes], tell: int) -> None:
    """Record packets over and over, and tell after each flush how many are safe."""
    with RecordingWriter(path, instrument, segment_bytes=200_000, chunk_bytes=3000) as writer:
        while True:
            for packet in packets:
                writer.write(packet)
                os.write(tell, writer.frames.to_bytes(8, "little"))


def killed_once(folder: Path, instrument: Any, packets: list[bytes], words: int) -> int:
    """Start a recording, kill it after it told so often, recover; return how many were safe."""
    shutil.rmtree(folder, ignore_errors=True)
    listen, tell = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            record_until_killed(folder / "run.mcap", instrument, packets, tell)
        finally:
            os._exit(1)
    os.close(tell)
    told = b""
    heard = 0
    while heard < 8 * words:  # it goes on meanwhile, so that the kill comes at any place
        more = os.read(listen, 1 << 12)
        assert more, "the recording ended by itself"
        heard, told = heard + len(more), (told + more)[-16:]
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while more := os.read(listen, 1 << 16):
        told = (told + more)[-16:]
    os.close(listen)
    whole = told[: len(told) // 8 * 8]
    safe = int.from_bytes(whole[-8:], "little")
    if not list(folder.glob("*")):  # killed before it began
        assert safe == 0
        return 0
    result = recover(folder / "run.mcap")
    assert result.frames >= safe
    kept = recovered_packets(result.path) if result.path else []
    assert len(kept) == result.frames
    assert all(packet == packets[i % len(packets)] for i, packet in enumerate(kept))
    return safe


def run_killed(folder: Path, small: Make, frames: Make, times: int) -> list[int]:
    rng = random.Random(7)
    packets = frames(64)
    return [
        killed_once(folder / "killed", small(), packets, rng.randrange(3000)) for _ in range(times)
    ]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # fork beside idle threads
def test_killed_at_random_moments(tmp_path: Path, small: Make, frames: Make) -> None:
    safe = run_killed(tmp_path, small, frames, 12)
    assert max(safe) > 100


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_killed_at_a_hundred_random_moments(tmp_path: Path, small: Make, frames: Make) -> None:
    safe = run_killed(tmp_path, small, frames, 100)
    assert max(safe) > 100
