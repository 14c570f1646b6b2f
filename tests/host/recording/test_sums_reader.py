# SPDX-License-Identifier: Apache-2.0
"""Any pictures of sums are read from a recording without reading the rest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight.acquisition.sums_reduction import attachments_of
from hueflight.devices.reduction import Reduction
from hueflight.errors import RecordingError
from hueflight.recording import RecordingWriter, SumsReader, read_sums
from hueflight.recording import sums_reader as module
from hueflight_protocol.reduction import ReductionTables
from support.sums_stream import packets_of_sums

ROWS, COLS, PICTURES = 4, 6, 40


@pytest.fixture
def written(tmp_path: Path, small: Callable[..., hf.Instrument]) -> Callable[..., Path]:
    """Function that records captures; picture `n` of all has n + 1 photons in each pixel."""
    instrument = small(rows=ROWS, cols=COLS)
    entries = np.zeros((2, 512), int)
    entries[0, 1:], entries[1, 1:] = 1, np.arange(511) % 7
    tables = ReductionTables(entries, (16, 20), 1, 511)
    reduction = Reduction(tables, 100, np.zeros((ROWS, COLS), np.int64))

    def write(*captures: int, lost: tuple[tuple[int, int], ...] = (), chunk: int = 900) -> Path:
        path, number = tmp_path / "run.mcap", 0
        with RecordingWriter(
            path, instrument, metadata={"clock_hz": 1000}, chunk_bytes=chunk, segment_bytes=8000,
            attachments=attachments_of(reduction, instrument),
        ) as writer:  # fmt: skip
            for capture, pictures in enumerate(captures):
                counts = np.zeros((pictures, ROWS, COLS, 512), int)
                counts[..., 9] = (number + 1 + np.arange(pictures))[:, None, None]
                number += pictures
                for packet in packets_of_sums(
                    list(counts), reduction, lost=lost, capture=capture, ticks=50
                ):
                    writer.write(packet)
        return path

    return write


@pytest.mark.parametrize("chunk", [200, 900, 1 << 20])
@pytest.mark.parametrize("captures", [(PICTURES,), (13, 1, 26)])
@pytest.mark.parametrize("kept", [1, 3000, 1 << 20])
def test_any_pictures_are_read(
    written: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    captures: tuple[int, ...],
    chunk: int,
    kept: int,
) -> None:
    monkeypatch.setattr(module, "KEPT_BYTES", kept)
    with hf.open_recording(written(*captures, chunk=chunk)) as recording:
        reader = SumsReader(recording)
        assert (reader.pictures, reader.picture_frames) == (PICTURES, 100)
        rng = np.random.default_rng(1)
        for start, stop in np.sort(rng.integers(0, PICTURES + 1, (40, 2)), axis=1).tolist():
            found = reader.read(start, stop)
            assert (found.values[..., 0] == sum(range(start + 1, stop + 1))).all(), (start, stop)
            assert (found.frames == 100 * (stop - start)).all()
        whole, direct = reader.read(0, PICTURES), read_sums(recording)
        np.testing.assert_array_equal(whole.values, direct.values)
        with pytest.raises(RecordingError, match="pictures 0 to 40"):
            reader.read(5, PICTURES + 1)


def test_lost_pictures_keep_their_place(written: Callable[..., Path]) -> None:
    lost = tuple((picture, row) for picture in range(10, 20) for row in range(ROWS))
    with hf.open_recording(written(PICTURES, lost=(*lost, (30, 2)), chunk=300)) as recording:
        reader = SumsReader(recording)
        assert reader.pictures == PICTURES
        assert reader.seconds == 50 * (PICTURES - 1) / 1000
        for _ in range(2):  # from the file, and as they were kept
            assert reader.read(10, 20).pictures == 0
            assert (reader.read(9, 21).values[..., 0] == 10 + 21).all()
            assert reader.read(30, 31).frames[:, 0].tolist() == [100, 100, 0, 100]


def test_without_a_rate_of_the_clock_the_time_is_the_hosts(written: Callable[..., Path]) -> None:
    with hf.open_recording(written(PICTURES)) as recording:
        del recording.metadata["clock_hz"]
        assert 0 < SumsReader(recording).seconds < 60  # how long it took to write it
