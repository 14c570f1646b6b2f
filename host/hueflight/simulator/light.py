"""Light budget: how many photons each pixel is expected to detect per period."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import InstrumentError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.spectra import WAVELENGTH_NM, detection, mean_detection
from hueflight.model.time_bins import TimeBins
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
        Detectable LED photons per period.
    delay_ns : ndarray of float, shape (row, col)
        Sum of the time of flight and the delay of the pixel, ns.
    background : ndarray of float, shape (row, col)
        Detectable background photons per period, constant in time.
    periods : int
        Number of periods in one exposure.
    bins : TimeBins
        Bins of the simulated converter.
    pile_up : bool
        Whether an early photon hides later ones of its period.
    """

    instrument: Instrument
    photons: NDArray[np.float64]
    delay_ns: NDArray[np.float64]
    background: NDArray[np.float64]
    periods: int
    bins: TimeBins
    pile_up: bool

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
        return Rates(
            instrument=self.instrument,
            photons=self.photons[:, rows],
            delay_ns=self.delay_ns[rows],
            background=self.background[rows],
            periods=self.periods,
            bins=self.bins,
            pile_up=self.pile_up,
        )

    def detections(self) -> NDArray[np.float64]:
        """Expected number of photons per exposure if every one of them were counted.

        Returns
        -------
        ndarray of float, shape (row, col)
            Detectable photons per exposure, of the LEDs and of the background together.
        """
        return self.periods * (self.photons.sum(axis=0) + self.background)

    def occupancy(self) -> NDArray[np.float64]:
        """Probability that an exposure contains at least one photon.

        Returns
        -------
        ndarray of float, shape (row, col)
            Fraction of exposures that are not empty, 0 to 1.
        """
        return -np.expm1(-self.detections())


def periods_per_exposure(instrument: Instrument) -> int:
    """Whole periods in one exposure; 1 for an instrument without a period or exposure time."""
    period_ns, exposure_ms = instrument.timing.period_ns, instrument.sensor.exposure_ms
    if period_ns is None or exposure_ms is None:
        return 1
    return max(1, round(exposure_ms * 1e6 / period_ns))


def white_photons(instrument: Instrument, settings: SimulationSettings) -> NDArray[np.float64]:
    """LED photons per period that a pixel on the axis detects from a white plane at 1 m.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose power, spectra and detector divide the light among the bands.
    settings : SimulationSettings
        Settings whose `white_detections` fixes the sum over all bands.

    Returns
    -------
    ndarray of float, shape (band,)
        Detectable photons per period of each LED at full strength.
    """
    shares = _power_w(instrument) * mean_detection(instrument)
    per_exposure = settings.white_detections * shares / shares.sum()
    return per_exposure / periods_per_exposure(instrument)


def radiometric_detections(instrument: Instrument, *, fill_factor: float = 0.13) -> float:
    """Compute `SimulationSettings.white_detections` from the instrument's power and optics.

    A Lambertian LED of power P on the axis produces the irradiance P/(π z²) on a plane at the
    distance z. A Lambertian white surface reflects it with the radiance P/(π² z²), and a pixel of
    area A behind a lens of f-number N receives π A/(4 N²) times that radiance. For preset `paper`
    the result is about 12 per exposure: the default 0.35 corresponds to the same set-up with its
    iris closed from f/1.4 to f/8.

    Parameters
    ----------
    instrument : Instrument
        Instrument with a lens, a pixel pitch and an exposure time.
    fill_factor : float
        Light-sensitive fraction of a pixel's area (0.13: Henderson et al., JSSC 2019).

    Returns
    -------
    float
        LED photons that a pixel on the axis detects per exposure from a white plane at 1 m.

    Raises
    ------
    InstrumentError
        If the instrument has no lens, no pixel pitch or no exposure time.
    """
    sensor, lens = instrument.sensor, instrument.lens
    width_um, height_um = sensor.pixel_width_um, sensor.pixel_height_um
    if lens is None or width_um is None or height_um is None or sensor.exposure_ms is None:
        raise InstrumentError(
            f"instrument {instrument.name!r}: a radiometric estimate needs a lens, the pixel "
            "pitch and the exposure time; add those that its description leaves out"
        )
    detected_per_s = float(_power_w(instrument) @ mean_detection(instrument))
    area_m2 = width_um * height_um * 1e-12 * fill_factor
    collected = area_m2 * pi / (4 * lens.f_number**2)
    return detected_per_s * sensor.exposure_ms * 1e-3 * collected / pi**2


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
    scene.require_fit(instrument)
    sensor_pixels = pixels(instrument, settings)
    bins = time_bins(instrument, settings)
    ray_cosine = instrument.ray_cosine()
    range_m = np.where(scene.visible, scene.depth, 1.0) / ray_cosine
    vignetting = ray_cosine**4

    white = white_photons(instrument, settings)
    emitted = white * settings.band_drive(instrument)
    geometry = np.where(scene.visible, ray_cosine * scene.incidence / range_m**2 * vignetting, 0.0)
    reflected = scene.band_reflectance(instrument) + scene.glare
    photons = emitted[:, None, None] * reflected * scene.light * geometry

    ambient = settings.ambient * white.sum() * vignetting
    ambient = ambient * scene.mean_reflectance(_ambient_weights(instrument))
    dark = sensor_pixels.dark_rate_hz * bins.span_ns * 1e-9
    alive = ~sensor_pixels.dead
    return Rates(
        instrument=instrument,
        photons=photons * alive,
        delay_ns=2 * range_m / SPEED_OF_LIGHT_M_PER_NS + sensor_pixels.delay_ns,
        background=(ambient + dark) * alive,
        periods=periods_per_exposure(instrument),
        bins=bins,
        pile_up=settings.pile_up,
    )


def _power_w(instrument: Instrument) -> NDArray[np.float64]:
    """Optical power of each band, W, shape (band,)."""
    return 1e-3 * np.array([band.power_mw for band in instrument.bands])


def _ambient_weights(instrument: Instrument) -> NDArray[np.float64]:
    """Detected spectrum of ambient light, normalized to sum 1, shape (wavelength,).

    Ambient light resembles that of white LEDs: the same number of photons at every wavelength from
    420 to 680 nm.
    """
    room = ((WAVELENGTH_NM >= 420) & (WAVELENGTH_NM <= 680)).astype(np.float64)
    weights = room * detection(instrument)
    if weights.sum() == 0:  # a detector for another range: take a flat spectrum over that range
        weights = detection(instrument)
    return weights / weights.sum()
