# SPDX-License-Identifier: Apache-2.0
"""What may have changed since a calibration, and how large it seems.

A capture of the reference target and a picture of any scene are checked against a calibration in
these terms. What both tell, delays and widths of the pulses, has the same name, unit and gauge.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri

FOUND = 4.0  #: score from which a suspect is named
NARROWEST, WIDEST = -0.4, 0.8  #: relative changes of a width that are corrected


@dataclass(frozen=True)
class Suspect:
    """One kind of departure, and how large it seems.

    Attributes
    ----------
    name : str
        ``"delay"`` or ``"width"``; of a scene also ``"background slope"``,
        ``"background decay"``, ``"tail"``, ``"flare"`` or ``"bin widths"``; of a reference also
        ``"common delay"`` or ``"brightness"``.
    unit : str
        Unit of the sizes.
    labels : tuple of str
        What each size belongs to, such as the name of a band.
    sizes, deviations : tuple of float
        Sizes and their standard deviations, the noise of the calibration included.
    score : float
        Standard normal score of all sizes together against 0.
    """

    name: str
    unit: str
    labels: tuple[str, ...]
    sizes: tuple[float, ...]
    deviations: tuple[float, ...]
    score: float

    @property
    def found(self) -> bool:
        """True if chance does not explain the sizes."""
        return self.score > FOUND

    def describe(self) -> str:
        """Return sizes, deviations and significance in words.

        Returns
        -------
        str
            One line.
        """
        parts = [
            f"{label} {size:+.3g} ± {deviation:.2g}".strip()
            for label, size, deviation in zip(self.labels, self.sizes, self.deviations, strict=True)
        ]
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{', '.join(parts)}{unit} ({max(self.score, 0.0):.1f} sigma)"

    def __str__(self) -> str:
        """Return name and sizes."""
        return f"{self.name}: {self.describe()}"


def normal_score(chi_square: float, freedom: float) -> float:
    """Return the standard normal score of a χ² variate.

    Parameters
    ----------
    chi_square : float
        Its value.
    freedom : float
        Its degrees of freedom.

    Returns
    -------
    float
        Score that a normal variate exceeds as rarely.
    """
    tail = float(chdtrc(freedom, chi_square))
    if tail > 1e-300:
        return float(-ndtri(tail))
    # Wilson and Hilferty (1931), beyond what doubles represent
    scale = 2 / (9 * freedom)
    return float((np.cbrt(chi_square / freedom) - (1 - scale)) / np.sqrt(scale))


def drift_of(
    suspects: Iterable[Suspect], bands: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the drift of the LEDs that a check found, for `with_drift`.

    Parameters
    ----------
    suspects : iterable of Suspect
        Result of a check of a reference capture or of a picture.
    bands : int
        Number of bands.

    Returns
    -------
    delay_ps : ndarray of float, shape (band,)
        How much later each band arrives, ps; 0 where no drift was found.
    width_factor : ndarray of float, shape (band,)
        Factor on the duration of each band's pulse; 1 where none was found, or light through an
        exponential delay, from which widths can't be told well enough.
    """
    found = {suspect.name: np.array(suspect.sizes) for suspect in suspects if suspect.found}
    delays, factors = np.zeros(bands), np.ones(bands)
    if bands > 1 and "delay" in found:
        delays = found["delay"]
    if "width" in found and "tail" not in found:
        factors = 1 + np.clip(found["width"], NARROWEST, WIDEST)
    return delays, factors
