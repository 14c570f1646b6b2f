"""Live pictures: each is of the newest frames, whatever the order in which pieces come."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hueflight as hf
from hueflight.acquisition.snapshot import LiveBlock
from hueflight.daemon.incremental_fitter import REFRESH_S, IncrementalFitter
from hueflight.daemon.latency import LatencyMeter
from hueflight.daemon.picture import Picture
from hueflight.daemon.pictures import Pictures
from hueflight.reconstruction.quality import Quality

WAIT_S = 20


class Source:
    """Histograms of random counts, and which of them were given back."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self._shape = shape
        self._rng = np.random.default_rng(7)
        self.returned: list[int] = []

    def block(self, number: int, *, run: int = 1, step: int = 0, frames: int = 10) -> LiveBlock:
        counts = self._rng.integers(0, 9, self._shape, dtype=np.uint16)
        block: Any = SimpleNamespace(counts={step: counts}, frames=frames, last_tick=0, clock_hz=1)
        return LiveBlock(block, 0.0, "scene", run, lambda: self.returned.append(number))


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
    source = Source(instrument.histogram_shape)
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


def test_a_histogram_is_given_back_when_nobody_holds_its_picture(
    instrument: hf.Instrument,
) -> None:
    made: list[Picture] = []
    done = threading.Semaphore(0)
    pictures = Pictures(instrument, on_picture=lambda p: (made.append(p), done.release()))
    source = Source(instrument.histogram_shape)
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
    source = Source(instrument.histogram_shape)
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
    source = Source(instrument.histogram_shape)
    try:
        for number in range(4):
            live = source.block(number, frames=30_000)
            live.block.counts[0][:] = 30_000
            pictures.offer(live)
            assert done.acquire(timeout=WAIT_S)
    finally:
        pictures.close()
    assert (made[-1].histogram == 120_000).all()


def test_delays_and_their_parts() -> None:
    latencies = LatencyMeter()
    assert latencies.as_dict() is None
    for way in (0.01, 0.02, 0.03):
        picture: Any = SimpleNamespace(received_s=5.0, begun_s=5.1, ready_s=5.4)
        latencies.shown(picture, 5.4 + way)
    found = latencies.as_dict()
    assert found == {
        "p50": 0.42, "p95": 0.43, "p99": 0.43, "waiting": 0.1, "making": 0.3, "showing": 0.02
    }  # fmt: skip
    late: Any = SimpleNamespace(received_s=36.0, begun_s=36.0, ready_s=36.0)
    latencies.shown(late, 36.5)
    assert latencies.as_dict() == {
        "p50": 0.5, "p95": 0.5, "p99": 0.5, "waiting": 0, "making": 0, "showing": 0.5
    }  # fmt: skip


def test_what_is_still_is_not_fitted_again_unless_the_kept_fits_know_less(
    small: Callable[..., hf.Instrument], draw: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = small(rows=24, cols=24)
    calibration = hf.calibrate(draw(wide, photons=20_000), wide, distance=0.5)
    fitter = IncrementalFitter(change_sigma=4.0, threads=1)

    def skipped(frames: int, seed: int) -> float:
        counts = draw(wide, depth=0.9, photons=1.3 * frames, frames=frames, seed=seed)
        image = fitter.fit(counts.astype(np.uint16), calibration, frames)
        return float((image["quality"].values & int(Quality.SKIPPED) != 0).mean())

    assert skipped(100, seed=1) == 0
    assert skipped(400, seed=2) == 0  # four times the frames: nothing old is good enough
    # 11 contrasts beyond 4 sigma: 7e-4 a pixel; 5 of 576 by chance in 1 run of 10 000
    assert skipped(400, seed=3) > 0.99
    assert skipped(300, seed=4) > 0.99
    later = time.monotonic() + REFRESH_S + 1
    monkeypatch.setattr("hueflight.daemon.incremental_fitter.time.monotonic", lambda: later)
    assert skipped(400, seed=5) == 0  # all had their turn meanwhile
    calibration = hf.calibrate(draw(wide, photons=20_000, seed=9), wide, distance=0.5)
    assert skipped(400, seed=6) == 0
    every = IncrementalFitter(change_sigma=0.0, threads=1)
    for seed in (7, 8):
        counts = draw(wide, depth=0.9, photons=500, frames=400, seed=seed)
        image = every.fit(counts.astype(np.uint16), calibration, 400)
        expected = hf.reconstruct(counts.astype(np.uint16), calibration)
        np.testing.assert_array_equal(image["depth"], expected["depth"])


@pytest.mark.parametrize("pictures", [3, 8, 200, 1000])
def test_every_pixel_has_its_turn_once_in_a_while(
    small: Callable[..., hf.Instrument],
    draw: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    pictures: int,
) -> None:
    """The same in each picture, whatever their rate: of the very same counts none has changed."""
    wide = small(rows=24, cols=24)
    calibration = hf.calibrate(draw(wide, photons=20_000), wide, distance=0.5)
    counts = draw(wide, depth=0.9, photons=500, frames=400, seed=2).astype(np.uint16)
    now_s = 1000.0
    monkeypatch.setattr("hueflight.daemon.pictures.time.monotonic", lambda: now_s)
    fitter = IncrementalFitter(change_sigma=4.0, threads=1)
    fitter.fit(counts, calibration, 400)
    fitted = np.zeros((24, 24), int)
    for _ in range(pictures):
        now_s += REFRESH_S / pictures
        image = fitter.fit(counts, calibration, 400)
        now = image["quality"].values & int(Quality.SKIPPED) == 0
        # none too many at once; times are rounded, and unusable pixels are not fitted at all
        assert now.sum() <= 24 * 24 / pictures + 1
        fitted += now
    # 2e-13 s of rounding in a thousand additions may leave out the very last
    assert (fitted <= 1).all()
    assert fitted.sum() >= calibration.usable.sum() - 1
