# SPDX-License-Identifier: Apache-2.0
"""Which effects of real scenes, sensors and days a simulation contains, and how strong they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError

_SHARES = (
    "pane_share", "background_decay_share", "tail_share", "flare_share", "new_hot_share",
    "bounce_share", "afterpulse_share",
)  # fmt: skip
_NOT_NEGATIVE = (
    "sky", "flare_delay_ns", "reflection", "reflection_delay_ns", "foliage_thickness",
    "bounce_path", "fog_per_m", "fog_backscatter",
)  # fmt: skip
_POSITIVE = (
    "pane_depth", "background_decay_ns", "tail_ns", "foliage_depth", "fog_start", "afterpulse_ns",
)  # fmt: skip
_FINITE = ("delay_drift_ps", "delay_ps_per_kelvin", "width_per_kelvin", "warming")


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
    foliage_share : float
        Mean fraction of a pixel that green leaves in front of the scene cover, below 1. Each pixel
        sees three leaves of random depth, each of which covers a random part of what is left.
    foliage_depth : float
        Depth of the nearest leaves, m.
    foliage_thickness : float
        Distance from the nearest leaves to the farthest, m.
    fog_per_m : float
        Extinction coefficient of fog, 1/m: light is attenuated by the factor e per ``1/fog_per_m``
        of its way, and what fog scatters back arrives before the light of the scene.
    fog_backscatter : float
        Light that 1 m of thin fog with an extinction coefficient of 1/m returns, relative to a
        white surface. Droplets have a lidar ratio near 18 sr, hence pi/18 = 0.17.
    fog_start : float
        Range from which the LEDs illuminate what the pixels see, m.
    bounce_share : float
        Multipath: light that reaches each surface by way of another one, as a fraction of the
        direct light if the other is white. It has the picture's mean reflectance in each band.
    bounce_path : float
        Additional path of that light, m.
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
    warming : float
        Rise of the LEDs' temperature since the calibration, K.
    delay_ps_per_kelvin : float or tuple of float
        Later emission for each kelvin of `warming`, ps: one number, or one per band.
    width_per_kelvin : float or tuple of float
        Relative growth of the pulse duration for each kelvin of `warming`: one number, or one per
        band.
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
    crosstalk_share : float
        Probability that an avalanche in a pixel sets off one at the same time in each of its four
        neighbors, at most 0.25.
    afterpulse_share : float
        Probability that an exposure with a count leaves a trapped carrier, which sets off an
        avalanche in the next exposure unless a photon comes first.
    afterpulse_ns : float
        Mean lifetime of trapped carriers, ns.
    """

    sky: float = 0.0
    pane_share: float = 0.0
    pane_depth: float = 0.3
    foliage_share: float = 0.0
    foliage_depth: float = 0.3
    foliage_thickness: float = 0.2
    fog_per_m: float = 0.0
    fog_backscatter: float = 0.17
    fog_start: float = 0.1
    bounce_share: float = 0.0
    bounce_path: float = 0.5
    background_ramp: float = 0.0
    background_decay_share: float = 0.0
    background_decay_ns: float = 50.0
    delay_drift_ps: float | tuple[float, ...] = 0.0
    pulse_width_factor: float | tuple[float, ...] = 1.0
    warming: float = 0.0
    delay_ps_per_kelvin: float | tuple[float, ...] = 10.0
    width_per_kelvin: float | tuple[float, ...] = 0.001
    tail_share: float = 0.0
    tail_ns: float = 3.0
    flare_share: float = 0.0
    flare_delay_ns: float = 0.0
    reflection: float = 0.0
    reflection_delay_ns: float = 0.0
    new_hot_share: float = 0.0
    bin_width_drift: float = 0.0
    crosstalk_share: float = 0.0
    afterpulse_share: float = 0.0
    afterpulse_ns: float = 50.0

    def __post_init__(self) -> None:
        for name in _SHARES:
            self._require(name, "must lie in 0..1", lambda value: 0 <= value <= 1)
        for name in _NOT_NEGATIVE:
            self._require(
                name, "must be a finite number, 0 or more", lambda value: 0 <= value < inf
            )
        for name in _POSITIVE:
            self._require(name, "must be a finite number above 0", lambda value: 0 < value < inf)
        for name in _FINITE:
            self._require(name, "must be finite", isfinite)
        self._require(
            "background_ramp",
            "must lie in -1..1, so that no light is negative",
            lambda value: -1 <= value <= 1,
        )
        self._require(
            "bin_width_drift",
            "must lie in 0..0.25, so that every bin keeps a width",
            lambda value: 0 <= value <= 0.25,
        )
        self._require(
            "crosstalk_share",
            "must lie in 0..0.25, so that four neighbors do not add up to more than 1",
            lambda value: 0 <= value <= 0.25,
        )
        self._require(
            "foliage_share",
            "must be 0 or more and below 1, so that some light passes",
            lambda value: 0 <= value < 1,
        )
        self._require(
            "pulse_width_factor", "must be finite and above 0", lambda value: 0 < value < inf
        )
        if any(1 + growth * self.warming <= 0 for growth in _numbers(self.width_per_kelvin)):
            raise SceneError(
                f"effects.width_per_kelvin = {self.width_per_kelvin!r} with effects.warming = "
                f"{self.warming!r}: must leave the pulses a width above 0"
            )

    def _require(self, name: str, rule: str, holds: Callable[[float], bool]) -> None:
        value = getattr(self, name)
        if not all(holds(number) for number in _numbers(value)):
            raise SceneError(f"effects.{name} = {value!r}: {rule}")

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
        name : {"delay_drift_ps", "pulse_width_factor", "delay_ps_per_kelvin", "width_per_kelvin"}
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

    def delay_change_ps(self, bands: int) -> NDArray[np.float64]:
        """Return how much later each LED emits than at its calibration, ps.

        Parameters
        ----------
        bands : int
            Number of bands of the instrument.

        Returns
        -------
        ndarray of float, shape (band,)
            Sum of `delay_drift_ps` and of what `warming` causes.

        Raises
        ------
        SceneError
            If one of them is given for another number of bands.
        """
        warm = self.warming * self.band_values("delay_ps_per_kelvin", bands)
        return self.band_values("delay_drift_ps", bands) + warm

    def width_change(self, bands: int) -> NDArray[np.float64]:
        """Return the factor on the duration of each LED's pulses.

        Parameters
        ----------
        bands : int
            Number of bands of the instrument.

        Returns
        -------
        ndarray of float, shape (band,)
            Product of `pulse_width_factor` and of what `warming` causes.

        Raises
        ------
        SceneError
            If one of them is given for another number of bands.
        """
        warm = 1 + self.warming * self.band_values("width_per_kelvin", bands)
        return self.band_values("pulse_width_factor", bands) * warm


def _numbers(value: float | tuple[float, ...]) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)
