# SPDX-License-Identifier: Apache-2.0
"""The methods of the scoreboard: each makes depth (row, col), NaN where it knows none."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from _face import matched_depths
from data_sets import Half
from numpy.typing import NDArray
from published import METERS_PER_NS, rapp_goyal_2017, shin_2015
from scipy.ndimage import uniform_filter

import hueflight as hf

Floats = NDArray[np.float64]
Method = Callable[[Half], Floats]


def matched(half: Half, *, size: int = 1) -> Floats:
    """Log-matched filter on the photons of squares of so many pixels."""
    counts = pooled_in_squares(half.counts, size)
    return matched_depths(counts, half.calibration, half.depth_range)


def pooled_in_squares(
    counts: NDArray[np.unsignedinteger], size: int
) -> NDArray[np.unsignedinteger]:
    """Return the sum of counts in the square of so many pixels around each pixel."""
    if size == 1:
        return counts
    shared = uniform_filter(counts.astype(np.float32), (size, size, 1), mode="constant")
    return np.rint(shared * size**2).astype(np.uint16)


def phasor(half: Half) -> Floats:
    """Phase of the first harmonic by PhasorPy, minus that of the pulse."""
    from phasorpy.phasor import phasor_from_signal, phasor_to_polar

    signal = half.counts[..., half.calibration.bins.codes].astype(np.float64)
    _, real, imaginary = phasor_from_signal(signal, axis=-1)
    _, expected_real, expected_imaginary = phasor_from_signal(half.pulse(half.times_ns))
    phase = phasor_to_polar(real, imaginary)[0]
    origin = phasor_to_polar(expected_real, expected_imaginary)[0]
    turns = np.remainder((phase - origin) / (2 * np.pi), 1.0)
    return turns * half.period_ns * METERS_PER_NS


def reconstructed(half: Half, *, method: str) -> Floats:
    """A method of this project."""
    image = hf.reconstruct(
        half.counts,
        half.calibration,
        method=method,
        depth_range=None if method == "paper" else half.depth_range,
    )
    return image["depth"].values


SMOOTHING = (0.3, 1.0, 3.0, 10.0)  #: strengths of total variation that are tried
SIZES = (3, 5, 7, 9)  #: sizes of squares that are tried, pixels

#: name → variants of the method, of which the best one counts, and what it takes from neighbors
METHODS: dict[str, dict[str, Method]] = {
    "log-matched filter": {"": matched},
    "squares + log-matched filter": {
        f"{size} × {size}": partial(matched, size=size) for size in SIZES
    },
    "phasor (PhasorPy)": {"": phasor},
    "Shin et al. 2015": {
        f"smoothing {strength:g}": partial(shin_2015, smoothing=strength) for strength in SMOOTHING
    },
    "Rapp and Goyal 2017": {
        f"smoothing {strength:g}": partial(rapp_goyal_2017, smoothing=strength)
        for strength in SMOOTHING
    },
    "`paper`": {"": partial(reconstructed, method="paper")},
    "`joint`": {"": partial(reconstructed, method="joint")},
    "`pooled`": {"": partial(reconstructed, method="pooled")},
}
