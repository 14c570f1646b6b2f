# SPDX-License-Identifier: Apache-2.0
"""Real photons of single-photon scanners, each photon thrown into one of two halves.

The data lie beside the project and are no part of it. None states the truth, so that what a method
makes of one half is judged by the photons of the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from _face import DEPTH_RANGE, FACE, face_capture
from _night import NIGHT, NIGHT_DEPTH_RANGE, night_calibration, night_counts
from numpy.typing import NDArray
from scipy.io import loadmat

from hueflight.calibration import Calibration

REFERENCE_PHOTONS = 10_000  #: of the expected reference, from which correlations are made


@dataclass(frozen=True)
class Half:
    """Photons of a capture: all, or half of them.

    Attributes
    ----------
    counts : ndarray of unsigned int, shape (row, col, code)
        Photons in each code.
    calibration : Calibration
        Shape of the pulse and time of each code.
    depth_range : tuple of float
        Least and greatest depth, m.
    """

    counts: NDArray[np.unsignedinteger]
    calibration: Calibration
    depth_range: tuple[float, float]

    @property
    def times_ns(self) -> NDArray[np.float64]:
        """Middle of each code, ns."""
        return np.asarray(self.calibration.bins.centers_ns, np.float64)

    @property
    def period_ns(self) -> float:
        """Period, ns."""
        period_ns = self.calibration.bins.period_ns
        assert period_ns is not None
        return period_ns

    def pulse(self, times_ns: NDArray[np.floating]) -> NDArray[np.float64]:
        """Density of a pulse from depth 0, relative to photons at any time alike."""
        return self.calibration.templates.density(times_ns)[0] * self.period_ns

    @property
    def pulse_width_ns(self) -> tuple[float, float]:
        """Mean and standard deviation of the pulse, ns."""
        times_ns = (np.arange(4096) + 0.5) * self.period_ns / 4096
        weight = self.pulse(times_ns)
        mean = np.average(times_ns, weights=weight)
        return mean, float(np.sqrt(np.average((times_ns - mean) ** 2, weights=weight)))


def face() -> Half:
    """340 × 340 pixels of a mannequin's face, 8.3 photons a pixel."""
    counts, calibration, _ = face_capture()
    return Half(counts, calibration, DEPTH_RANGE)


def night() -> Half:
    """256 × 256 pixels of a building 21 km away at night and of the sky above, 9.8 photons each."""
    cells = loadmat(NIGHT)["Ts_gated"]
    return Half(night_counts(cells), night_calibration(cells.shape), NIGHT_DEPTH_RANGE)


#: name → function that reads the whole capture; files that have to be there
DATA_SETS: dict[str, Callable[[], Half]] = {"face": face, "night": night}
FILES = {"face": FACE, "night": NIGHT}


def halves(name: str, *, seed: int = 1) -> tuple[Half, Half]:
    """Throw each photon of a data set into one of two halves."""
    return halves_of(DATA_SETS[name](), seed=seed)


def halves_of(whole: Half, *, seed: int = 1) -> tuple[Half, Half]:
    """Throw each photon of a capture into one of two halves."""
    first = np.random.default_rng(seed).binomial(whole.counts, 0.5).astype(np.uint16)
    calibration = replace(whole.calibration, reference=_reference(whole))
    parts = (first, (whole.counts - first).astype(np.uint16))
    one, other = (replace(whole, counts=part, calibration=calibration) for part in parts)
    return one, other


def _reference(whole: Half) -> NDArray[np.float32]:
    """Counts that a bright target at depth 0 would give in every pixel."""
    pulse = np.zeros(whole.counts.shape[-1], np.float32)
    pulse[whole.calibration.bins.codes] = whole.pulse(whole.times_ns)
    pulse *= REFERENCE_PHOTONS / pulse.sum()
    return np.broadcast_to(pulse, whole.counts.shape)
