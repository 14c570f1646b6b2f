# SPDX-License-Identifier: Apache-2.0
"""The light in front of the sensor: that of the LEDs by each path, and steady light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.spectra import WAVELENGTH_NM, band_weights, detection, reflectance
from hueflight.simulator.effects.fog import FOG_END_M, attenuation, fog_returns
from hueflight.simulator.effects.foliage import LEAF_SURFACE, Leaf, free_share, leaves
from hueflight.simulator.effects.returns import Return, bounced, fixed_reflection, lens_flare
from hueflight.simulator.light_budget import white_photons
from hueflight.simulator.scene import Scene
from hueflight.simulator.settings import SimulationSettings


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


def ambient_light(
    scene: Scene, instrument: Instrument, settings: SimulationSettings
) -> NDArray[np.float64]:
    """Return the steady light of each pixel.

    Parameters
    ----------
    scene : Scene
        Scene, laid out for the same instrument.
    instrument : Instrument
        Instrument that looks at it.
    settings : SimulationSettings
        Strength of the light, and effects.

    Returns
    -------
    ndarray of float, shape (row, col)
        Detectable photons per period.
    """
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
