# SPDX-License-Identifier: Apache-2.0
"""Light budget: how many photons each pixel is expected to detect per period."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import InstrumentError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.pileup import periods_per_exposure
from hueflight.model.pulses import Pulse
from hueflight.model.spectra import (
    WAVELENGTH_NM,
    band_weights,
    detection,
    mean_detection,
    reflectance,
)
from hueflight.model.time_bins import TimeBins
from hueflight.simulator.effects.background_shape import UnevenBackground, background_shares
from hueflight.simulator.effects.fog import FOG_END_M, attenuation, fog_returns
from hueflight.simulator.effects.foliage import LEAF_SURFACE, Leaf, free_share, leaves
from hueflight.simulator.effects.pulse_changes import pulse_trains
from hueflight.simulator.effects.returns import Return, bounced, fixed_reflection, lens_flare
from hueflight.simulator.effects.secondary_avalanches import SecondaryAvalanches
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
    effects = settings.effects
    first, *others = scene_returns(scene, instrument, settings)
    sensor_pixels = pixels(instrument, settings)
    bins = time_bins(instrument, settings)
    ambient = _ambient_light(scene, instrument, settings)
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


def scene_returns(
    scene: Scene, instrument: Instrument, settings: SimulationSettings | None = None
) -> tuple[Return, ...]:
    """Return all LED light that the pixels receive, by path.

    Unlike `expected_rates`, this is the light in front of the sensor: it contains neither the
    delays of the pixels nor their defects.

    Parameters
    ----------
    scene : Scene
        Scene, laid out for the same instrument.
    instrument : Instrument
        Instrument that looks at it.
    settings : SimulationSettings, optional
        Light level and effects; the defaults if left out.

    Returns
    -------
    tuple of Return
        First the light of the scene: of the ray through each pixel's centre, or of each ray of a
        footprint. Then that of the effects that are on.

    Raises
    ------
    SceneError
        If the scene was made for another geometry, or if the strengths of the LEDs are given for
        another number of bands.
    """
    settings = settings or SimulationSettings()
    effects = settings.effects
    scene.require_fit(instrument)
    white = white_photons(instrument, settings)
    emitted = white * settings.band_drive(instrument)
    parts = scene.parts()
    share = 1 / len(parts)
    foliage = leaves(effects, scene.shape, settings.seed)
    returns: list[Return] = []
    for part in parts:
        surface = _surface_return(part, instrument, emitted)
        if effects.fog_per_m or foliage:
            passed = attenuation(effects, _range_m(part, instrument))
            passed = passed * free_share(foliage, part.depth, part.visible)
            surface = replace(surface, photons=surface.photons * passed)
        if len(parts) > 1:
            surface = replace(surface, photons=surface.photons * share)
        if effects.pane_share:
            behind = effects.pane_share * _behind_pane(part, effects.pane_depth)
            surface = replace(surface, photons=surface.photons * (1 - behind))
            pane = _facing_plane("pane", effects.pane_depth, _ray_cosine(part, instrument), emitted)
            returns.append(replace(pane, photons=pane.photons * behind * share))
        returns.append(surface)
    returns.sort(key=lambda part: part.name != "surface")  # stable: the scene's light comes first
    returns += _leaf_returns(foliage, scene, instrument, settings, emitted)
    surfaces = [part for part in returns if part.name == "surface"]
    if effects.flare_share:
        returns.append(lens_flare(returns, effects.flare_share, effects.flare_delay_ns))
    if effects.reflection:
        at_once = effects.reflection_delay_ns
        returns.append(fixed_reflection(effects.reflection * emitted, at_once, scene.shape))
    if effects.bounce_share:
        color = effects.bounce_share * _mean_reflectance(scene, instrument)
        late_ns = effects.bounce_path / SPEED_OF_LIGHT_M_PER_NS
        returns += [bounced(part, color, late_ns) for part in surfaces]
    if effects.fog_per_m:
        cosine = _ray_cosine(scene, instrument)
        free_m = np.where(scene.visible, _range_m(scene, instrument), FOG_END_M)
        returns += fog_returns(effects, emitted[:, None, None] * cosine**5, free_m)
    return tuple(returns)


def _range_m(scene: Scene, instrument: Instrument) -> NDArray[np.float64]:
    """Range along each ray to what it meets, m; that of 1 m of depth where it meets nothing."""
    return np.where(scene.visible, scene.depth, 1.0) / _ray_cosine(scene, instrument)


def _mean_reflectance(scene: Scene, instrument: Instrument) -> NDArray[np.float64]:
    """Mean reflectance over the pixels that see something, (band,)."""
    if not scene.visible.any():
        return np.zeros(len(instrument.bands))
    return scene.band_reflectance(instrument)[:, scene.visible].mean(axis=1)


def _leaf_returns(
    foliage: tuple[Leaf, ...],
    scene: Scene,
    instrument: Instrument,
    settings: SimulationSettings,
    emitted: NDArray[np.float64],
) -> list[Return]:
    """Light of the leaves in front of what the ray through each pixel's center meets."""
    cosine = _ray_cosine(scene, instrument)
    color = (band_weights(instrument) @ reflectance(LEAF_SURFACE))[:, None, None]
    free = np.ones(scene.shape)
    result = []
    for leaf in foliage:
        cover = np.where(~scene.visible | (leaf.depth_m < scene.depth), leaf.cover, 0.0)
        plane = _facing_plane("leaf", leaf.depth_m, cosine, emitted)
        passed = free * cover * attenuation(settings.effects, leaf.depth_m / cosine)
        result.append(replace(plane, photons=plane.photons * color * passed))
        free = free * (1 - cover)
    return result


def _surface_return(scene: Scene, instrument: Instrument, emitted: NDArray[np.float64]) -> Return:
    ray_cosine = _ray_cosine(scene, instrument)
    range_m = _range_m(scene, instrument)
    vignetting = ray_cosine**4
    geometry = np.where(scene.visible, ray_cosine * scene.incidence / range_m**2 * vignetting, 0.0)
    reflected = scene.band_reflectance(instrument) + scene.glare
    photons = emitted[:, None, None] * reflected * scene.light * geometry
    return Return("surface", photons, 2 * range_m / SPEED_OF_LIGHT_M_PER_NS, scene.depth)


def _facing_plane(
    name: str,
    depth_m: float | NDArray[np.float64],
    ray_cosine: NDArray[np.float64],
    emitted: NDArray[np.float64],
) -> Return:
    """Light of a white plane that faces the camera."""
    range_m = depth_m / ray_cosine
    geometry = ray_cosine**2 / range_m**2 * ray_cosine**4
    depth = np.broadcast_to(np.asarray(depth_m, float), ray_cosine.shape)
    photons = emitted[:, None, None] * geometry
    return Return(name, photons, 2 * range_m / SPEED_OF_LIGHT_M_PER_NS, depth)


def _ambient_light(
    scene: Scene, instrument: Instrument, settings: SimulationSettings
) -> NDArray[np.float64]:
    """Detectable photons of steady light per period, (row, col)."""
    effects = settings.effects
    full = settings.ambient * white_photons(instrument, settings).sum()
    weights = _ambient_weights(instrument)
    parts = scene.parts()
    foliage = leaves(effects, scene.shape, settings.seed)
    leaf_color = float(reflectance(LEAF_SURFACE) @ weights)
    total: NDArray[np.float64] | None = None
    for part in parts:
        ambient = full * _ray_cosine(part, instrument) ** 4
        reflected = part.mean_reflectance(weights)
        if effects.sky:
            reflected = np.where(part.visible, reflected, effects.sky)
        if foliage:
            free = free_share(foliage, part.depth, part.visible)
            reflected = reflected * free + leaf_color * (1 - free)
        if effects.pane_share:
            behind = effects.pane_share * _behind_pane(part, effects.pane_depth)
            reflected = reflected * (1 - behind) + behind
        ambient = ambient * reflected
        total = ambient if total is None else total + ambient
    assert total is not None  # there is at least one part
    return total if len(parts) == 1 else total / len(parts)


def _behind_pane(scene: Scene, depth_m: float) -> NDArray[np.bool_]:
    """Where a pane at a depth stands in front of what a ray meets, (row, col)."""
    return ~(scene.visible & (scene.depth <= depth_m))


def _ray_cosine(scene: Scene, instrument: Instrument) -> NDArray[np.float64]:
    return instrument.ray_cosine() if scene.rays is None else scene.rays.cosine


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
