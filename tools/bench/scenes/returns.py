# SPDX-License-Identifier: Apache-2.0
"""Whether anything is there: background alone, faint surfaces, a real night sky, thin bars."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from _night import NIGHT, NIGHT_DEPTH_RANGE, night_calibration, night_counts
from acceptance import NO_DATA, Row
from outside_model import COLORS, amplitudes, bound_m, calibrated, drawn, expected
from scipy.io import loadmat

import hueflight as hf
from hueflight.calibration import Calibration
from hueflight.reconstruction.quality import Quality

METHODS = ("joint", "paper", "pooled")
#: rows and columns of the night picture that show nothing but sky
SKIES = (np.s_[:50, 80:155], np.s_[:60, :22], np.s_[100:250, 225:])


def rows(quick: bool) -> Iterator[Row]:
    """False alarms and misses of every method, and what pools do with sky and thin structures."""
    size = (48, 48) if quick else (96, 96)
    calibration = calibrated(*size)
    plain = np.ones((*size, 1))
    for method in METHODS:
        shown = []
        for photons in (10, 100, 1000, 10_000, 100_000):
            mean = plain * expected(1.3, np.zeros(9), photons)
            counts = drawn(mean, np.random.default_rng([2, photons]))
            shown.append(_shown(hf.reconstruct(counts, calibration, method=method)))
        share = float(np.mean(shown))
        yield Row(
            f"background only, 10 to 1e5 photons (five levels), `{method}`: unflagged depths",
            f"{share:.2%}", "≤ 0.2 %", "≤ 0.1 %", share <= 2e-3,
        )  # fmt: skip
    for method in METHODS:
        for limit_m, most, aim in ((0.07, 1e-3, "0"), (0.10, 2e-2, "1 %")):
            worst = 0.0
            for number, color in enumerate(COLORS):
                for background in (10.0, 1000.0):
                    photons = _photons_for(limit_m, color, background)
                    mean = expected(1.3, amplitudes(COLORS[color], photons), background)
                    counts = drawn(plain * mean, np.random.default_rng([3, number]))
                    quality = hf.reconstruct(counts, calibration, method=method)["quality"].values
                    missed = (quality & int(Quality.NO_RETURN)) > 0
                    worst = max(worst, float(missed.mean()))
            yield Row(
                f"surfaces with a bound of {100 * limit_m:.0f} cm, `{method}`: missed, worst color",
                f"{worst:.2%}", f"≤ {100 * most:.1f} %", aim, worst <= most,
            )  # fmt: skip
    yield from _bars(calibration, size)
    yield from _night(quick)


def _shown(image) -> float:
    """Share of pixels with a depth and no flag."""
    return float((np.isfinite(image["depth"].values) & (image["quality"].values == 0)).mean())


def _photons_for(limit_m: float, color: str, background: float) -> float:
    """Photons at which the bound of depth is just below a limit."""
    photons = 10.0
    while bound_m(1.3, amplitudes(COLORS[color], photons), background) > limit_m:
        photons *= 1.05
    return photons


def _bars(calibration: Calibration, size: tuple[int, int]) -> Iterator[Row]:
    """Four pixels wide, 30 cm in front of a wall of the same reflectance, 20 photons."""
    bars = np.zeros(size, bool)
    for first in range(10, size[1] - 8, 24):
        bars[:, first : first + 4] = True
    light = amplitudes(COLORS["white"], 20)
    mean = np.where(bars[..., None], expected(0.9, light, 2), expected(1.2, light, 2))
    counts = drawn(mean, np.random.default_rng(4))
    image = hf.reconstruct(counts, calibration, method="pooled")
    error = image["depth"].values - np.where(bars, 0.9, 1.2)
    off = (np.abs(error) > 3 * image["depth_std"].values) & (image["quality"].values == 0)
    yield Row("bars of 4 pixels, no contrast, `pooled`: mean error", f"{error[bars].mean():.3f} m")
    yield Row(
        "bars of 4 pixels, no contrast, `pooled`: off by 3 deviations, no flag",
        f"{off[bars].mean():.1%}",
    )


def _night(quick: bool) -> Iterator[Row]:
    """Sky of a real capture of a building at night."""
    if not NIGHT.exists():
        yield Row("sky of a real night picture, `pooled`: unflagged depths", NO_DATA)
        return
    cells = loadmat(NIGHT)["Ts_gated"]
    if quick:
        cells = cells[:64, 64:192]
    image = hf.reconstruct(
        night_counts(cells),
        night_calibration(cells.shape),
        method="pooled",
        depth_range=NIGHT_DEPTH_RANGE,
    )
    shown = np.isfinite(image["depth"].values) & (image["quality"].values == 0)
    sky = (np.s_[:50, 16:91],) if quick else SKIES
    share = float(np.concatenate([shown[part].ravel() for part in sky]).mean())
    yield Row(
        "sky of a real night picture, `pooled`: unflagged depths",
        f"{share:.2%}", "≤ 1 %", "0.2 %", share <= 0.01,
    )  # fmt: skip
