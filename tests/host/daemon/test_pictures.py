# SPDX-License-Identifier: Apache-2.0
"""Live pictures: each is of the newest frames, whatever the order in which pieces come."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hueflight as hf
from hueflight.acquisition.run_settings import RunSettings
from hueflight.acquisition.snapshot import LiveBlock
from hueflight.daemon.block_window import BlockWindow
from hueflight.daemon.gathered_window import GatheredWindow
from hueflight.daemon.picture import Picture
from hueflight.daemon.picture_settings import PictureSettings, PictureSettingsError
from hueflight.daemon.pictures import Pictures
from hueflight.model.schedules import Schedule

WAIT_S = 60.0


class Source:
    """Histograms of random counts, and which of them were given back."""

    def __init__(self, instrument: hf.Instrument) -> None:
        self._instrument, self._shape = instrument, instrument.histogram_shape
        self._rng = np.random.default_rng(7)
        self.returned: list[int] = []

    def block(self, number: int, *, run: int = 1, step: int = 0, frames: int = 10) -> LiveBlock:
        counts = self._rng.integers(0, 9, self._shape, dtype=np.uint16)
        block: Any = SimpleNamespace(counts={step: counts}, frames=frames, last_tick=0, clock_hz=1)
        return LiveBlock(
            block, 0.0, "scene", run, self._instrument, lambda: self.returned.append(number)
        )


@pytest.mark.parametrize("blocks", [1, 3])
def test_a_picture_is_of_the_newest_blocks_of_its_run(
    instrument: hf.Instrument, blocks: int
) -> None:
    made: list[Picture] = []
    done = threading.Semaphore(0)

    def keep(picture: Picture) -> None:
        made[:] = [picture]
        done.release()

    pictures = Pictures(instrument, window_blocks=blocks, on_picture=keep)
    source = Source(instrument)
    offered: list[LiveBlock] = []
    try:
        for number, (run, step) in enumerate([(1, 0)] * 7 + [(2, 0)] * 2 + [(2, 1)] * 5):
            offered.append(source.block(number, run=run, step=step))
            pictures.offer(offered[-1])
            assert done.acquire(timeout=WAIT_S)
            same = [b for b in offered if (b.run, list(b.block.counts)) == (run, [step])]
            newest = same[-blocks:]
            wanted = sum(live.block.counts[step].astype(np.uint32) for live in newest)
            assert np.array_equal(made[-1].histogram, wanted)
            assert made[-1].frames == 10 * len(newest)
    finally:
        pictures.close()
    assert pictures.skipped == 0
    # all but those that this picture or the next still needs, each once, in order
    assert source.returned == list(range(len(offered) - blocks))


def test_pictures_are_of_one_schedule(instrument: hf.Instrument) -> None:
    """What still comes of the earlier schedule is not shown, and its calibration is not used."""
    made: list[Picture] = []
    done = threading.Semaphore(0)
    pictures = Pictures(instrument, on_picture=lambda p: (made.append(p), done.release()))
    calibration: Any = SimpleNamespace()
    pictures.calibration = calibration
    schedule = Schedule.of(instrument)
    changed = Schedule(tuple((a + 5.0,) for (a,) in schedule.delays_ns), 300.0).applied_to(
        instrument
    )
    before, after = Source(instrument), Source(changed)
    try:
        pictures.offer(replace(before.block(0), kind="dark"))
        assert done.acquire(timeout=WAIT_S)
        pictures.follow(RunSettings.of(changed), changed)
        assert (pictures.calibration, pictures.latest) == (None, None)
        for number in range(1, 4):
            pictures.offer(before.block(number))
        assert before.returned[-3:] == [1, 2, 3]
        pictures.offer(after.block(4))  # the one that may have begun before
        newest = after.block(5)
        pictures.offer(newest)
        assert done.acquire(timeout=WAIT_S)
    finally:
        pictures.close()
    assert len(made) == 2
    assert np.array_equal(made[-1].histogram, newest.block.counts[0])


def test_a_histogram_is_given_back_when_nobody_holds_its_picture(
    instrument: hf.Instrument,
) -> None:
    made: list[Picture] = []
    done = threading.Semaphore(0)
    pictures = Pictures(instrument, on_picture=lambda p: (made.append(p), done.release()))
    source = Source(instrument)
    try:
        for number in range(4):
            pictures.offer(source.block(number))
            assert done.acquire(timeout=WAIT_S)
        assert source.returned == []
        for index, expected in ((1, [1]), (0, [1, 0]), (0, [1, 0, 2])):
            del made[index]
            assert source.returned == expected  # the last one is still the latest
    finally:
        pictures.close()


def test_while_nobody_looks_pictures_are_few(
    instrument: hf.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, looking = 100.0, False
    made: list[Picture] = []
    added = threading.Semaphore(0)
    monkeypatch.setattr("hueflight.daemon.pictures.time.monotonic", lambda: now_s)
    pictures = Pictures(
        instrument, on_picture=made.append, is_watched=lambda: (looking, added.release())[0]
    )
    source = Source(instrument)
    try:
        for number in range(9):
            pictures.offer(source.block(number))
            if number == 0:  # the first one is made in any case
                while not made:
                    time.sleep(0.001)
                continue
            assert added.acquire(timeout=WAIT_S)
            now_s, looking = now_s + 0.3, number >= 6
    finally:
        pictures.close()
    assert pictures.skipped == 0
    assert [picture.begun_s for picture in made] == pytest.approx([100, 101.2, 101.8, 102.1])


def test_counters_grow_when_sixteen_bits_do_not_suffice(instrument: hf.Instrument) -> None:
    made: list[Picture] = []
    done = threading.Semaphore(0)
    pictures = Pictures(
        instrument, window_blocks=4, on_picture=lambda p: (made.append(p), done.release())
    )
    source = Source(instrument)
    try:
        for number in range(4):
            live = source.block(number, frames=30_000)
            live.block.counts[0][:] = 30_000
            pictures.offer(live)
            assert done.acquire(timeout=WAIT_S)
    finally:
        pictures.close()
    assert (made[-1].histogram == 120_000).all()


def test_photons_add_up_until_something_changes_or_the_settings_do(
    instrument: hf.Instrument,
) -> None:
    made: list[Picture] = []
    done = threading.Semaphore(0)
    pictures = Pictures(
        instrument, integration_s=math.inf, on_picture=lambda p: (made.append(p), done.release())
    )
    source = Source(instrument)
    offered = 0

    def change(settings: PictureSettings) -> None:
        pictures.change(settings)
        pictures.offer(source.block(-1))  # began before the change, and is left out

    def offer(*, kind: str = "scene", run: int = 1, factor: int = 1) -> LiveBlock:
        nonlocal offered
        live = replace(source.block(offered, run=run, frames=200), kind=kind)
        live.block.counts[0][:] *= factor
        offered += 1
        pictures.offer(live)
        assert done.acquire(timeout=WAIT_S)
        assert made[-1].histogram.shape == instrument.histogram_shape
        return live

    try:
        total = sum(offer().block.counts[0].astype(np.int64) for _ in range(6))
        assert np.array_equal(made[-1].histogram, total)
        total += offer(run=2).block.counts[0]  # a recording sees the same scene
        assert np.array_equal(made[-1].histogram, total)
        assert made[-1].frames == 1400
        assert (made[-1].frames_by_pixel == 1400).all()
        brighter = offer(factor=3)
        assert np.array_equal(made[-1].histogram, brighter.block.counts[0])
        assert made[-1].frames == 200
        offer(factor=3)
        assert made[-1].frames == 400
        reference = offer(kind="reference", factor=3)  # something else is in front of the camera
        assert np.array_equal(made[-1].histogram, reference.block.counts[0])
        change(PictureSettings(0.0, pictures.settings.method))
        for _ in range(2):
            newest = offer(kind="reference", factor=3)
            assert np.array_equal(made[-1].histogram, newest.block.counts[0])
        change(PictureSettings(0.4, "paper"))  # 400 frames at the default rate
        for frames in (200, 400, 400, 400):
            offer(kind="reference", factor=3)
            assert made[-1].frames == frames
        assert pictures.settings.method == "paper"
    finally:
        pictures.close()


def test_impossible_settings_are_refused() -> None:
    for seconds, method, words in (
        (-1.0, "joint", "integration_s = -1"),
        (math.nan, "joint", "integration_s = nan"),
        (2e6, "joint", "integration_s = 2000000"),
        (1.0, "magic", "method = 'magic': choose one of"),
    ):
        with pytest.raises(PictureSettingsError, match=words):
            PictureSettings(seconds, method)


@pytest.mark.parametrize("length", [10, 11, 25, 400])
def test_a_long_window_holds_few_histograms(instrument: hf.Instrument, length: int) -> None:
    """Its sum is of consecutive newest blocks, as many as asked for to a tenth."""
    from hueflight.daemon.block_window import PARTS, BlockWindow

    window, source = BlockWindow(length), Source(instrument)
    sums = [np.zeros(instrument.histogram_shape, np.int64)]
    for number in range(2 * length + 7):
        block = source.block(number)
        sums.append(sums[-1] + block.block.counts[0])
        window.add(block)
        assert number + 1 - len(source.returned) <= PARTS
        blocks = window.frames // 10
        part = -(-length // PARTS)
        assert min(number + 1, length - part) <= blocks < length + part
        assert np.array_equal(window.histogram(), sums[-1] - sums[-1 - blocks])


def test_blocks_that_waited_are_gathered_together(instrument: hf.Instrument) -> None:
    """The sum and its frames are those of adding one after another; all are given back."""
    window, source = GatheredWindow(instrument, np.inf, 1000.0), Source(instrument)
    steps = [0, 0, 0, 1, 1]
    blocks = [source.block(number, step=step) for number, step in enumerate(steps)]
    blocks.insert(4, source.block(9, step=1, frames=0))
    window.add_all(blocks[:3])
    wanted = sum(block.histogram.astype(np.int64) for block in blocks[:3])
    assert np.array_equal(window.histogram(), wanted)
    assert (window.frames, window.frames_by_pixel.min()) == (30, 30)
    window.add_all(blocks[2:])  # the LEDs fire in another way within
    wanted = blocks[3].histogram.astype(np.int64) + blocks[5].histogram
    assert np.array_equal(window.histogram(), wanted)
    assert window.frames == 20
    assert source.returned == [0, 1, 2, 2, 3, 9, 4]


def test_a_picture_begun_anew_holds_no_older_photons(instrument: hf.Instrument) -> None:
    """The block that was being counted is left out, and the sum gets its new length."""
    made: list[Picture] = []
    done = threading.Semaphore(0)
    pictures = Pictures(
        instrument, window_blocks=3, on_picture=lambda p: (made.append(p), done.release())
    )
    source = Source(instrument)
    blocks = [source.block(number) for number in range(8)]
    try:
        for number, block in enumerate(blocks):
            if number == 3:
                assert pictures.begin_anew(BlockWindow.holding(2)) == 3
            pictures.offer(block)
            if number != 3:  # which began before
                assert done.acquire(timeout=WAIT_S)
    finally:
        pictures.close()
    later = [picture for picture in made if picture.number > 3]
    assert [picture.frames for picture in later] == [10, 20, 20, 20]
    wanted = sum(block.block.counts[0].astype(np.uint32) for block in blocks[6:])
    assert np.array_equal(later[-1].histogram, wanted)
    assert sorted(source.returned)[:6] == list(range(6))


@pytest.mark.parametrize("blocks", [1, 2, 10, 11, 27, 100])
def test_a_full_window_holds_as_many_blocks_as_asked(
    instrument: hf.Instrument, blocks: int
) -> None:
    window = BlockWindow.holding(blocks)
    source = Source(instrument)
    held = []
    for number in range(3 * window.length):
        window.add(source.block(number, frames=1))
        held.append(window.frames)
    full = held[window.length :]
    assert blocks <= window.least == min(full)
    assert max(full) <= max(blocks, 10 * -(-blocks // 9) - 1)
