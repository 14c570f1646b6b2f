# SPDX-License-Identifier: Apache-2.0
"""Trials of estimators on counts whose truth is known: drawn from the pulses in continuous time.

The truth comes from the instrument's own pulses, integrated exactly over each bin; estimators
know only a calibration from drawn captures of their own, as a lab would have.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray

import hueflight as hf
from hueflight.analysis import delta_e_2000, lab
from hueflight.color import SpectralModel, tristimulus
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.spectra import WAVELENGTH_NM, band_weights, reflectance
from hueflight.reconstruction.bounds import bounds, expected_shares, fisher_information
from hueflight.reconstruction.uncertainty import reflectance_interval

ROWS = 32  #: each row of an image has its own distance, each column its own photons
DISTANCE_M = 3.0  #: of the reference; every delay that is tried lies in front of the camera
SPAN_NS = 10.0  #: distances lie within so many ns of the reference either way
FRAMES = 2**30  #: so many that no photon shadows another: pile-up has tests of its own
LEAST_BACKGROUND = 2.0  #: photons; with less, single photons between the pulses outweigh all
LEVELS = (0.6827, 0.95)  #: of the intervals, one standard deviation and 1.96 of a Gaussian
REFERENCE_PHOTONS = 1e5  #: a pixel of the reference and of each one-LED capture expects
COLOURS: Mapping[str, str | float] = {
    "white": 1.0,
    "red": "ink red",
    "yellow": "ink yellow",
    "green": "ink green",
    "blue": "ink blue",
}  #: name → surface of the simulator


@dataclass(frozen=True)
class Estimate:
    """What an estimator says of pixels (row, col); bands come last. NaN: it doesn't say."""

    depth: NDArray[np.floating]
    depth_std: NDArray[np.floating]
    reflectance: NDArray[np.floating]
    reflectance_std: NDArray[np.floating]
    limits: tuple[NDArray[np.floating], ...] = ()  #: of reflectance: 68 % low, high, 95 % low, high

    @classmethod
    def of(cls, image: xr.Dataset) -> Estimate:
        """What an image says."""
        limits: tuple[NDArray[np.floating], ...] = ()
        if "white_photons" in image.coords:
            limits = tuple(
                bound.values
                for level in LEVELS
                for bound in reflectance_interval(image, level=level)
            )
        names = ("depth", "depth_std", "reflectance", "reflectance_std")
        return cls(*(image[name].values for name in names), limits=limits)


Estimator = Callable[[NDArray[np.uint32], hf.Calibration], Estimate | xr.Dataset]


@dataclass(frozen=True, eq=False)
class Rig:
    """An instrument, its calibration, and the exact light of each row's distance.

    Attributes
    ----------
    depths : (row,) m.
    shares, slopes : (row, band, bin) of each band's photons, and by the delay (1/ns).
    widths : (bin,) share of the background.
    white : (band,) photons of a white target per exposure as the reference saw it.
    """

    instrument: Instrument
    calibration: hf.Calibration
    depths: NDArray[np.float64]
    shares: NDArray[np.float64]
    slopes: NDArray[np.float64]
    widths: NDArray[np.float64]
    white: NDArray[np.float64]

    @property
    def amplitude_per_reflectance(self) -> NDArray[np.float64]:
        """(band,) photons in `FRAMES` exposures from reflectance 1."""
        return self.white * FRAMES

    @property
    def columns(self) -> int:
        """Pixels of a row."""
        return self.instrument.sensor.cols

    def colour(self, surface: str | float) -> NDArray[np.float64]:
        """(band,) reflectance of a surface of the simulator."""
        return band_weights(self.instrument) @ reflectance(surface)


@lru_cache(maxsize=1)
def rig(tail_ns: float, bin_width_ns: float) -> Rig:
    """The paper's system with LEDs of a given tail and a converter of a given bin width."""
    paper = Instrument.load("paper")
    codes = paper.timing.period_ns / bin_width_ns if paper.timing.period_ns else 0
    sensor = msgspec.structs.replace(
        paper.sensor,
        rows=ROWS,
        cols=64 if bin_width_ns > 0.3 else 16,  # ten times the bins, a quarter of the pixels
        bin_width_ns=bin_width_ns,
        code_bits=max(paper.sensor.code_bits, int(np.ceil(np.log2(codes + 2)))),
    )
    bands = tuple(msgspec.structs.replace(band, pulse_tail_ns=tail_ns) for band in paper.bands)
    instrument = paper.replace(sensor=sensor, bands=bands, lens=None)
    # distances fall anywhere between two codes
    offsets_ns = SPAN_NS * (2 * (np.arange(ROWS) + 0.5) / ROWS - 1)
    depths = DISTANCE_M + offsets_ns * SPEED_OF_LIGHT_M_PER_NS / 2
    light = [expected_shares(instrument, depth) for depth in depths]
    brightness = instrument.band_brightness()
    white = brightness / brightness.sum() * REFERENCE_PHOTONS
    rng = np.random.default_rng([int(10 * tail_ns), int(1000 * bin_width_ns)])
    shares, _, widths = expected_shares(instrument, DISTANCE_M)
    even = np.full(ROWS, 1)[:, None]
    reference = _histogram(instrument, even * (white @ shares), rng)
    captures = np.stack(
        [_histogram(instrument, even * REFERENCE_PHOTONS * share, rng) for share in shares]
    )
    return Rig(
        instrument=instrument,
        calibration=hf.calibrate(reference, instrument, distance=DISTANCE_M, bands=captures),
        depths=depths,
        shares=np.array([shares for shares, _, _ in light]),
        slopes=np.array([slopes for _, slopes, _ in light]),
        widths=widths,
        white=white / FRAMES,
    )


def _histogram(
    instrument: Instrument, mean: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.uint32]:
    """Counts (row, col, code) where every row expects `mean` (row, bin)."""
    bins = instrument.time_bins()
    drawn = rng.poisson(mean[:, None, :], (ROWS, instrument.sensor.cols, bins.count))
    histogram = np.zeros(instrument.histogram_shape, np.uint32)
    histogram[..., bins.codes] = drawn
    histogram[..., 0] = FRAMES - drawn.sum(axis=-1)
    return histogram


@dataclass(frozen=True)
class Cell:
    """One condition.

    Attributes
    ----------
    colour : name in `COLOURS`.
    photons : signal photons expected of a pixel in all.
    background : background photons per signal photon.
    """

    colour: str
    photons: float
    background: float
    tail_ns: float
    bin_width_ns: float


@dataclass(frozen=True)
class Outcome:
    """How an estimator did in a cell.

    Attributes
    ----------
    depth_ratio : RMSE of depth ÷ bound; mislocks (beyond 5 ns and 6 bounds) left out.
    depth_bias_mm : mean error of depth, the same pixels, less what is chance by the truth; and
        `depth_bias_noise_mm` its standard error.
    mislocks : share of pixels with a depth that locked elsewhere.
    missing : share of pixels that gave no depth.
    reflectance_bias : (band,) mean error ÷ reflectance of the brightest band, in the same way;
        and `reflectance_bias_noise` its standard error.
    reflectance_ratio : (band,) spread ÷ bound.
    depth_cover, reflectance_cover : shares (2,) and (band, 2) of truths within the 68 and 95 %
        intervals that the estimator states; NaN if it states none.
    delta_e : mean CIEDE2000 of colours from the bands against the surface's own.
    pixels_per_s : speed; it is only a ratio's numerator.
    """

    depth_ratio: float
    depth_bias_mm: float
    depth_bias_noise_mm: float
    mislocks: float
    missing: float
    reflectance_bias: NDArray[np.float64]
    reflectance_bias_noise: NDArray[np.float64]
    reflectance_ratio: NDArray[np.float64]
    depth_cover: NDArray[np.float64]
    reflectance_cover: NDArray[np.float64]
    delta_e: float
    pixels_per_s: float


def run_cell(
    cell: Cell,
    estimators: Mapping[str, Estimator],
    *,
    pixels: int,
    seed: int = 0,
    made: Rig | None = None,
) -> dict[str, Outcome]:
    """Every estimator on the same counts of about so many pixels, by default of the cell's rig."""
    if made is None:
        made = rig(cell.tail_ns, cell.bin_width_ns)
    colour = made.colour(COLOURS[cell.colour])
    amplitudes = made.white * colour
    amplitudes *= cell.photons / amplitudes.sum()
    background = cell.photons * cell.background
    limits = np.array(
        [
            bounds(
                fisher_information(shares, slopes, made.widths, amplitudes, background),
                background=background,
            )
            for shares, slopes in zip(made.shares, made.slopes, strict=True)
        ]
    )
    mean = np.einsum("k,rkb->rb", amplitudes, made.shares) + background * made.widths
    rng = np.random.default_rng([seed, int(cell.photons), int(100 * cell.background)])
    chance = _linear_errors(made, amplitudes, mean, background)
    strays = []
    found: dict[str, list[Estimate]] = {name: [] for name in estimators}
    seconds = dict.fromkeys(estimators, 0.0)
    rounds = max(1, round(pixels / (ROWS * made.columns)))
    for number in range(rounds):
        histogram = _histogram(made.instrument, mean, rng)
        strays.append(chance(histogram))
        for name, estimate in estimators.items():
            if number == 0:
                estimate(histogram, made.calibration)  # tables are made once, not per image
            start = time.perf_counter()
            image = estimate(histogram, made.calibration)
            seconds[name] += time.perf_counter() - start
            found[name].append(image if isinstance(image, Estimate) else Estimate.of(image))
    truth = Truth(
        depths=np.repeat(made.depths, made.columns),
        limits=np.repeat(limits, made.columns, axis=0),
        amplitudes=amplitudes,
        surface=COLOURS[cell.colour],
        strays=np.concatenate(strays),
    )
    return {
        name: _outcome(found[name], truth, made, rounds * len(truth.depths) / seconds[name])
        for name in estimators
    }


def _linear_errors(
    made: Rig, amplitudes: NDArray[np.float64], mean: NDArray[np.float64], background: float
) -> Callable[[NDArray[np.uint32]], NDArray[np.float64]]:
    """Errors (pixel, parameter) of one step from the truth: delay in ns, photons, background.

    The step is linear in the counts, so that its errors' mean is exactly 0. A good estimator makes
    nearly the same errors, and what it makes beside them shows its bias through far less noise
    (control variates).
    """
    steps = []
    for shares, slopes, expected in zip(made.shares, made.slopes, mean, strict=True):
        model = np.vstack([amplitudes @ slopes, shares, made.widths])
        weighted = model / (expected + max(0.0, LEAST_BACKGROUND - background) * made.widths)
        steps.append(np.linalg.solve(weighted @ model.T, weighted))
    codes = made.instrument.time_bins().codes

    def errors(histogram: NDArray[np.uint32]) -> NDArray[np.float64]:
        noise = histogram[..., codes] - mean[:, None, :]
        return (noise @ np.swapaxes(steps, 1, 2)).reshape(-1, len(amplitudes) + 2)

    return errors


@dataclass(frozen=True, eq=False)
class Truth:
    """What the pixels (pixel,) of one image of a cell are.

    Attributes
    ----------
    depths : (pixel,) m; limits : (pixel, parameter) bounds of delay (ns), photons, background.
    amplitudes : (band,) photons; surface : of the simulator.
    strays : (all pixels, parameter) errors by chance alone, of all images; see `_linear_errors`.
    """

    depths: NDArray[np.float64]
    limits: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    surface: str | float
    strays: NDArray[np.float64]


def _outcome(estimates: list[Estimate], true: Truth, made: Rig, pixels_per_s: float) -> Outcome:
    metres = SPEED_OF_LIGHT_M_PER_NS / 2
    per_photon = 1 / made.amplitude_per_reflectance
    reflectances = true.amplitudes * per_photon
    bound = np.tile(true.limits[:, 0] * metres, len(estimates))

    def flat(parts: list[NDArray[np.floating]]) -> NDArray[np.float64]:
        return np.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts]).astype(float)

    error = flat([part.depth for part in estimates]) - np.tile(true.depths, len(estimates))
    given = np.isfinite(error)
    locked = np.abs(error) < np.maximum(5.0 * metres, 6 * bound)
    deviation = flat([part.depth_std for part in estimates])
    found = flat([part.reflectance for part in estimates])
    stated = flat([part.reflectance_std for part in estimates])
    off = found - reflectances
    known = np.isfinite(off).all(axis=-1) & locked
    best = true.limits[:, 1 : 1 + reflectances.size] * per_photon
    chance = true.strays[:, 0] * metres
    band_chance = true.strays[:, 1 : 1 + reflectances.size] * per_photon
    left, band_left = (error - chance)[locked], (off - band_chance)[known]
    error, off = error[locked], off[known]
    few = max(int(known.sum()), 1)
    nothing = np.full(reflectances.shape, np.nan)
    brightest = reflectances.max()
    within = np.full((*reflectances.shape, 2), np.nan)
    if estimates[0].limits:
        ends = [flat([part.limits[i] for part in estimates])[known] for i in range(4)]
        within = np.stack(
            [
                ((low <= reflectances) & (reflectances <= high)).mean(axis=0)
                for low, high in (ends[:2], ends[2:])
            ],
            axis=-1,
        )
    cover = [(np.abs(error) < width * deviation[locked]).mean() for width in (1.0, 1.96)]
    return Outcome(
        depth_ratio=float(np.sqrt(np.mean(error**2) / np.mean(bound[locked] ** 2))),
        depth_bias_mm=float((error.mean() - chance.mean()) * 1e3),
        depth_bias_noise_mm=float(left.std() / np.sqrt(max(locked.sum(), 1)) * 1e3),
        mislocks=float(1 - locked[given].mean()) if given.any() else np.nan,
        missing=float(1 - given.mean()),
        reflectance_bias=(
            (off.mean(axis=0) - band_chance.mean(axis=0)) / brightest if len(off) else nothing
        ),
        reflectance_bias_noise=(
            band_left.std(axis=0) / brightest / np.sqrt(few) if len(off) else nothing
        ),
        reflectance_ratio=(
            off.std(axis=0) / np.sqrt(np.mean(best**2, axis=0)) if len(off) else nothing
        ),
        depth_cover=np.array(cover) if np.isfinite(deviation).any() else np.full(2, np.nan),
        reflectance_cover=within,
        delta_e=_delta_e(found[known][:2000], stated[known][:2000], true, made),
        pixels_per_s=pixels_per_s,
    )


def _delta_e(
    found: NDArray[np.float64], stated: NDArray[np.float64], true: Truth, made: Rig
) -> float:
    """Mean CIEDE2000 under D65 of colours behind band values against the surface's own."""
    if not len(found):
        return float("nan")
    per_photon = 1 / made.amplitude_per_reflectance
    unit = made.colour(true.surface).max() / (true.amplitudes * per_photon).max()
    model = SpectralModel.of(made.instrument)
    xyz, _ = model.recover(
        found * unit, stated * unit, model.to_xyz(), per_photon=per_photon * unit
    )
    weights = tristimulus(WAVELENGTH_NM)
    white = weights.sum(axis=1)
    own = lab(weights @ reflectance(true.surface), white=white)
    return float(delta_e_2000(lab(np.maximum(xyz, 0), white=white), own).mean())
