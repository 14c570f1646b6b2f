# SPDX-License-Identifier: Apache-2.0
"""A forward model of the paper's instrument that shares no code with the project.

It draws the histograms on which the project is judged: pulses are exponentially modified
Gaussians of SciPy in continuous time, integrated exactly over each bin; Table 1 of the paper and
the geometry of its sensor are typed here a second time, on purpose. Only the calibration and the
estimators that are judged come from the project.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import exponnorm, norm

import hueflight as hf

PERIOD_NS = 320.0
BIN_NS = 0.642
LATENCY_NS = 25.0
CODES = 512
METERS_PER_NS = 0.299792458 / 2  #: of round-trip time
REFERENCE_M = 1.0  #: distance of the reference target of `calibrated`


@dataclass(frozen=True)
class Led:
    """One LED and its pulse.

    Attributes
    ----------
    wavelength_nm : float
        Center of its emission, nm.
    delay_ns : float
        Delay of its pulse, ns.
    fwhm_ns : float
        Full width at half maximum of the pulse's Gaussian part, ns.
    tail_ns : float
        Decay constant of its exponential tail, ns.
    brightness : float
        Detected photons from a white target, relative to the other LEDs.
    """

    wavelength_nm: float
    delay_ns: float
    fwhm_ns: float
    tail_ns: float
    brightness: float


#: Delays and widths of Table 1 of the paper; brightness is its power times the sensor's response.
LEDS = (
    Led(659, 0, 11.8, 3.0, 0.90),
    Led(632, 30, 13.9, 3.0, 0.44),
    Led(623, 60, 11.9, 3.0, 0.44),
    Led(597, 90, 13.0, 3.0, 0.13),
    Led(525, 120, 11.2, 3.0, 0.46),
    Led(498, 150, 9.3, 3.0, 0.55),
    Led(469, 180, 11.3, 3.0, 0.76),
    Led(445, 210, 7.5, 3.0, 1.12),
    Led(418, 240, 7.1, 3.0, 0.95),
)
#: Reflectance of four colored surfaces in these bands, from white to saturated.
COLORS = {
    "white": np.ones(9),
    "red": np.array([0.80, 0.75, 0.70, 0.40, 0.06, 0.05, 0.05, 0.05, 0.05]),
    "green": np.array([0.06, 0.06, 0.07, 0.12, 0.55, 0.45, 0.15, 0.08, 0.06]),
    "blue": np.array([0.05, 0.05, 0.05, 0.05, 0.10, 0.25, 0.60, 0.65, 0.60]),
}


def edges_ns(bin_ns: float = BIN_NS) -> NDArray[np.float64]:
    """Return the edges of the bins in time order, shape (bin + 1,), ns.

    The converter counts from the photon to the end of the period, so the first bin in time is the
    incomplete one.
    """
    count = int(np.ceil(PERIOD_NS / bin_ns))
    return np.maximum(PERIOD_NS - bin_ns * np.arange(count, -1, -1), 0.0)


def pulse_shares(
    arrival_ns: ArrayLike, fwhm_ns: float, tail_ns: float, edges: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the share of a pulse in each bin, shape (..., bin).

    Parameters
    ----------
    arrival_ns : array_like
        Arrival of the center of the pulse's Gaussian part, ns; any shape.
    fwhm_ns, tail_ns : float
        Width of the Gaussian part and decay constant of the tail, ns; a tail of 0 is a Gaussian.
    edges : ndarray of float, shape (bin + 1,)
        Edges of the bins, ns.
    """
    arrival = np.asarray(arrival_ns, float)[..., None] % PERIOD_NS
    sigma = fwhm_ns / np.sqrt(8 * np.log(2))
    kind = exponnorm(tail_ns / sigma, scale=sigma) if tail_ns > 0 else norm(scale=sigma)
    # the pulse of this period, the end of the one before it and the start of the next
    total = sum(kind.cdf(edges + turn - arrival) for turn in (-PERIOD_NS, 0.0, PERIOD_NS))
    return np.diff(total, axis=-1)


def band_shares(
    depth_m: ArrayLike, leds: Sequence[Led] = LEDS, edges: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return each band's share of light in each bin from given depths, shape (..., band, bin)."""
    edges = edges_ns() if edges is None else edges
    depth = np.asarray(depth_m, float)
    return np.stack(
        [
            pulse_shares(
                LATENCY_NS + led.delay_ns + depth / METERS_PER_NS, led.fwhm_ns, led.tail_ns, edges
            )
            for led in leds
        ],
        axis=-2,
    )


def amplitudes(
    reflectance: ArrayLike, photons: ArrayLike, leds: Sequence[Led] = LEDS
) -> NDArray[np.float64]:
    """Return photons of each band, shape (..., band), that sum to `photons`."""
    light = np.asarray(reflectance, float) * [led.brightness for led in leds]
    return light / light.sum(axis=-1, keepdims=True) * np.asarray(photons, float)[..., None]


def expected(
    depth_m: ArrayLike,
    band_photons: NDArray[np.float64],
    background: ArrayLike = 0.0,
    *,
    leds: Sequence[Led] = LEDS,
    edges: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return expected counts in time order, shape (..., bin), of one surface.

    Parameters
    ----------
    depth_m : array_like
        Depth of the surface, m.
    band_photons : ndarray of float, shape (..., band)
        Photons of each band.
    background : array_like
        Photons of uniform background in all.
    leds : sequence of Led
        The light sources.
    edges : ndarray of float, shape (bin + 1,), optional
        Edges of the bins, ns.
    """
    edges = edges_ns() if edges is None else edges
    light = np.einsum("...k,...kb->...b", band_photons, band_shares(depth_m, leds, edges))
    return light + np.asarray(background, float)[..., None] * np.diff(edges) / PERIOD_NS


def drawn(
    mean: NDArray[np.float64], rng: np.random.Generator, *, frames: int = 2**30
) -> NDArray[np.uint32]:
    """Draw raw histograms, shape (row, col, code), from expected counts (row, col, bin).

    The default number of frames is so large that no photon shadows another.
    """
    counts = rng.poisson(mean)
    histogram = np.zeros((*mean.shape[:-1], CODES), np.uint32)
    histogram[..., mean.shape[-1] : 0 : -1] = counts  # later photons have smaller codes
    histogram[..., 0] = frames - counts.sum(axis=-1)
    return histogram


def bound_m(
    depth_m: float,
    band_photons: NDArray[np.float64],
    background: float,
    *,
    leds: Sequence[Led] = LEDS,
) -> float:
    """Return the Cramér-Rao bound of depth, m: all amplitudes and the background unknown."""
    step = 1e-4
    slope = (
        expected(depth_m + step, band_photons, leds=leds)
        - expected(depth_m - step, band_photons, leds=leds)
    ) / (2 * step)
    mean = expected(depth_m, band_photons, background, leds=leds)
    width = np.diff(edges_ns())[None] / PERIOD_NS
    model = np.concatenate([slope[None], band_shares(depth_m, leds), width])
    information = (model / np.maximum(mean, 1e-12)) @ model.T
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


def drawn_first_photons(
    mean: NDArray[np.float64], rng: np.random.Generator, *, frames: int
) -> NDArray[np.uint32]:
    """Draw raw histograms of exposures of one period, of which each keeps its first photon.

    Parameters
    ----------
    mean : ndarray of float, shape (row, col, bin)
        Expected photons of one period.
    rng : Generator
        Random numbers.
    frames : int
        Number of exposures.

    Returns
    -------
    ndarray of uint32, shape (row, col, code)
        Counts; code 0 holds the exposures without a photon.
    """
    silent = np.exp(-np.cumsum(mean, axis=-1))  # probability of no photon up to the end of a bin
    first = -np.diff(silent, axis=-1, prepend=1.0)
    outcomes = np.concatenate([first, silent[..., -1:]], axis=-1)
    counts = rng.multinomial(frames, outcomes)
    histogram = np.zeros((*mean.shape[:-1], CODES), np.uint32)
    histogram[..., mean.shape[-1] : 0 : -1] = counts[..., :-1]
    histogram[..., 0] = counts[..., -1]
    return histogram


def instrument(rows: int, cols: int, *, one_period: bool = False) -> hf.Instrument:
    """Return the project's description of this instrument, without a lens.

    With `one_period`, an exposure is one period instead of 1 ms.
    """
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=rows, cols=cols)
    if one_period:
        sensor = msgspec.structs.replace(sensor, exposure_ms=None)
    return paper.replace(sensor=sensor, lens=None)


def calibrated(
    rows: int,
    cols: int,
    *,
    photons: float = 3000.0,
    one_led_photons: float = 600.0,
    distance_m: float = REFERENCE_M,
    leds: Sequence[Led] = LEDS,
    seed: int = 0,
    one_period: bool = False,
) -> hf.Calibration:
    """Calibrate from drawn captures of a white target, as a lab would.

    Parameters
    ----------
    rows, cols : int
        Geometry of the sensor.
    photons, one_led_photons : float
        Photons of a pixel of the reference and of each capture with one LED.
    distance_m : float
        Distance of the target, m.
    leds : sequence of Led
        The light sources as they were on the day of the calibration.
    seed : int
        Seed of the draws.
    one_period : bool
        Whether an exposure is one period. The captures are too dim for pile-up either way.
    """
    rng = np.random.default_rng([seed, rows, cols])
    plain = np.ones((rows, cols))

    def capture(light: NDArray[np.float64], background: float) -> NDArray[np.uint32]:
        mean = expected(distance_m, light, background, leds=leds)
        return drawn(plain[..., None] * mean, rng)

    white = amplitudes(np.ones(len(leds)), photons, leds)
    one_by_one = [capture(one_led_photons * one, one_led_photons / 20) for one in np.eye(len(leds))]
    return hf.calibrate(
        capture(white, photons / 20),
        instrument(rows, cols, one_period=one_period),
        distance=distance_m,
        bands=np.stack(one_by_one),
    )


def drifted(
    leds: Sequence[Led] = LEDS,
    *,
    delay_ps: ArrayLike = 0.0,
    width_factor: ArrayLike = 1.0,
) -> tuple[Led, ...]:
    """Return the LEDs with delays and pulse widths as they have become on another day."""
    delays = np.broadcast_to(np.asarray(delay_ps, float), (len(leds),))
    factors = np.broadcast_to(np.asarray(width_factor, float), (len(leds),))
    return tuple(
        replace(
            led,
            delay_ns=led.delay_ns + delay / 1000,
            fwhm_ns=led.fwhm_ns * factor,
            tail_ns=led.tail_ns * factor,
        )
        for led, delay, factor in zip(leds, delays, factors, strict=True)
    )
