# SPDX-License-Identifier: Apache-2.0
"""Methods on captures of known depth: a plane that a robot arm moves before an ams TMF8820."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import prod

import numpy as np
from _tmf8820 import ZONES, captures, off_line
from data_sets import Half
from methods import reconstructed
from numpy.typing import NDArray
from published import METERS_PER_NS

import hueflight as hf

Floats = NDArray[np.float64]
DEPTH_RANGE_M = (0.0, 1.0)
HEAD = ["method", "RMSE, cm", "worst zone, cm", "within 68 / 95 %", "processor time"]


def highest(half: Half) -> Floats:
    """Depth of the code with most photons."""
    return half.times_ns[_counts(half).argmax(axis=-1)] * METERS_PER_NS


def matched(half: Half) -> Floats:
    """Log-matched filter with the sensor's own pulse, and a parabola through its highest values."""
    counts, pulse = _counts(half), _pulse(half)
    lags = np.arange(-8, counts.shape[-1] // 2)
    moved = np.log([np.roll(pulse, lag, axis=-1) for lag in lags])
    score = (moved * counts).sum(axis=-1).reshape(lags.size, -1)
    best = score.argmax(axis=0).clip(1, lags.size - 2)
    low, top, high = (np.take_along_axis(score, best[None] + step, 0)[0] for step in (-1, 0, 1))
    lag = lags[best] + 0.5 * (low - high) / (low - 2 * top + high)
    return lag * _code_ns(half) * METERS_PER_NS


def phasor(half: Half) -> Floats:
    """Phase of the first harmonic by PhasorPy, minus that of the sensor's own pulse."""
    from phasorpy.phasor import phasor_from_signal, phasor_to_polar

    phases = []
    for signal in (_counts(half), _pulse(half)):
        _, real, imaginary = phasor_from_signal(signal, axis=-1)
        phases.append(phasor_to_polar(real, imaginary)[0])
    turns = np.remainder((phases[0] - phases[1]) / (2 * np.pi) + 0.5, 1.0) - 0.5
    return turns * half.times_ns.size * _code_ns(half) * METERS_PER_NS


def _counts(half: Half) -> Floats:
    return half.counts[..., half.calibration.bins.codes].astype(np.float64)


def _pulse(half: Half) -> Floats:
    """The reference of each zone, with the least light that a logarithm bears."""
    pulse = half.calibration.reference.astype(np.float64)
    return pulse / pulse.sum(axis=-1, keepdims=True) + 1e-4


def _code_ns(half: Half) -> float:
    return float(half.times_ns[1] - half.times_ns[0])


def published(half: Half) -> Floats:
    """Depth by the paper's method."""
    return reconstructed(half, method="paper")


def joint(half: Half) -> Floats:
    """Depth by the joint fit, and its stated deviation (2, row, col)."""
    image = hf.reconstruct(half.counts, half.calibration, depth_range=half.depth_range)
    return np.stack([image["depth"].values, image["depth_std"].values])


#: name → method; those that take photons from neighbors have none to take here
METHODS: dict[str, Callable[[Half], Floats]] = {
    "highest code": highest,
    "log-matched filter": matched,
    "phasor (PhasorPy)": phasor,
    "`paper`": published,
    "`joint`": joint,
}


def rows() -> list[list[str]]:
    """Return a row of the table for each method."""
    seen = captures()
    truth = np.array([capture.distance_m for capture in seen])
    halves = [Half(capture.counts, capture.calibration, DEPTH_RANGE_M) for capture in seen]
    made, least = [], None
    for name, method in METHODS.items():
        began = time.process_time()
        found = np.array([method(half).reshape(-1, prod(ZONES)) for half in halves])
        seconds = time.process_time() - began
        least = seconds if least is None else least
        stated = found[:, 1] if found.shape[1] > 1 else None
        made.append([name, *_errors(truth, found[:, 0], stated), f"{seconds / least:.0f} ×"])
    firmware = np.array([capture.firmware_m for capture in seen])
    made.append(["the sensor's own firmware", *_errors(truth, firmware, None), ""])
    return made


def _errors(truth: Floats, found: Floats, stated: Floats | None) -> tuple[str, str, str]:
    """RMSE after a straight line through each zone, the worst one's, and the coverage."""
    errors, slopes = off_line(truth, found)
    zones = 100 * np.sqrt((errors**2).mean(axis=0)) / slopes  # in meters of the robot's
    covered = ""
    if stated is not None:
        shares = [(np.abs(errors) < factor * stated).mean() for factor in (1.0, 1.96)]
        covered = " / ".join(f"{100 * share:.0f}" for share in shares)
    return f"{np.sqrt((zones**2).mean()):.3f}", f"{zones.max():.3f}", covered
