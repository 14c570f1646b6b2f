"""How many photons a pixel detects: the light budget from LED to code."""

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
    """Expected photons of every pixel, all that p(code) depends on.

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
        """(row, col)."""
        return self.delay_ns.shape[0], self.delay_ns.shape[1]

    def rows(self, rows: slice) -> Rates:
        """The same for some rows."""
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
        """Expected photons per exposure, were all counted; (row, col)."""
        return self.periods * (self.photons.sum(axis=0) + self.background)

    def occupancy(self) -> NDArray[np.float64]:
        """Probability that an exposure has a photon, (row, col)."""
        return -np.expm1(-self.detections())


def periods_per_exposure(instrument: Instrument) -> int:
    """Whole periods in one exposure; 1 where the sensor codes one shot."""
    period_ns, exposure_ms = instrument.timing.period_ns, instrument.sensor.exposure_ms
    if period_ns is None or exposure_ms is None:
        return 1
    return max(1, round(exposure_ms * 1e6 / period_ns))


def white_photons(instrument: Instrument, settings: SimulationSettings) -> NDArray[np.float64]:
    """LED photons per period that a pixel on the axis detects of a white plane at 1 m, (band,)."""
    shares = _power_w(instrument) * mean_detection(instrument)
    per_exposure = settings.white_detections * shares / shares.sum()
    return per_exposure / periods_per_exposure(instrument)


def radiometric_detections(instrument: Instrument, *, fill_factor: float = 0.13) -> float:
    """What `SimulationSettings.white_detections` would be with every LED photon accounted for.

    A Lambertian LED of power P on the axis makes the irradiance P/(π z²) on a plane, which a
    Lambertian white surface sends back as the radiance P/(π² z²); a pixel of area A behind a
    lens of f-number N receives π A/(4 N²) of that. For preset `paper` this is about 12 per
    exposure: the default 0.35 is the same set-up with its iris closed from f/1.4 to f/8.

    Parameters
    ----------
    fill_factor : light-sensitive share of a pixel's area (0.13: Henderson et al., JSSC 2019).

    Raises
    ------
    InstrumentError
        If the instrument has no lens, pixel pitch, exposure or period to compute with.
    """
    sensor, lens = instrument.sensor, instrument.lens
    width_um, height_um = sensor.pixel_width_um, sensor.pixel_height_um
    if lens is None or width_um is None or height_um is None or sensor.exposure_ms is None:
        raise InstrumentError(
            f"instrument {instrument.name!r}: a radiometric estimate needs a lens, the pixel "
            "pitch and the exposure time"
        )
    detected_per_s = float(_power_w(instrument) @ mean_detection(instrument))
    area_m2 = width_um * height_um * 1e-12 * fill_factor
    collected = area_m2 * pi / (4 * lens.f_number**2)
    return detected_per_s * sensor.exposure_ms * 1e-3 * collected / pi**2


def expected_rates(
    scene: Scene, instrument: Instrument, settings: SimulationSettings | None = None
) -> Rates:
    """Photons per period of every pixel that looks at a scene.

    The illuminator counts as sitting in the lens for distance and angle (its real place only
    throws shadows): light falls with the square of the range along the ray, with the cosine of
    incidence and with the LED's own cosine (Lambertian, no optics); the image falls with the
    fourth power of the field angle's cosine. Photons come back after ``2 · range / c``.

    Parameters
    ----------
    scene : laid out for the same instrument.
    settings : light level and imperfections; the defaults if left out.

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
    return 1e-3 * np.array([band.power_mw for band in instrument.bands])


def _ambient_weights(instrument: Instrument) -> NDArray[np.float64]:
    """Detected spectrum of room light: white LED-like, flat in photons from 420 to 680 nm."""
    room = ((WAVELENGTH_NM >= 420) & (WAVELENGTH_NM <= 680)).astype(np.float64)
    weights = room * detection(instrument)
    if weights.sum() == 0:  # a detector for another range sees steady light of its own bands
        weights = detection(instrument)
    return weights / weights.sum()
