# SPDX-License-Identifier: Apache-2.0
"""Pixels at edges that see two surfaces: how many wrong depths are left without a flag.

Geometry and light of the scene of Fig. 1 come from the simulator's ground truth, by several rays
for each pixel; discs and bars are drawn here. Photons come from the outside model in every case.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import msgspec
import numpy as np
import xarray as xr
from acceptance import Row
from numpy.typing import NDArray
from outside_model import COLORS, amplitudes, band_shares, drawn, edges_ns

import hueflight as hf
from hueflight.simulator import SimulationSettings, effect_truth, scene

GRID_M = 0.002  #: between tabulated path lengths; waveforms are linear between them
NEAREST_M, FARTHEST_M = 0.4, 2.6
RAYS = 8  #: along each side of a pixel that sees a disc or a bar
STEP_M = 0.2  #: of a pixel of Fig. 1 that counts as mixed
LEAST_PHOTONS = 600
DISC_SIZE = (48, 64)

Floats = NDArray[np.float64]


@cache
def waveforms() -> NDArray[np.float32]:
    """Return the share of each band's light in each bin, shape (path, band, bin)."""
    paths = np.arange(NEAREST_M, FARTHEST_M + GRID_M, GRID_M)
    return band_shares(paths).astype(np.float32)


def seen(path_m: Floats, photons: Floats) -> Floats:
    """Return expected counts (row, col, bin) of light (row, col, band) from given distances."""
    table = waveforms()
    flat = photons.reshape(-1, photons.shape[-1]).astype(np.float32)
    place = (path_m.ravel() - NEAREST_M) / GRID_M
    whole = np.clip(place.astype(int), 0, len(table) - 2)
    part = (place - whole).astype(np.float32)[:, None]
    mean = np.empty((len(flat), table.shape[-1]))
    for first in range(0, len(flat), 512):
        of = slice(first, first + 512)
        before = np.einsum("pk,pkb->pb", flat[of] * (1 - part[of]), table[whole[of]])
        after = np.einsum("pk,pkb->pb", flat[of] * part[of], table[whole[of] + 1])
        mean[of] = before + after
    return mean.reshape(*path_m.shape, -1)


def flat_light(photons: Floats) -> Floats:
    """Return expected counts (row, col, bin) of uniform background (row, col)."""
    width = np.diff(edges_ns())
    return photons[..., None] * width / width.sum()


@cache
def instrument_and_calibration(
    rows: int, cols: int
) -> tuple[hf.Instrument, hf.Calibration, Floats]:
    """Return the instrument, a calibration at 1 m, and the cosine of each pixel's ray."""
    paper = hf.Instrument.load("paper")
    instrument = paper.replace(sensor=msgspec.structs.replace(paper.sensor, rows=rows, cols=cols))
    cosine = instrument.ray_cosine()
    rng = np.random.default_rng([7, rows, cols])

    def capture(light: Floats, background: float) -> NDArray[np.uint32]:
        everywhere = np.broadcast_to(light, (rows, cols, light.size))
        mean = seen(1 / cosine, everywhere) + flat_light(np.full((rows, cols), background))
        return drawn(mean, rng)

    leds = np.stack([capture(600 * one, 30) for one in np.eye(9)])
    reference = capture(amplitudes(np.ones(9), 3000), 150)
    return instrument, hf.calibrate(reference, instrument, distance=1.0, bands=leds), cosine


def flagged(image: xr.Dataset, *flags: hf.Quality) -> NDArray[np.bool_]:
    """Return the pixels of an image with one of these flags."""
    wanted = sum(int(flag) for flag in flags)
    return (image["quality"].values & wanted) != 0


class Tally:
    """Counts of pixels over several pictures."""

    def __init__(self) -> None:
        names = "mixed wrong missed clean false inside unflagged"
        self.sums: dict[str, int] = dict.fromkeys(names.split(), 0)
        self.shares: list[Floats] = []

    def add(
        self,
        image: xr.Dataset,
        depths: tuple[Floats, Floats],
        mixed: NDArray[np.bool_],
        judged: NDArray[np.bool_],
        share: Floats | None = None,
    ) -> None:
        """Add a picture whose pixels see surfaces at `depths`, two different ones if `mixed`."""
        depth = image["depth"].values
        std = image["depth_std"].values
        told = hf.Quality.MIXED, hf.Quality.TWO_RETURNS, hf.Quality.MISFIT, hf.Quality.AMBIGUOUS
        mark = flagged(image, *told)
        off = np.minimum(*(np.abs(depth - true) for true in depths))
        known = judged & np.isfinite(depth)
        here = known & mixed
        wrong = off > 3 * std
        unflagged = known & ~mark
        for name, value in {
            "mixed": here,
            "wrong": here & (wrong | mark),
            "missed": here & wrong & ~mark,
            "clean": known & ~mixed,
            "false": known & ~mixed & mark,
            "inside": unflagged & (off < std),
            "unflagged": unflagged,
        }.items():
            self.sums[name] += int(value.sum())
        if share is not None:
            found = image["near_share"].values
            known = here & np.isfinite(found)
            self.shares.append((found - share)[known])

    def ratio(self, part: str, whole: str) -> float:
        """Return one count as a share of another."""
        return self.sums[part] / max(self.sums[whole], 1)


def rows(quick: bool) -> Iterator[Row]:
    """Wrong depths at edges, false flags beside them, and the error of what is stated."""
    for median in (900, 2500):
        tally = _figure_1(median, seeds=1 if quick else 4)
        name = f"Fig. 1 with footprint, median {median} photons"
        missed, false = tally.ratio("missed", "mixed"), tally.ratio("false", "clean")
        cover = tally.ratio("inside", "unflagged")
        yield Row(
            f"{name}, steps ≥ 20 cm, ≥ 600 photons: wrong and unflagged, of mixed pixels",
            f"{missed:.2%} of {tally.sums['mixed']}", "≤ 2 %", "≤ .5 %", missed <= 0.02,
        )  # fmt: skip
        yield Row(f"{name}: flagged, of other pixels", f"{false:.2%}", "≤ .6 %", "≤ .3 %",
                  false <= 0.006)  # fmt: skip
        yield Row(f"{name}: 68 % interval of unflagged pixels covers", f"{cover:.1%}", "66-70 %",
                  "68.3 %", 0.66 <= cover <= 0.70)  # fmt: skip
    for width, limit in ((2.5, 0.02), (4.0, 0.02), (1.5, None)):
        tally = _bars(width, seeds=1 if quick else 6)
        missed, false = tally.ratio("missed", "mixed"), tally.ratio("false", "clean")
        name = f"white bars {width:g} px wide, 30 cm, 620 photons"
        yield Row(
            f"{name}: wrong and unflagged, of mixed pixels",
            f"{missed:.2%} of {tally.sums['mixed']}",
            "≤ 2 %" if limit else "stated", "≤ 1 %" if limit else "≤ 5 %",
            None if limit is None else missed <= limit,
        )  # fmt: skip
        yield Row(f"{name}: flagged, of other pixels", f"{false:.2%}", "≤ .6 %", "≤ .3 %",
                  false <= 0.006)  # fmt: skip
    for near, far, step in (
        ("white", "white", 0.2), ("white", "white", 0.4), ("red", "blue", 0.2),
        ("green", "white", 0.2),
    ):  # fmt: skip
        tally = _discs(near, far, step, seeds=1 if quick else 6)
        missed, found = tally.ratio("missed", "mixed"), tally.ratio("wrong", "mixed")
        error = np.sqrt(np.mean(np.concatenate(tally.shares) ** 2))
        name = f"{near} disc {step * 100:.0f} cm before {far}, 620 photons"
        yield Row(
            f"{name}: wrong and unflagged, of mixed pixels",
            f"{missed:.2%} of {tally.sums['mixed']}", "≤ 2 %", "≤ .5 %", missed <= 0.02,
        )  # fmt: skip
        yield Row(f"{name}: wrong or flagged, of mixed pixels; rms error of the share",
                  f"{found:.0%}; {error:.3f}")  # fmt: skip


def figure_1(
    median: float,
) -> tuple[hf.Calibration, Floats, NDArray[np.float64], NDArray[np.float64]]:
    """Return the scene of Fig. 1, whose pixels have a footprint.

    Parameters
    ----------
    median : float
        Median of the pixels' photons, background excepted.

    Returns
    -------
    calibration : Calibration
        Calibration of the instrument that looks at it.
    mean : ndarray of float, shape (row, col, bin)
        Expected counts.
    depths : ndarray of float, shape (2, row, col)
        Depths of the nearest and the farthest surface in each pixel, m.
    total : ndarray of float, shape (row, col)
        Expected photons of the LEDs.
    """
    size = (192, 128)
    instrument, calibration, cosine = instrument_and_calibration(*size)
    truth = effect_truth(scene("fig1", instrument, rays=4), instrument, SimulationSettings.ideal())
    scale = median / np.median(truth.photons.sum(axis=(0, 1)))
    depths = np.where(np.isfinite(truth.depths), truth.depths, truth.depths[0])
    light = np.moveaxis(truth.photons, 1, -1) * scale
    # the same steady light on all pixels, a tenth of the median
    mean = flat_light(np.full(size, median / 10))
    for depth, photons in zip(depths, light, strict=True):
        mean += seen(depth / cosine, photons)
    return calibration, mean, depths, light.sum(axis=(0, -1))


def _figure_1(median: float, *, seeds: int) -> Tally:
    calibration, mean, depths, total = figure_1(median)
    step = depths[1] - depths[0]
    mixed = step > 0
    judged = (total >= LEAST_PHOTONS) & (~mixed | (step >= STEP_M))
    tally = Tally()
    for seed in range(seeds):
        image = hf.reconstruct(drawn(mean, np.random.default_rng([11, seed])), calibration)
        tally.add(image, (depths[0], depths[1]), mixed, judged)
    return tally


def _share_of_disc(seed: int) -> Floats:
    rows, cols = DISC_SIZE
    row, col = np.random.default_rng([12, seed]).uniform(-0.5, 0.5, 2)
    y = (np.arange(rows * RAYS) + 0.5) / RAYS - rows / 2 - row
    x = (np.arange(cols * RAYS) + 0.5) / RAYS - cols / 2 - col
    hit = y[:, None] ** 2 + x**2 < 18**2
    return hit.reshape(rows, RAYS, cols, RAYS).mean(axis=(1, 3))


def _share_of_bars(width: float, seed: int) -> Floats:
    rows, cols = DISC_SIZE
    start, slope = np.random.default_rng([13, seed]).uniform(0, (12, 0.2))
    y = (np.arange(rows * RAYS) + 0.5) / RAYS
    x = (np.arange(cols * RAYS) + 0.5) / RAYS
    hit = (x + slope * y[:, None] + start) % 12 < width
    return hit.reshape(rows, RAYS, cols, RAYS).mean(axis=(1, 3))


def _two_surfaces(share: Floats, near: str, far: str, step: float, seed: int) -> xr.Dataset:
    _, calibration, cosine = instrument_and_calibration(*DISC_SIZE)
    mean = flat_light(np.full(DISC_SIZE, 62.0))
    for part, color, depth in ((share, near, 1.0), (1 - share, far, 1.0 + step)):
        mean += seen(depth / cosine, part[..., None] * amplitudes(COLORS[color], 620))
    return hf.reconstruct(drawn(mean, np.random.default_rng([14, seed])), calibration)


def _tally(shares: list[Floats], near: str, far: str, step: float) -> Tally:
    tally = Tally()
    for seed, share in enumerate(shares):
        image = _two_surfaces(share, near, far, step, seed)
        mixed = (share > 0) & (share < 1)
        # a pixel that sees one surface is judged by that one
        first = np.where(share > 0, 1.0, 1.0 + step)
        second = np.where(share < 1, 1.0 + step, 1.0)
        tally.add(image, (first, second), mixed, np.ones_like(mixed), share)
    return tally


def _discs(near: str, far: str, step: float, *, seeds: int) -> Tally:
    return _tally([_share_of_disc(seed) for seed in range(seeds)], near, far, step)


def _bars(width: float, *, seeds: int) -> Tally:
    return _tally([_share_of_bars(width, seed) for seed in range(seeds)], "white", "white", 0.3)
