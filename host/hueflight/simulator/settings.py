# SPDX-License-Identifier: Apache-2.0
"""Settings of a simulation: light level, imperfections of the sensor, and strength of the LEDs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError
from hueflight.model.instrument import Instrument
from hueflight.model.time_bins import TimeBins
from hueflight.simulator.effects.sensor_changes import drifted_bins, pixels_turned_hot
from hueflight.simulator.effects.settings import Effects


@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """Light level and imperfections; the defaults are those of a good real instrument.

    Attributes
    ----------
    white_detections : float
        The scale of the light budget: LED photons that a pixel on the axis would detect per
        exposure without dead time, from a white plane at 1 m with all LEDs on. Everything else
        follows from the instrument (power, spectra, optics) and the scene (distance, angle,
        reflectance). `light_budget.radiometric_detections` computes the value for an open iris.
    drive : float or tuple of float
        Strength of the LEDs, one number or one per band; 0 is off.
    ambient : float
        Steady light on the scene, relative to the LEDs' mean light on a plane at 1 m.
    dark_counts : float
        Factor on the sensor's typical dark count rate; 0 for none.
    dark_spread : float
        Standard deviation of the logarithm of a pixel's dark count rate.
    hot_share, dead_share : float
        Fractions of pixels that fire all the time and that never fire.
    delay_skew_ns : float
        Delay of the last column's clock relative to the first column's, ns.
    delay_spread_ns : float
        Standard deviation of the additional delay of each pixel, ns.
    dnl_lsb : float
        Standard deviation of a code's width, in nominal widths (differential nonlinearity).
    inl_lsb : float
        Largest slow deviation of a code's edge, in nominal widths (integral nonlinearity).
    pile_up : bool
        Whether an early photon hides later ones of the same period. One photon per exposure is
        kept either way.
    seed : int
        Seed of the imperfections: equal seeds give equal instruments.
    effects : Effects
        Effects that an ideal model leaves out; all are off by default.
    """

    white_detections: float = 0.35
    drive: float | tuple[float, ...] = 1.0
    ambient: float = 0.02
    dark_counts: float = 1.0
    dark_spread: float = 0.5
    hot_share: float = 0.01
    dead_share: float = 0.002
    delay_skew_ns: float = 1.5
    delay_spread_ns: float = 0.2
    dnl_lsb: float = 0.05
    inl_lsb: float = 0.5
    pile_up: bool = True
    seed: int = 0
    effects: Effects = field(default_factory=Effects)

    def __post_init__(self) -> None:
        for name in (
            "white_detections", "ambient", "dark_counts", "dark_spread", "hot_share",
            "dead_share", "delay_spread_ns", "dnl_lsb", "inl_lsb",
        ):  # fmt: skip
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0):
                raise SceneError(f"settings.{name} = {value!r}: must be a finite number, 0 or more")
        if not isfinite(self.delay_skew_ns):
            raise SceneError(f"settings.delay_skew_ns = {self.delay_skew_ns!r}: must be finite")
        if self.hot_share + self.dead_share > 1:
            raise SceneError(
                f"settings: hot_share {self.hot_share} and dead_share {self.dead_share} "
                "together exceed 1; reduce one of them"
            )
        if self.dnl_lsb > 0.25:
            raise SceneError(
                f"settings.dnl_lsb = {self.dnl_lsb}: above 0.25 some codes would have no width"
            )
        drives = self.drive if isinstance(self.drive, tuple) else (self.drive,)
        if any(not (isfinite(d) and d >= 0) for d in drives):
            raise SceneError(f"settings.drive = {self.drive!r}: must be finite numbers, 0 or more")

    @classmethod
    def ideal(cls, **changes: Any) -> SimulationSettings:
        """Settings without imperfections or background light.

        Pile-up stays on, as it belongs to the statistics of first photons.

        Parameters
        ----------
        **changes : object
            Attributes to set to other values.

        Returns
        -------
        SimulationSettings
            Ideal settings with these changes.
        """
        perfect = cls(
            ambient=0, dark_counts=0, dark_spread=0, hot_share=0, dead_share=0,
            delay_skew_ns=0, delay_spread_ns=0, dnl_lsb=0, inl_lsb=0,
        )  # fmt: skip
        return perfect.replace(**changes)

    def replace(self, **changes: Any) -> SimulationSettings:
        """Copy the settings with some values changed.

        Parameters
        ----------
        **changes : object
            Attributes to set to other values.

        Returns
        -------
        SimulationSettings
            Settings with these changes.
        """
        return replace(self, **changes)

    def band_drive(self, instrument: Instrument) -> NDArray[np.float64]:
        """Strength of each LED of an instrument.

        Parameters
        ----------
        instrument : Instrument
            Instrument whose bands the LEDs belong to.

        Returns
        -------
        ndarray of float, shape (band,)
            Relative strength; 1 for the nominal power, 0 for off.

        Raises
        ------
        SceneError
            If `drive` is a tuple with another number of entries than the instrument has bands.
        """
        bands = len(instrument.bands)
        if not isinstance(self.drive, tuple):
            return np.full(bands, float(self.drive))
        if len(self.drive) != bands:
            raise SceneError(
                f"settings.drive has {len(self.drive)} entries but instrument "
                f"{instrument.name!r} has {bands} bands: give one number, or one per band"
            )
        return np.array(self.drive, dtype=np.float64)


@dataclass(frozen=True)
class Pixels:
    """Properties in which the pixels of a sensor differ, for each pixel of an image.

    Attributes
    ----------
    delay_ns : ndarray of float, shape (row, col)
        Delay of each pixel beyond the nominal one, ns.
    dark_rate_hz : ndarray of float, shape (row, col)
        Avalanches per second without light.
    hot, dead : ndarray of bool, shape (row, col)
        Pixels that fire all the time, and pixels that never fire.
    """

    delay_ns: NDArray[np.float64]
    dark_rate_hz: NDArray[np.float64]
    hot: NDArray[np.bool_]
    dead: NDArray[np.bool_]


# A hot pixel is a diode with a dark count rate so high that it fires in every exposure, usually
# within a few periods. Its codes need no special case: by first-photon statistics they decay
# steeply from the start of the exposure.
_HOT_RATE_HZ = (1e6, 3e7)


def pixels(instrument: Instrument, settings: SimulationSettings) -> Pixels:
    """Draw delay, dark count rate and defects of every pixel.

    Parameters
    ----------
    instrument : Instrument
        Instrument with the sensor.
    settings : SimulationSettings
        Size of the imperfections and their seed.

    Returns
    -------
    Pixels
        Properties of each pixel of the image; those of a scanned sensor repeat at each step.
    """
    sensor = instrument.sensor
    shape = (sensor.rows, sensor.cols)
    rng = np.random.default_rng([settings.seed, 1])
    # always draw everything, so that one imperfection switched off leaves the others unchanged
    lottery = rng.permuted(np.arange(sensor.rows * sensor.cols)).reshape(shape) / np.prod(shape)
    own_delay = rng.standard_normal(shape)
    darkness = rng.standard_normal(shape)
    heat = rng.random(shape)
    hot = lottery < settings.hot_share
    dead = (lottery >= settings.hot_share) & (lottery < settings.hot_share + settings.dead_share)
    across = np.linspace(0, 1, sensor.cols) if sensor.cols > 1 else np.zeros(1)
    dark_rate = (
        settings.dark_counts * sensor.dark_count_hz * np.exp(settings.dark_spread * darkness)
    )
    # drawn after the others, so that this effect changes no pixel that it does not make hot
    if settings.effects.new_hot_share:
        hot = hot | pixels_turned_hot(
            hot, dead, share=settings.effects.new_hot_share, seed=settings.seed
        )
    coolest, hottest = _HOT_RATE_HZ
    dark_rate = np.where(hot, coolest * (hottest / coolest) ** heat, dark_rate)
    delay = settings.delay_skew_ns * across + settings.delay_spread_ns * own_delay

    def at_all_steps(values: NDArray[Any]) -> NDArray[Any]:
        return np.tile(values, (sensor.scan_steps, 1))

    return Pixels(
        delay_ns=at_all_steps(delay),
        dark_rate_hz=at_all_steps(dark_rate),
        hot=at_all_steps(hot),
        dead=at_all_steps(dead),
    )


def time_bins(instrument: Instrument, settings: SimulationSettings) -> TimeBins:
    """Draw the actual bins of the simulated converter, of unequal widths.

    Widths vary at random, and edges deviate along an arch over the whole range, as with a drifting
    ring oscillator. The last full code ends at its nominal time, so that the partial code of a
    period that is not a whole number of codes keeps its nominal width. `Effects.bin_width_drift`
    changes the widths of all codes after that.

    Parameters
    ----------
    instrument : Instrument
        Instrument with the converter.
    settings : SimulationSettings
        Nonlinearity of the converter and the seed.

    Returns
    -------
    TimeBins
        Bins of all pixels, in order of arrival time.

    Raises
    ------
    SceneError
        If the nonlinearity is so large that a code has no width.
    """
    bins = _converter_bins(instrument, settings)
    spread = settings.effects.bin_width_drift
    return drifted_bins(bins, spread=spread, seed=settings.seed) if spread else bins


def _converter_bins(instrument: Instrument, settings: SimulationSettings) -> TimeBins:
    nominal = instrument.time_bins()
    if settings.dnl_lsb == 0 and settings.inl_lsb == 0:
        return nominal
    width = instrument.sensor.bin_width_ns
    reverse = instrument.sensor.direction == "reverse"
    widths = nominal.widths_ns[::-1] if reverse else nominal.widths_ns
    full = int(np.count_nonzero(widths > width * (1 - 1e-9)))
    rng = np.random.default_rng([settings.seed, 2])
    uneven = np.clip(settings.dnl_lsb * rng.standard_normal(full), -0.9, 0.9)
    arch = settings.inl_lsb * np.sin(np.pi * np.arange(full + 1) / full)
    edges = np.concatenate([[0.0], np.cumsum(1 + uneven)])
    edges = (edges * full / edges[-1] + arch) * width
    edges = np.concatenate([edges, edges[-1] + np.cumsum(widths[full:])])
    if np.any(np.diff(edges) <= 0):
        raise SceneError(
            f"settings: dnl_lsb = {settings.dnl_lsb} and inl_lsb = {settings.inl_lsb} leave a "
            "code without width: reduce one of them"
        )
    if reverse:
        edges = (edges[-1] - edges)[::-1].copy()
    return TimeBins(nominal.codes, edges, nominal.period_ns)
