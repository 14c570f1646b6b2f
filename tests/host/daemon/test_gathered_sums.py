# SPDX-License-Identifier: Apache-2.0
"""Pictures of sums add up as long as nothing changes, and tell changes from chance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

import hueflight as hf
from hueflight.acquisition.snapshot import LiveSums
from hueflight.acquisition.sums_reduction import reduction_of
from hueflight.daemon.sums_window import MOST, UNNOTICED, GatheredSums
from hueflight.devices.reduction import Reduction
from hueflight.ingest.scene_change import BRIGHTNESS_TOLERANCE
from hueflight.ingest.sums_blocks import SumsBlocks
from hueflight.reconstruction.sums.changes import SumsContrasts
from hueflight_protocol import PacketHeader, ReductionRoom, Sums, encode_sums
from hueflight_protocol.reduction import reduce_histogram
from support.sums_stream import packets_of_sums

ROWS, COLS, FRAMES, PHOTONS = 24, 32, 1000, 150
Draw = Callable[..., NDArray[np.uint32]]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def camera(small: Callable[..., hf.Instrument]) -> hf.Instrument:
    return small(rows=ROWS, cols=COLS, frame_rate_hz=2000.0, exposure_ms=0.2)


@pytest.fixture(scope="module")
def calibration(camera: hf.Instrument, draw: Draw) -> hf.Calibration:
    return hf.calibrate(draw(camera, depth=0.4, photons=50_000), camera, distance=0.4)


@pytest.fixture(scope="module")
def reduction(calibration: hf.Calibration) -> Reduction:
    return reduction_of(calibration, picture_frames=FRAMES)


def pictures_of(
    counts: Sequence[NDArray[np.integer]],
    camera: hf.Instrument,
    reduction: Reduction,
    lost: tuple[tuple[int, int], ...] = (),
) -> list[LiveSums]:
    gathered, blocks = SumsBlocks(), []
    for packet in packets_of_sums(counts, reduction, lost=lost):
        blocks += gathered.feed(packet)
    blocks += gathered.finish()
    return [LiveSums(block, 0.0, "scene", 1, camera, reduction, 1) for block in blocks]


def total_of(counts: Sequence[NDArray[np.integer]], reduction: Reduction) -> NDArray[np.uint64]:
    """Sums of one picture of all the frames, which no width limits."""
    tables, offsets = reduction.tables, reduction.offsets
    assert offsets is not None
    flat = np.sum(counts, axis=0).reshape(ROWS * COLS, -1)
    wide = replace(tables, widths=(32,) * tables.sums)
    return reduce_histogram(flat, wide, offsets=offsets.ravel()).reshape(ROWS, COLS, -1)


def test_a_still_scene_adds_up_and_its_errors_fall_as_stated(
    camera: hf.Instrument, calibration: hf.Calibration, reduction: Reduction, draw: Draw
) -> None:
    """False alarms at six deviations: one in 5e8 of 48 tiles × 15 contrasts × 64 pictures."""
    counts = [draw(camera, depth=0.5, photons=PHOTONS, frames=FRAMES, seed=k) for k in range(64)]
    window = GatheredSums()
    spreads = {}
    for k, picture in enumerate(pictures_of(counts, camera, reduction), 1):
        window.add_all([picture])
        assert (window.frames_by_pixel == FRAMES * k).all()
        if k in (1, 4, 16, 64):
            values, _ = window._total()
            np.testing.assert_array_equal(values, total_of(counts[:k], reduction))
            image = window.reconstruct(calibration)
            errors = image["depth"].values - 0.5
            stated = float(np.median(image["depth_std"]))
            spreads[k] = float(np.sqrt(np.mean(errors**2)))
            assert spreads[k] == pytest.approx(stated, rel=0.12), k  # 768 pixels: 2.6 % of chance
    for k in (16, 64):  # at 4 pictures the estimate is in its asymptotic range
        assert spreads[k] == pytest.approx(spreads[4] * np.sqrt(4 / k), rel=0.12)


@pytest.mark.parametrize(
    "change", [{"depth": 0.75}, {"photons": 1.2 * PHOTONS}, {"background": 0.3 * PHOTONS}]
)
def test_what_changes_begins_anew(
    camera: hf.Instrument, reduction: Reduction, draw: Draw, change: dict[str, Any]
) -> None:
    still: dict[str, Any] = {"depth": 0.5, "photons": PHOTONS, "frames": FRAMES}
    counts = [draw(camera, **still, seed=k) for k in range(12)]
    for k in range(10, 12):
        counts[k][8:16, 8:16] = draw(camera, **(still | change), seed=100 + k)[8:16, 8:16]
    window = GatheredSums()
    window.add_all(pictures_of(counts, camera, reduction))
    frames = window.frames_by_pixel
    assert (frames[8:16, 8:16] == 2 * FRAMES).all()
    anew = np.zeros((ROWS, COLS), bool)
    anew[4:20, 4:20] = True  # with the neighbors of the tiles
    assert (frames[~anew] == 12 * FRAMES).all()
    assert np.array_equal(window.photons[8:16, 8:16], sum(
        each[8:16, 8:16, 1:].sum(axis=-1) for each in counts[10:]
    ))  # fmt: skip


def test_a_slow_change_is_told_by_longer_windows(
    camera: hf.Instrument, reduction: Reduction, draw: Draw
) -> None:
    """A millimetre a picture, a tenth of the deviation of a tile, which no single one shows."""
    counts = [
        draw(camera, depth=0.5 + 0.001 * k, photons=PHOTONS, frames=FRAMES, seed=k)
        for k in range(80)
    ]
    window = GatheredSums()
    window.add_all(pictures_of(counts, camera, reduction))
    assert window.frames_by_pixel.max() < 80 * FRAMES


def test_changes_within_the_tolerance_are_none(
    camera: hf.Instrument, reduction: Reduction, draw: Draw
) -> None:
    photons = [PHOTONS * 20, PHOTONS * 20 * (1 + 0.7 * BRIGHTNESS_TOLERANCE)]
    counts = [
        draw(camera, depth=0.5, photons=photons[k >= 8], frames=10**6, seed=k) for k in range(16)
    ]
    tables = reduction.tables
    wide = replace(reduction, tables=replace(tables, widths=(32,) * tables.sums))
    window = GatheredSums()
    window.add_all(pictures_of(counts, camera, wide))
    assert (window.frames_by_pixel == 16 * FRAMES).all()


def test_a_limit_holds_from_half_of_it_to_all(
    camera: hf.Instrument, reduction: Reduction, draw: Draw
) -> None:
    counts = [draw(camera, photons=PHOTONS, frames=FRAMES, seed=k) for k in range(30)]
    window = GatheredSums(limit_frames=8 * FRAMES)
    held = []
    for k, picture in enumerate(pictures_of(counts, camera, reduction, lost=((20, 2),)), 1):
        window.add_all([picture])
        frames = np.unique(window.frames_by_pixel[4:])
        assert len(frames) == 1
        held.append(int(frames[0]) // FRAMES)
        kept = counts[k - held[-1] : k]
        np.testing.assert_array_equal(window._total()[0][4:], total_of(kept, reduction)[4:])
        lost = k - held[-1] <= 20 < k
        assert (window.frames_by_pixel[2] == FRAMES * (held[-1] - lost)).all()
        assert (window.frames_by_pixel[3] == FRAMES * held[-1]).all()
    assert min(held[8:]) >= 4
    assert max(held) <= 8


def test_a_tile_begins_anew_before_its_sums_are_full(
    camera: hf.Instrument, reduction: Reduction, draw: Draw
) -> None:
    counts = [draw(camera, photons=PHOTONS, frames=FRAMES, seed=k) for k in range(3)]
    window = GatheredSums()
    first, *others = pictures_of(counts, camera, reduction)
    window.add_all([first])
    window._parts[0].values[5, 6, 3] = MOST - 1000
    window.add_all(others)
    assert (window.frames_by_pixel[4:8, 4:8] == 2 * FRAMES).all()
    assert (window.frames_by_pixel[0:4] == 3 * FRAMES).all()


@pytest.mark.parametrize(("frames", "kept"), [((400, 0), [400]), ((0, 3), [3]), ((0, 0), [])])
def test_a_picture_is_one_if_any_of_its_packets_holds_frames(
    frames: tuple[int, int], kept: list[int]
) -> None:
    """At the end of a capture blocks hold what is left, and some of them nothing."""
    gathered, blocks = SumsBlocks(), []
    for first, held in enumerate(frames):
        part = Sums(
            header=PacketHeader(sequence=first), values=np.zeros((1, 1), np.uint32), widths=(8,),
            picture=7, first_pixel=first, rows=1, cols=2, frames=held, missed=2, tables=1,
        )  # fmt: skip
        blocks += gathered.feed(encode_sums(part))
    assert [block.frames for block in blocks + gathered.finish()] == kept


def test_a_picture_states_which_change_of_depth_would_go_unnoticed(
    camera: hf.Instrument, calibration: hf.Calibration, reduction: Reduction, draw: Draw
) -> None:
    """With so many photons that chance plays no part, a step of more is always told."""
    many: dict[str, Any] = {"photons": 1e6, "frames": 10**8}
    window = GatheredSums()
    wide = replace(reduction.tables, widths=(32,) * reduction.tables.sums)
    reduction = replace(reduction, tables=wide)
    first = pictures_of([draw(camera, depth=0.5, seed=1, **many)], camera, reduction)
    window.add_all(first)
    most = window.reconstruct(calibration).attrs[UNNOTICED]
    assert 0.01 < most < 0.05
    for step, anew in ((0.1 * most, False), (1.3 * most, True)):
        window.clear()
        moved = draw(camera, depth=0.5 + step, seed=2, **many)
        window.add_all([*first, *pictures_of([moved], camera, reduction)])
        assert (window.frames_by_pixel == FRAMES * (1 if anew else 2)).all()


@pytest.mark.parametrize("photons", [2.0, 30.0, 500.0])
@pytest.mark.parametrize("room", [None, ReductionRoom(12, 3, 16)])
def test_chance_reaches_no_deviations_more_often_than_stated(
    camera: hf.Instrument, calibration: hf.Calibration, draw: Draw, photons: float, room: Any
) -> None:
    """Of 15 contrasts of 3,840 tiles, 2 Q(3) = 0.27 % may reach three deviations each."""
    reduction = reduction_of(calibration, picture_frames=FRAMES, room=room)
    contrasts = SumsContrasts.of(reduction.tables)
    tables = reduction.tables.entries.astype(np.float64)
    assert (contrasts.bounds >= contrasts.functions**2 - 1e-9).all()
    mean = draw(camera, photons=10**7, background=10**6)[0, 0].astype(float)
    mean[0] = 0
    mean *= photons / mean.sum()
    rng = np.random.default_rng(5)
    newest, earlier = (
        rng.poisson(share * mean, (48, 80, mean.size)) @ tables.T for share in (1, 4)
    )
    found = contrasts.compare(newest, earlier, np.full((48, 80), 0.25), 1)
    most = len(tables) * 2 * norm.sf(3)
    assert (found > 3).mean() <= most
    assert (found > 2).mean() > 0.002 or photons < 10  # it is no empty statement
