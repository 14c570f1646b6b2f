# SPDX-License-Identifier: Apache-2.0
"""Which effects of real scenes, sensors and days a simulation contains, and how strong they are."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError

_SHARES = (
    "pane_share", "background_decay_share", "tail_share", "flare_share", "new_hot_share",
)  # fmt: skip
_NOT_NEGATIVE = ("sky", "flare_delay_ns", "reflection", "reflection_delay_ns")
_POSITIVE = ("pane_depth", "background_decay_ns", "tail_ns")


@dataclass(frozen=True, kw_only=True)
class Effects:
    """Effects that a reconstruction's model does not contain; each is off by default.

    Effects that change between a calibration and a later capture (drifts, pixels that turn hot)
    are simulated by calibrating without them and capturing the scene with them.

    Attributes
    ----------
    sky : float
        Steady light from directions in which a ray meets nothing, relative to the ambient light
        that a white surface reflects.
    pane_share : float
        Fraction of each pixel's light that a neutral, diffuse pane in front of the scene returns,
        as in a fine mesh or a dusty window. The scene behind it keeps the remaining fraction.
    pane_depth : float
        Depth of the pane along the optical axis, m. What lies in front of it is not affected.
    background_ramp : float
        Relative slope of the ambient light over the time bins. At 0.5, for example, its intensity
        rises linearly from 0.5 to 1.5 times its mean; it falls if the value is negative.
    background_decay_share : float
        Fraction of the ambient light that decays exponentially from the start of each period.
    background_decay_ns : float
        Time constant of the ambient light that decays, ns.
    delay_drift_ps : float or tuple of float
        Drift of the LEDs' delays, ps, later if positive: one number, or one per band.
    pulse_width_factor : float or tuple of float
        Factor on the duration of the LED pulses about the centre of their Gaussian part: one
        number, or one per band.
    tail_share : float
        Fraction of all LED light that arrives through an exponential delay, as by multipath
        between surfaces or scattering in fog.
    tail_ns : float
        Mean of the exponential delay of LED light, ns.
    flare_share : float
        Lens flare: light that the lens scatters evenly over the picture, as a fraction of the
        picture's mean LED light. It is added to the direct light.
    flare_delay_ns : float
        Delay of the lens flare after the mean arrival time of the picture's LED light, ns.
    reflection : float
        Light of a fixed reflection inside the instrument, such as that of a cover glass, relative
        to the light from a white plane at 1 m.
    reflection_delay_ns : float
        Delay of the fixed reflection, ns; 0 is the arrival time from distance 0.
    new_hot_share : float
        Fraction of the pixels that turn hot, in addition to those that were hot.
    bin_width_drift : float
        Standard deviation of the relative change of each time bin's width, drawn from the seed of
        the sensor.
    """

    sky: float = 0.0
    pane_share: float = 0.0
    pane_depth: float = 0.3
    background_ramp: float = 0.0
    background_decay_share: float = 0.0
    background_decay_ns: float = 50.0
    delay_drift_ps: float | tuple[float, ...] = 0.0
    pulse_width_factor: float | tuple[float, ...] = 1.0
    tail_share: float = 0.0
    tail_ns: float = 3.0
    flare_share: float = 0.0
    flare_delay_ns: float = 0.0
    reflection: float = 0.0
    reflection_delay_ns: float = 0.0
    new_hot_share: float = 0.0
    bin_width_drift: float = 0.0

    def __post_init__(self) -> None:
        for name in _SHARES:
            if not 0 <= getattr(self, name) <= 1:
                raise SceneError(f"effects.{name} = {getattr(self, name)!r}: must lie in 0..1")
        for name in _NOT_NEGATIVE:
            if not (isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise SceneError(
                    f"effects.{name} = {getattr(self, name)!r}: must be a finite number, 0 or more"
                )
        for name in _POSITIVE:
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SceneError(
                    f"effects.{name} = {getattr(self, name)!r}: must be a finite number above 0"
                )
        if not -1 <= self.background_ramp <= 1:
            raise SceneError(
                f"effects.background_ramp = {self.background_ramp!r}: must lie in -1..1, so that "
                "no light is negative"
            )
        if not 0 <= self.bin_width_drift <= 0.25:
            raise SceneError(
                f"effects.bin_width_drift = {self.bin_width_drift!r}: must lie in 0..0.25, so that "
                "every bin keeps a width"
            )
        if not all(isfinite(drift) for drift in _numbers(self.delay_drift_ps)):
            raise SceneError(f"effects.delay_drift_ps = {self.delay_drift_ps!r}: must be finite")
        if not all(isfinite(f) and f > 0 for f in _numbers(self.pulse_width_factor)):
            raise SceneError(
                f"effects.pulse_width_factor = {self.pulse_width_factor!r}: must be finite and "
                "above 0"
            )

    @property
    def active(self) -> dict[str, Any]:
        """Values that differ from their defaults, by name."""
        plain = Effects()
        return {
            item.name: getattr(self, item.name)
            for item in fields(self)
            if getattr(self, item.name) != getattr(plain, item.name)
        }

    def replace(self, **changes: Any) -> Effects:
        """Return a copy with some effects changed.

        Parameters
        ----------
        **changes : Any
            New values by the name of the attribute.

        Returns
        -------
        Effects
            The changed copy.
        """
        return replace(self, **changes)

    def band_values(self, name: str, bands: int) -> NDArray[np.float64]:
        """Return one value per band of an effect that may differ between the LEDs.

        Parameters
        ----------
        name : {"delay_drift_ps", "pulse_width_factor"}
            Name of the attribute.
        bands : int
            Number of bands of the instrument.

        Returns
        -------
        ndarray of float, shape (band,)
            The value of each band.

        Raises
        ------
        SceneError
            If the effect is given for another number of bands.
        """
        value = getattr(self, name)
        if not isinstance(value, tuple):
            return np.full(bands, float(value))
        if len(value) != bands:
            raise SceneError(
                f"effects.{name} has {len(value)} entries but the instrument has {bands} bands: "
                "give one per band"
            )
        return np.array(value, dtype=np.float64)


def _numbers(value: float | tuple[float, ...]) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)
