# SPDX-License-Identifier: Apache-2.0
"""Expected photons of every pixel, the input of the probabilities of codes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import Instrument
from hueflight.model.pileup import periods_per_exposure
from hueflight.model.pulses import Pulse
from hueflight.model.time_bins import TimeBins
from hueflight.simulator.effects.background_shape import UnevenBackground, background_shares
from hueflight.simulator.effects.pulse_changes import pulse_trains
from hueflight.simulator.effects.returns import Return
from hueflight.simulator.effects.secondary_avalanches import SecondaryAvalanches
from hueflight.simulator.light_paths import ambient_light, scene_returns
from hueflight.simulator.scene import Scene
from hueflight.simulator.settings import SimulationSettings, pixels, time_bins


@dataclass(frozen=True)
class Rates:
    """Expected photons of every pixel: all that the probabilities of codes depend on.

    Attributes
    ----------
    instrument : Instrument
        Instrument whose bands and pulses the photons belong to.
    photons : ndarray of float, shape (band, row, col)
        Detectable LED photons per period, without those of `further`.
    delay_ns : ndarray of float, shape (row, col)
        Sum of the time of flight and the delay of the pixel, ns.
    background : ndarray of float, shape (row, col)
        Detectable background photons per period that are constant in time.
    periods : int
        Number of periods in one exposure.
    bins : TimeBins
        Bins of the simulated converter.
    pile_up : bool
        Whether an early photon hides later ones of its period.
    further : tuple of Return
        LED light that arrives by further paths, each with a delay of its own.
    trains : tuple of tuple of Pulse, or None
        Pulses of each band where they differ from those of the instrument.
    uneven : UnevenBackground or None
        Background that is not constant in time, in addition to `background`.
    secondary : SecondaryAvalanches or None
        Crosstalk and afterpulses.
    """

    instrument: Instrument
    photons: NDArray[np.float64]
    delay_ns: NDArray[np.float64]
    background: NDArray[np.float64]
    periods: int
    bins: TimeBins
    pile_up: bool
    further: tuple[Return, ...] = ()
    trains: tuple[tuple[Pulse, ...], ...] | None = None
    uneven: UnevenBackground | None = None
    secondary: SecondaryAvalanches | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.delay_ns.shape[0], self.delay_ns.shape[1]

    def rows(self, rows: slice) -> Rates:
        """Select rows of the image.

        Parameters
        ----------
        rows : slice
            Rows to keep.

        Returns
        -------
        Rates
            Rates of these rows alone.
        """
        return replace(
            self,
            photons=self.photons[:, rows],
            delay_ns=self.delay_ns[rows],
            background=self.background[rows],
            further=tuple(part.rows(rows) for part in self.further),
            uneven=self.uneven and self.uneven.rows(rows),
            secondary=self.secondary and self.secondary.rows(rows),
        )

    def detections(self) -> NDArray[np.float64]:
        """Expected number of photons per exposure if every one of them were counted.

        Crosstalk and afterpulses are not photons and are left out.

        Returns
        -------
        ndarray of float, shape (row, col)
            Detectable photons per exposure, of the LEDs and of the background together.
        """
        photons = self.photons.sum(axis=0) + self.background
        for part in self.further:
            photons = photons + part.photons.sum(axis=0)
        if self.uneven is not None:
            photons = photons + self.uneven.photons
        return self.periods * photons

    def occupancy(self) -> NDArray[np.float64]:
        """Probability that an exposure contains at least one photon.

        Returns
        -------
        ndarray of float, shape (row, col)
            Fraction of exposures that are not empty, 0 to 1, without crosstalk and afterpulses.
        """
        return -np.expm1(-self.detections())


def expected_rates(
    scene: Scene, instrument: Instrument, settings: SimulationSettings | None = None
) -> Rates:
    """Compute the expected photons per period of every pixel that looks at a scene.

    Distances and angles are computed as if the LEDs were at the position of the lens; their
    actual positions affect shadows only. The light of an LED is proportional to the inverse
    square of the range along the ray, to the cosine of incidence and to the cosine of the LED's
    own angle (Lambertian, no optics). The image darkens with the fourth power of the cosine of
    the field angle. Photons return after ``2 · range / c``.

    Parameters
    ----------
    scene : Scene
        Scene laid out for the same instrument.
    instrument : Instrument
        Instrument that looks at the scene.
    settings : SimulationSettings or None
        Light level and imperfections; None for the defaults.

    Returns
    -------
    Rates
        Expected photons, delays and background of every pixel.

    Raises
    ------
    SceneError
        If the scene was made for another geometry or `settings.drive` for other bands.
    """
    settings = settings or SimulationSettings()
    effects = settings.effects
    first, *others = scene_returns(scene, instrument, settings)
    sensor_pixels = pixels(instrument, settings)
    bins = time_bins(instrument, settings)
    ambient = ambient_light(scene, instrument, settings)
    dark = sensor_pixels.dark_rate_hz * bins.span_ns * 1e-9
    alive = ~sensor_pixels.dead
    uneven = None
    if effects.background_ramp or effects.background_decay_share:
        uneven = UnevenBackground(ambient * alive, background_shares(bins, effects))
        ambient = np.zeros_like(ambient)
    secondary = None
    if effects.crosstalk_share or effects.afterpulse_share:
        secondary = SecondaryAvalanches(
            crosstalk_share=effects.crosstalk_share,
            afterpulse_share=effects.afterpulse_share,
            afterpulse_ns=effects.afterpulse_ns,
            alive=alive,
            sensor_rows=instrument.sensor.rows,
        )
    return Rates(
        instrument=instrument,
        photons=first.photons * alive,
        delay_ns=first.delay_ns + sensor_pixels.delay_ns,
        background=(ambient + dark) * alive,
        periods=periods_per_exposure(instrument),
        bins=bins,
        pile_up=settings.pile_up,
        further=tuple(
            replace(
                part,
                photons=part.photons * alive,
                delay_ns=part.delay_ns + sensor_pixels.delay_ns,
            )
            for part in others
        ),
        trains=pulse_trains(instrument, effects),
        uneven=uneven,
        secondary=secondary,
    )
