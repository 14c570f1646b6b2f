# SPDX-License-Identifier: Apache-2.0
"""Departures that all pixels share: drift of LEDs, background that is not flat, tails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from acceptance import Row
from numpy.typing import NDArray
from outside_model import (
    BIN_NS,
    LEDS,
    PERIOD_NS,
    Led,
    amplitudes,
    calibrated,
    drawn,
    drifted,
    edges_ns,
    expected,
)

import hueflight as hf
from hueflight.reconstruction import NO_SKIPS, with_floor

COLORS = 50  #: smooth spectra of a picture
DRIFT_PS = np.array([-37.0, 159, 139, -117, -86, -119, 42, -50, 68])
NEAR_M, FAR_M = 0.8, 1.6
#: share and mean of the exponential delay (ns), and photons of a pixel
TAILS = ((0.2, 3.0, 620.0), (0.2, 3.0, 10_000.0), (0.1, 15.0, 10_000.0), (0.2, 6.0, 10_000.0))


def rows(quick: bool) -> Iterator[Row]:
    """Drift, its correction, a ramp of the background, and the floor of tails."""
    shape = (64, 48) if quick else (192, 128)
    calibration = calibrated(*shape)
    yield from _drift_rows(shape, calibration)
    yield from _ramp_rows(shape, calibration)
    small = (64, 48)
    calibration = calibrated(*small)
    for share, mean_ns, photons in TAILS:
        yield _tail_row(small, calibration, share, mean_ns, photons)


def _spectra() -> NDArray[np.float64]:
    """(color, band) smooth reflectances, from dark to bright and from pale to saturated."""
    rng = np.random.default_rng(3)
    x = (np.array([led.wavelength_nm for led in LEDS]) - 530) / 120
    weights = rng.standard_normal((3, COLORS, 1))
    smooth = 0.25 * weights[0] * x + 0.1 * weights[1] * (3 * x**2 - 1) + 0.15 * weights[2]
    return np.clip(0.5 + smooth, 0.03, 1)


def _picture(
    shape: tuple[int, int],
    *,
    leds: Sequence[Led] = LEDS,
    photons: float = 620.0,
    background: float = 62.0,
    ramp: float = 0.0,
    tail: tuple[float, float] = (0.0, 1.0),
    seed: int = 0,
) -> tuple[NDArray[np.uint32], NDArray[np.float64], NDArray[np.float64]]:
    """Histogram, depth (row, col) and band photons (row, col, band) of patches of 50 colors."""
    depths = np.linspace(NEAR_M, FAR_M, COLORS)
    light = amplitudes(_spectra(), photons)
    mean = expected(depths, light, leds=leds)
    if tail[0]:
        delays = np.exp(-np.arange(mean.shape[-1]) * BIN_NS / tail[1])
        spectrum = np.fft.rfft(mean) * np.fft.rfft(delays / delays.sum())
        mean = (1 - tail[0]) * mean + tail[0] * np.fft.irfft(spectrum, mean.shape[-1])
    u = edges_ns() / PERIOD_NS
    mean = mean + background * np.diff(u - ramp * u * (1 - u))
    which = (np.arange(shape[0] * shape[1]) % COLORS).reshape(shape)
    rng = np.random.default_rng([11, seed])
    return drawn(np.maximum(mean, 0)[which], rng), depths[which], light[which]


def _drift_rows(shape: tuple[int, int], calibration: hf.Calibration) -> Iterator[Row]:
    drift = DRIFT_PS - DRIFT_PS.mean()
    drift *= 100 / np.sqrt(np.mean(drift**2))
    leds = drifted(LEDS, delay_ps=drift)
    histogram, _, _ = _picture(shape, leds=leds)
    correction = hf.correct_drift(histogram, calibration, hf.reconstruct(histogram, calibration))
    found = np.array(correction.calibration.provenance["drift"]["delay_ps"])
    error = np.sqrt(np.mean((found - drift) ** 2))
    stated = np.sqrt(np.mean(np.square(correction.after["delay"].deviations)))
    yield Row(
        "drift of LEDs by 100 ps rms, one picture of 620 photons: error of the delays, rms",
        f"{error:.1f} ps (stated {stated:.1f})", "≤ 10 ps", "1.15 × stated", bool(error <= 10),
    )  # fmt: skip
    plain = _colour_bias_mm(shape, calibration, LEDS)
    before = _colour_bias_mm(shape, calibration, leds) - plain
    after = _colour_bias_mm(shape, correction.calibration, leds) - plain
    rms, worst = np.sqrt(np.mean(after**2)), np.abs(after).max()
    yield Row(
        "… depth bias over 50 colors before the correction: rms, worst",
        f"{np.sqrt(np.mean(before**2)):.1f}, {np.abs(before).max():.1f} mm",
    )
    yield Row(
        "… and with it", f"{rms:.2f}, {worst:.2f} mm", "≤ 1, 2 mm", ".3, 1 mm",
        bool(rms <= 1 and worst <= 2),
    )  # fmt: skip


def _colour_bias_mm(
    shape: tuple[int, int], calibration: hf.Calibration, leds: Sequence[Led]
) -> NDArray[np.float64]:
    """(color,) depth errors without noise, mm."""
    scale = 1e6
    mean = expected(np.full(COLORS, 1.3), amplitudes(_spectra(), scale), scale / 10, leds=leds)
    histogram = np.zeros((*shape, 512), np.uint32)
    flat = histogram.reshape(-1, 512)
    flat[:COLORS, mean.shape[-1] : 0 : -1] = np.rint(mean)
    flat[:, 0] = 2**30
    image = hf.reconstruct(histogram, calibration, skips=NO_SKIPS)
    return 1e3 * (image["depth"].values.ravel()[:COLORS].astype(float) - 1.3)


def _ramp_rows(shape: tuple[int, int], calibration: hf.Calibration) -> Iterator[Row]:
    white = amplitudes(np.ones(len(LEDS)), 620.0)
    for ramp in (0.5, -0.5):
        histogram, _, light = _picture(shape, background=620.0, ramp=ramp, seed=1)
        bias = []
        for background in ("flat", "sloped"):
            image = hf.reconstruct(histogram, calibration, background=background)
            photons = image["white_photons"].values[..., None] * image["white_share"].values
            error = (image["reflectance"].values * photons - light) / white
            bias.append(np.nanmean(error, axis=(0, 1)))
        (flat, worst_flat), (rms, worst) = (
            (np.sqrt(np.mean(one**2)), np.abs(one).max()) for one in bias
        )
        yield Row(
            f"background ramp {ramp:+.0%} at 1:1: reflectance bias of the bands, rms (worst)",
            f"{rms:.1%} ({worst:.1%}) of white; with a flat one {flat:.0%} ({worst_flat:.0%})",
            "≤ 2 %", "1 %", bool(rms <= 0.02),
        )  # fmt: skip


def _tail_row(
    shape: tuple[int, int],
    calibration: hf.Calibration,
    share: float,
    mean_ns: float,
    photons: float,
) -> Row:
    histogram, depth, _ = _picture(
        shape, photons=photons, background=photons / 10, tail=(share, mean_ns), seed=2
    )
    image = hf.reconstruct(histogram, calibration)
    check = hf.check_image(histogram, calibration, image)
    widened = with_floor(image, histogram, calibration, check)
    error = np.abs(image["depth"].values - depth)
    known = np.isfinite(error)
    plain, cover = (
        (error < 1.96 * one["depth_std"].values)[known].mean() for one in (image, widened)
    )
    return Row(
        f"{share:.0%} of the light through exp({mean_ns:g} ns), {photons:g} photons: "
        "95 % interval with the floor covers",
        f"{cover:.1%} ({plain:.1%} without)", "≥ 90 %", "", bool(cover >= 0.9),
    )  # fmt: skip
