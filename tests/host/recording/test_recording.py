# SPDX-License-Identifier: Apache-2.0
"""Writing and reading recordings: what comes back, slices, files, errors."""

import dataclasses
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import AttachmentIndex
from mcap.writer import Writer

import hueflight as hf
from hueflight.errors import RecordingError
from hueflight.ingest import accumulate, accumulate_by_step
from hueflight.ingest.buffer import PacketBuffer
from hueflight.recording import RecordingWriter, open_recording
from hueflight_protocol import Event, PacketHeader, encode_event

Make = Callable[..., Any]
NEEDED = ("recording.reader.LEAST_BYTES", "ingest.buffer.LEAST_BYTES")
SMALL_FILES = {"segment_bytes": 4500, "chunk_bytes": 700}


def test_packets_come_back_as_they_were(recorded: Make) -> None:
    path, packets = recorded(chunk_bytes=700)
    with open_recording(path) as recording:
        assert recording.frames == 50
        assert list(recording.packets()) == packets
        assert b"".join(recording.raw()) == b"".join(packets)


def test_histogram_is_that_of_the_packets(recorded: Make) -> None:
    path, packets = recorded()
    with open_recording(path) as recording:
        counts, report = recording.accumulate()
        expected, expected_report = accumulate(b"".join(packets), recording.instrument)
        np.testing.assert_array_equal(counts, expected)
        np.testing.assert_array_equal(recording.histogram(threads=2), expected)
        assert report == expected_report
        by_step, _ = accumulate_by_step(b"".join(packets), recording.instrument)
        np.testing.assert_array_equal(
            recording.histograms_by_step(), np.stack(list(by_step.values()))
        )


@pytest.fixture(scope="module")
def long_recording(
    tmp_path_factory: pytest.TempPathFactory, small: Make, frames: Make
) -> tuple[Path, list[bytes]]:
    """Several files of several chunks, with events, junk and a packet that came twice."""
    path = tmp_path_factory.mktemp("long") / "run.mcap"
    packets = frames(120)
    with RecordingWriter(path, small(), **SMALL_FILES) as writer:
        for i, packet in enumerate(packets):
            writer.write(packet)
            if i % 10 == 0:
                writer.write(b"junk" * (i // 10))
                writer.write(packet)  # the same again, at a chunk's start now and then
            if i % 17 == 0:
                writer.write(encode_event(Event(PacketHeader(sequence=i), code=5)))
            if i % 13 == 0:
                writer.flush()
    return path, packets


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(bounds=st.tuples(st.integers(0, 120), st.integers(0, 120)))
def test_every_slice_of_frames(
    bounds: tuple[int, int], long_recording: tuple[Path, list[bytes]]
) -> None:
    path, packets = long_recording
    start, stop = sorted(bounds)
    with open_recording(path) as recording:
        assert recording.info().segments > 3
        assert list(recording.packets(start, stop)) == packets[start:stop]
        counts, report = recording.accumulate(start, stop)
        expected, _ = accumulate(b"".join(packets[start:stop]), recording.instrument)
        np.testing.assert_array_equal(counts, expected)
        assert report.frames == stop - start
        assert report.photons == report.hits == expected[..., 1:].sum()


def test_a_recording_longer_than_the_memory_for_it(
    long_recording: tuple[Path, list[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, packets = long_recording
    for name in ("recording.reader.BUFFER_BYTES", *NEEDED):
        monkeypatch.setattr(f"hueflight.{name}", 2000)
    emptied: list[None] = []
    plain = PacketBuffer.release
    monkeypatch.setattr(
        PacketBuffer, "release", lambda self: (emptied.append(None), plain(self))[1]
    )
    with open_recording(path) as recording:
        recording.histogram()
        assert len(emptied) > 5
        for start, stop in ((0, 120), (7, 101)):
            assert list(recording.packets(start, stop)) == packets[start:stop]
            expected, _ = accumulate(b"".join(packets[start:stop]), recording.instrument)
            np.testing.assert_array_equal(recording.histogram(start, stop), expected)


def test_slices_of_time(recorded: Make) -> None:
    path, _ = recorded(chunk_bytes=700)
    with open_recording(path) as recording:  # a frame every 10 ms
        assert recording.info().seconds == pytest.approx(0.49)
        assert [recording.frame_at(at) for at in (-1, 0, 0.005, 0.01, 0.2, 0.4801, 9)] == [
            0, 0, 1, 1, 20, 49, 50,
        ]  # fmt: skip


def test_a_slice_reads_little_of_the_file(recorded: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    from hueflight.recording.segment_reader import SegmentReader

    path, _ = recorded(400, chunk_bytes=2000)
    read: list[int] = []
    plain = SegmentReader.read_into
    monkeypatch.setattr(
        SegmentReader,
        "read_into",
        lambda self, space, offset: (read.append(len(space)), plain(self, space, offset))[1],
    )
    with open_recording(path) as recording:
        recording.histogram(200, 210)
    assert sum(read) < 0.25 * path.stat().st_size


def test_info(recorded: Make) -> None:
    path, packets = recorded(
        metadata={"target": "brick", "distance": 0.4}, attachments={"calibration": b"abc"}
    )
    with open_recording(path) as recording:
        info = recording.info()
        assert recording.metadata == {"target": "brick", "distance": "0.4"}
        assert recording.attachment("calibration") == b"abc"
        assert recording.instrument.image_shape == (8, 8)
        with pytest.raises(RecordingError, match="no attachment 'flat'"):
            recording.attachment("flat")
    assert (info.frames, info.segments, info.complete) == (50, 1, True)
    assert info.size == path.stat().st_size
    assert info.attachments == ("calibration",)
    assert info.report["packets"] == len(packets)
    assert info.as_dict()["instrument"] == "paper"


def test_pieces_of_a_live_stream(tmp_path: Path, small: Make, frames: Make) -> None:
    """Pieces that cut packets anywhere: chunks still hold whole packets."""
    packets = b"".join(frames(60))
    with RecordingWriter(tmp_path / "live.mcap", small(), chunk_bytes=500) as writer:
        for at in range(0, len(packets), 77):
            writer.write(packets[at : at + 77])
    with open_recording(tmp_path / "live.mcap") as recording:
        assert b"".join(recording.raw()) == packets
        assert list(recording.packets(30, 33)) == frames(60)[30:33]


def test_damage_is_kept_as_received(tmp_path: Path, small: Make, frames: Make) -> None:
    packets = frames(9)
    broken = bytearray(packets[4])
    broken[80] ^= 4
    stream = b"".join([*packets[:4], bytes(broken), b"between", *packets[5:], packets[8][:30]])
    with RecordingWriter(tmp_path / "run.mcap", small()) as writer:
        writer.write(stream)
        assert writer.report.damaged == 1
    with open_recording(tmp_path / "run.mcap") as recording:
        assert b"".join(recording.raw()) == stream
        assert list(recording.packets()) == packets[:4] + packets[5:]
        assert recording.accumulate()[1].missing == 1
        assert recording.info().report["damaged"] == 2  # the cut one at the end


def test_more_frames_in_one_piece_than_a_chunk_takes(
    tmp_path: Path, small: Make, frames: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hueflight.recording.writer.FRAMES_AT_HAND", 16)
    packets = frames(50)
    with RecordingWriter(tmp_path / "run.mcap", small()) as writer:
        writer.write(b"".join(packets))
        assert writer.frames == 48
    with open_recording(tmp_path / "run.mcap") as recording:
        assert list(recording.packets()) == packets


def test_a_chunk_that_was_damaged_after_it_was_indexed(recorded: Make) -> None:
    """Frames before the slice are gone: no other takes the place of one that was asked for."""
    path, packets = recorded(10)
    octets = bytearray(path.read_bytes())
    for packet in (packets[3], packets[9]):
        octets[octets.index(packet) + 100] ^= 1
    path.write_bytes(octets)
    with open_recording(path) as recording:
        assert list(recording.packets()) == packets[:3] + packets[4:9]
        assert list(recording.packets(9)) == []
        assert recording.info().seconds is None


def test_pausing(tmp_path: Path, small: Make, frames: Make) -> None:
    packets = frames(30)
    with RecordingWriter(tmp_path / "run.mcap", small()) as writer:
        writer.resume()  # nothing has failed
        for packet in packets[:10]:
            writer.write(packet)
        writer.suspend("the laser is off")
        writer.suspend("a second reason")
        assert str(writer.error) == "the laser is off"
        for packet in packets[10:20]:
            writer.write(packet)
        writer.flush()
        writer.resume()
        for packet in packets[20:]:
            writer.write(packet)
    writer.suspend("after the end")
    writer.resume()
    assert writer.error is None
    assert (writer.frames, writer.lost_frames) == (20, 10)
    with open_recording(tmp_path / "run.mcap") as recording:
        assert list(recording.packets()) == packets[:10] + packets[20:]
        recording.close()  # the block closes it again


def test_empty_recording(tmp_path: Path, small: Make) -> None:
    with RecordingWriter(tmp_path / "empty.mcap", small()):
        pass
    with open_recording(tmp_path / "empty.mcap") as recording:
        assert recording.frames == 0
        assert not recording.histogram().any()
        assert recording.histograms_by_step().shape == (0, 8, 8, 512)
        assert list(recording.packets()) == []
        assert recording.info().seconds is None


def test_other_programs_read_it(recorded: Make) -> None:
    """The MCAP library, with all of its checks, finds the same bytes."""
    path, packets = recorded(metadata={"target": "brick"}, chunk_bytes=700)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 5
        messages = [message for _, _, message in reader.iter_messages()]
        assert b"".join(message.data for message in messages) == b"".join(packets)
        assert [each.metadata for each in reader.iter_metadata()] == [{"target": "brick"}]
        names = [each.name for each in reader.iter_attachments()]
        assert names == ["instrument.json", "recording.json", "frames.index", "segment.json"]
    with path.open("rb") as file:
        slow = NonSeekingReader(file, validate_crcs=True)
        assert len(list(slow.iter_messages())) == len(messages)


# -- files -----------------------------------------------------------------------------------------


def test_segments_by_size(recorded: Make) -> None:
    path, packets = recorded(**SMALL_FILES)
    files = [path, *sorted(path.parent.glob("run.0*.mcap"))]
    assert sorted(files) == sorted(path.parent.iterdir())
    assert path.with_name("run.000001.mcap") in files
    with open_recording(path) as recording:
        assert recording.info().segments == len(files) > 2
        assert list(recording.packets()) == packets
    alone: list[bytes] = []
    for file in files[1:]:
        with open_recording(file) as one:
            alone += one.packets()
            assert one.accumulate()[1].frames == one.frames < 50
    assert alone == packets[-len(alone) :]


def test_segments_by_time(tmp_path: Path, small: Make, frames: Make) -> None:
    with RecordingWriter(tmp_path / "run.mcap", small(), segment_seconds=1e-9) as writer:
        for packet in frames(3):
            writer.write(packet)
            writer.flush()
    assert len(list(tmp_path.glob("*"))) == 4  # the last one is empty


def test_what_is_flushed_is_in_the_file(tmp_path: Path, small: Make, frames: Make) -> None:
    with RecordingWriter(tmp_path / "run.mcap", small()) as writer:
        for packet in frames(5):
            writer.write(packet)
        assert writer.frames == 0
        writer.flush()
        assert writer.frames == 5
        held = (tmp_path / "run.mcap.part").read_bytes()
        assert b"".join(frames(5)) in held


def test_waiting_packets_are_flushed_after_a_while(
    tmp_path: Path, small: Make, frames: Make
) -> None:
    with RecordingWriter(tmp_path / "run.mcap", small(), flush_seconds=0) as writer:
        for packet in frames(5):
            writer.write(packet)
        assert writer.frames >= 4


# -- errors ----------------------------------------------------------------------------------------


def test_no_such_recording(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"there is no recording '.*gone.mcap'"):
        open_recording(tmp_path / "gone.mcap")


def test_a_recording_that_did_not_end(tmp_path: Path, small: Make, frames: Make) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", small())
    writer.write(frames(1)[0])
    with pytest.raises(RecordingError, match="was not finished: save its intact packets"):
        open_recording(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match="left from a recording that did not end"):
        RecordingWriter(tmp_path / "run.mcap", small())
    writer.close()


def test_foreign_files(tmp_path: Path) -> None:
    plain = tmp_path / "text.mcap"
    plain.write_text("not at all\n" * 100)
    with pytest.raises(RecordingError, match="can't be used: it is not an MCAP file"):
        open_recording(plain)
    (tmp_path / "none.mcap").write_bytes(b"")
    with pytest.raises(RecordingError, match="it is not an MCAP file"):
        open_recording(tmp_path / "none.mcap")
    foreign = tmp_path / "foreign.mcap"
    with foreign.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(RecordingError, match="an MCAP file, but not a recording of Hueflight"):
        open_recording(foreign)
    (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(RecordingError, match=r"can't read .*folder.mcap"):
        open_recording(tmp_path / "folder.mcap")


def test_a_file_cut_short(recorded: Make) -> None:
    path, _ = recorded()
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(RecordingError, match=r"it has no end: .* cut short; try recover"):
        open_recording(path)


def test_segments_that_do_not_belong(recorded: Make) -> None:
    path, _ = recorded(**SMALL_FILES)
    second, third = path.with_name("run.000001.mcap"), path.with_name("run.000002.mcap")
    second.unlink()
    with pytest.raises(RecordingError, match=r"segment 1 is missing before run.000002.mcap"):
        open_recording(path)
    other, _ = recorded(name="other.mcap")
    third.write_bytes(other.read_bytes())
    with pytest.raises(RecordingError, match="does not belong to the recording"):
        open_recording(path)


def test_frames_that_are_not_there(recorded: Make) -> None:
    path, _ = recorded()
    with open_recording(path) as recording:
        for start, stop in ((0, 51), (-1, 3), (5, 2), (60, None)):
            with pytest.raises(RecordingError, match="has frames 0 to 50"):
                recording.histogram(start, stop)


def test_names_that_can_not_be(tmp_path: Path, small: Make, recorded: Make) -> None:
    with pytest.raises(RecordingError, match=r"must end in .mcap"):
        RecordingWriter(tmp_path / "run.bin", small())
    with pytest.raises(RecordingError, match="the name is reserved"):
        RecordingWriter(tmp_path / "x.mcap", small(), attachments={"instrument.json": b""})
    path, _ = recorded()
    with pytest.raises(RecordingError, match="exists already: choose another name"):
        RecordingWriter(path, small())
    for size in ("segment_bytes", "chunk_bytes", "settle_bytes"):
        with pytest.raises(RecordingError, match="settle_bytes must be at least 1"):
            RecordingWriter(tmp_path / "x.mcap", small(), **{size: 0})
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="can't start"):
        RecordingWriter(tmp_path / "file" / "x.mcap", small())


def test_overwriting_removes_all_of_the_old_one(recorded: Make) -> None:
    path, _ = recorded(**SMALL_FILES)
    recorded(3, overwrite=True)
    assert list(path.parent.glob("*")) == [path]
    with open_recording(path) as recording:
        assert recording.frames == 3


def test_writing_after_the_end(recorded: Make, small: Make, tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "x.mcap", small())
    writer.close()
    writer.close()
    with pytest.raises(RecordingError, match="the recording is closed"):
        writer.write(b"")


def test_clocks_that_do_not_tell_the_time(tmp_path: Path, small: Make, frames: Make) -> None:
    with RecordingWriter(tmp_path / "a.mcap", small()) as writer:
        writer.write(frames(1, clock_hz=0)[0])
    with RecordingWriter(tmp_path / "b.mcap", small()) as writer:
        for first, tick in ((0, 5000), (1, 10)):
            writer.write(frames(1, first=first, timestamp=tick)[0])
            writer.flush()
    for name, message in (("a", "no clock rates"), ("b", "set back")):
        with open_recording(tmp_path / f"{name}.mcap") as recording:
            with pytest.raises(RecordingError, match=message):
                recording.frame_at(1)
            assert recording.info().seconds is None


def test_index_that_contradicts_itself(recorded: Make) -> None:
    """Even with all CRCs right, no place outside the file is read."""
    from hueflight.recording import segment

    path, _ = recorded()
    plain = segment.Segment._index_bytes

    def wrong(self: segment.Segment) -> bytes:
        octets = bytearray(plain(self))
        octets[8:16] = struct.pack("<Q", 1 << 60)
        return bytes(octets)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(segment.Segment, "_index_bytes", wrong)
        path, _ = recorded(name="wrong.mcap")
    with pytest.raises(RecordingError, match="index of frames contradicts itself"):
        open_recording(path)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("recording.json", {"offset": 1 << 40}, "'recording.json' lies outside the file; try rec"),
        ("frames.index", {"name": "recording.json"}, "'recording.json' is called 'frames.index'"),
    ],
)
def test_attachments_that_are_elsewhere(
    name: str,
    change: dict[str, Any],
    message: str,
    recorded: Make,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The summary has the right CRC, and sends the reader to another place."""
    from hueflight.recording import segment

    def wrong(*fields: Any) -> AttachmentIndex:
        right = AttachmentIndex(*fields)
        return dataclasses.replace(right, **change) if right.name == name else right

    monkeypatch.setattr(segment, "AttachmentIndex", wrong)
    path, _ = recorded()
    with pytest.raises(RecordingError, match=message):
        open_recording(path)


def test_an_index_of_another_size(recorded: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    from hueflight.recording import segment

    monkeypatch.setattr(segment.Segment, "_index_bytes", lambda _: b"odd")
    path, _ = recorded()
    with pytest.raises(RecordingError, match="its index of frames is damaged; try recover"):
        open_recording(path)


def test_a_recording_of_a_later_version(recorded: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hueflight.recording.writer.FORMAT", 99)
    path, _ = recorded()
    with pytest.raises(RecordingError, match=r"its format is 99, this program reads \d+"):
        open_recording(path)


def test_the_instrument_is_stored_whole(tmp_path: Path) -> None:
    instrument = hf.Instrument.load("line1024")
    with RecordingWriter(tmp_path / "x.mcap", instrument):
        pass
    with open_recording(tmp_path / "x.mcap") as recording:
        assert recording.instrument == instrument
