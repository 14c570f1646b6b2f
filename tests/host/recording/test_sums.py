# SPDX-License-Identifier: Apache-2.0
"""Recordings hold packets of sums beside frames, and count what is missing between them."""

import numpy as np
import pytest

import hueflight as hf
import hueflight_protocol as hp
from hueflight.errors import RecordingError
from hueflight.recording import (
    RecordingWriter,
    SumsDescription,
    holds_recorded_sums,
    read_sums,
)
from hueflight.recording.recorded_sums import ATTACHMENT
from hueflight_protocol.reduction import ReductionTables

ROWS, COLS, WIDTHS = 4, 6, (12, 5)
PICTURES = 11


def packet(sequence: int, picture: int, row: int, tables: int = 1) -> bytes:
    values = np.minimum(np.full((COLS, 2), 3 * picture + row, np.uint32), 31)
    return hp.encode_sums(
        hp.Sums(
            header=hp.PacketHeader(sequence=sequence),
            values=values,
            widths=WIDTHS,
            picture=picture,
            first_pixel=row * COLS,
            rows=ROWS,
            cols=COLS,
            frames=620,
            tables=tables,
        )
    )


def test_pictures_of_sums_are_read_from_a_recording(tmp_path, small):
    instrument = small(rows=ROWS, cols=COLS)
    codes = np.ones((ROWS, COLS), np.uint16)
    packets = [hp.encode_frame(codes, sequence=0, frame=0, timestamp=0)]
    packets += [packet(1 + n, n // ROWS, n % ROWS) for n in range(3 * ROWS)]
    del packets[6]  # row 1 of picture 1
    with RecordingWriter(tmp_path / "run.mcap", instrument) as writer:
        writer.write(b"".join(packets))
        assert (writer.report.damaged, writer.report.missing) == (0, 1)
    parser, assembler = hp.PacketParser(), hp.PictureAssembler()
    with hf.open_recording(tmp_path / "run.mcap") as recording:
        found = [packet for piece in recording.raw() for packet in parser.feed(piece)]
    parts = [one.content for one in found if isinstance(one.content, hp.Sums)]
    pictures = [assembler.feed(part) for part in parts]
    complete = [picture for picture in pictures if picture is not None]
    assert parser.report.missing == 1
    assert [picture.first.picture for picture in complete] == [0, 1, 2]
    assert [int(picture.present.sum()) for picture in complete] == [24, 18, 24]
    assert (complete[2].values[:, 0, 0] == 6 + np.arange(ROWS)).all()


def recorded(tmp_path, small, packets: list[bytes], tables: ReductionTables):
    """Sums of a recording of these packets, with these tables attached."""
    made = SumsDescription(tables, np.zeros((ROWS, COLS), np.int64), 0.5, 6.0)
    path = tmp_path / "run.mcap"
    attachments = {ATTACHMENT: made.to_bytes()}
    instrument = small(rows=ROWS, cols=COLS)
    with RecordingWriter(path, instrument, attachments=attachments) as writer:
        writer.write(b"".join(packets))
    with hf.open_recording(path) as recording:
        assert holds_recorded_sums(recording)
        return read_sums(recording)


def test_sums_of_pictures_add_up(tmp_path, small):
    entries = np.zeros((2, 512), int)
    entries[:, 1:] = 1
    tables = ReductionTables(entries, WIDTHS, 1, 511)
    packets = [packet(n, n // ROWS, n % ROWS, tables.hash) for n in range(PICTURES * ROWS)]
    del packets[6]  # row 2 of picture 1
    found = recorded(tmp_path, small, packets, tables)
    assert (found.pictures, found.losses) == (PICTURES, {"missing": 1})
    expected = np.full(ROWS, PICTURES * 620)
    expected[2] -= 620
    np.testing.assert_array_equal(found.frames, np.tile(expected[:, None], COLS))
    sums = np.minimum(3 * np.arange(PICTURES)[:, None] + np.arange(ROWS), 31)
    totals = sums.sum(axis=0)
    totals[2] -= 3 + 2
    # the second sum has 5 bits: at 31 it is saturated, in all rows but the first
    totals[(sums == 31).any(axis=0)] = (1 << 32) - 1
    np.testing.assert_array_equal(found.values[:, 0, 1], totals)
    assert found.description.tables.widths == (32, 32)
    assert (found.description.middle_ns, found.description.reach_ns) == (0.5, 6.0)


def test_sums_of_other_tables_are_refused(tmp_path, small):
    tables = ReductionTables(np.zeros((2, 512), int), WIDTHS, 1, 511)
    packets = [packet(n, 0, n, 1) for n in range(ROWS)]
    with pytest.raises(RecordingError, match="picture 0 has sums of other tables"):
        recorded(tmp_path, small, packets, tables)
