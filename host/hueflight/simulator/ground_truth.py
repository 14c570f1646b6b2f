# SPDX-License-Identifier: Apache-2.0
"""What is true of a simulated capture beyond one depth and one spectrum per pixel."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hueflight.files import staged
from hueflight.model.instrument import Instrument
from hueflight.simulator.light import expected_rates
from hueflight.simulator.light_paths import scene_returns
from hueflight.simulator.probabilities import probability_tiles
from hueflight.simulator.scene import Scene
from hueflight.simulator.settings import SimulationSettings, pixels, time_bins

_SAME_DEPTH_M = 1e-3
_OBJECTS = ("surface", "pane", "leaf")  # paths of light that comes directly from an object


@dataclass(frozen=True)
class EffectTruth:
    """Ground truth of the effects of one capture.

    Attributes
    ----------
    depths : ndarray of float, shape (return, row, col)
        Depths along the optical axis that a pixel receives LED light from, rising, m; NaN after
        its last one. Returns from within 1 mm of each other count as one, at their mean depth
        weighted by light.
    shares : ndarray of float, shape (return, row, col)
        Fraction of the pixel's LED light of the scene, summed over bands, that comes from each of
        these depths; 0 where the depth is NaN. They sum to 1 where any light returns.
    photons : ndarray of float, shape (return, band, row, col)
        Detectable photons per period of each of these returns.
    stray_photons : ndarray of float, shape (band, row, col)
        Detectable photons per period of lens flare, of the fixed reflection, of multipath and of
        fog.
    empty : ndarray of bool, shape (row, col)
        Pixels that receive no LED light from the scene.
    turned_hot : ndarray of bool, shape (row, col)
        Pixels that `Effects.new_hot_share` made hot.
    delay_drift_ps : ndarray of float, shape (band,)
        Drift of the LEDs' delays, ps.
    pulse_width_factor : ndarray of float, shape (band,)
        Factor on the duration of the LED pulses.
    crosstalk : ndarray of float, shape (row, col)
        Expected avalanches per exposure that neighbors set off, whether or not a photon was first.
    trapped : ndarray of float, shape (row, col)
        Fraction of exposures that begin with a trapped carrier, from which an afterpulse comes
        unless a photon is first.
    edges_ns : ndarray of float, shape (bin + 1,)
        Edges of the converter's time bins, drift included, ns.
    """

    depths: NDArray[np.float64]
    shares: NDArray[np.float64]
    photons: NDArray[np.float64]
    stray_photons: NDArray[np.float64]
    empty: NDArray[np.bool_]
    turned_hot: NDArray[np.bool_]
    delay_drift_ps: NDArray[np.float64]
    pulse_width_factor: NDArray[np.float64]
    crosstalk: NDArray[np.float64]
    trapped: NDArray[np.float64]
    edges_ns: NDArray[np.float64]

    def mixed(self, step: float = 0.01, share: float = 0.02) -> NDArray[np.bool_]:
        """Return which pixels see more than one surface.

        Parameters
        ----------
        step : float, default 0.01
            Smallest difference in depth that counts, m.
        share : float, default 0.02
            Smallest fraction of the pixel's light that counts.

        Returns
        -------
        ndarray of bool, shape (row, col)
            True where two depths with enough light differ by at least the step.
        """
        counted = self.shares >= share
        nearest = np.where(counted, self.depths, np.inf).min(axis=0)
        farthest = np.where(counted, self.depths, -np.inf).max(axis=0)
        return farthest - nearest >= step


def effect_truth(
    scene: Scene, instrument: Instrument, settings: SimulationSettings | None = None
) -> EffectTruth:
    """Return the ground truth of a capture with effects.

    Parameters
    ----------
    scene : Scene
        Scene, laid out for the same instrument.
    instrument : Instrument
        Instrument that looks at it.
    settings : SimulationSettings, optional
        Settings of the capture; the defaults if left out.

    Returns
    -------
    EffectTruth
        Every depth that each pixel sees with its light, and what changed in the instrument.

    Raises
    ------
    SceneError
        If the scene was made for another geometry, or if a setting is given for another number
        of bands.
    """
    settings = settings or SimulationSettings()
    effects = settings.effects
    returns = scene_returns(scene, instrument, settings)
    seen = [part for part in returns if part.name in _OBJECTS]
    stray = np.zeros(seen[0].photons.shape)
    for part in returns:
        if part.name not in _OBJECTS:
            stray = stray + part.photons
    depths, photons = _merged(
        np.stack([part.depth for part in seen]), np.stack([part.photons for part in seen])
    )
    light = photons.sum(axis=1)
    total = light.sum(axis=0)
    before = settings.replace(effects=effects.replace(new_hot_share=0.0))
    bands = len(instrument.bands)
    crosstalk, trapped = _secondary(scene, instrument, settings)
    return EffectTruth(
        depths=depths,
        shares=np.divide(light, total, out=np.zeros_like(light), where=total > 0),
        photons=photons,
        stray_photons=stray,
        empty=total == 0,
        turned_hot=pixels(instrument, settings).hot & ~pixels(instrument, before).hot,
        delay_drift_ps=effects.delay_change_ps(bands),
        pulse_width_factor=effects.width_change(bands),
        crosstalk=crosstalk,
        trapped=trapped,
        edges_ns=time_bins(instrument, settings).edges_ns,
    )


def _secondary(
    scene: Scene, instrument: Instrument, settings: SimulationSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`EffectTruth.crosstalk` and `EffectTruth.trapped`, (row, col)."""
    crosstalk, trapped = np.zeros(scene.shape), np.zeros(scene.shape)
    if not (settings.effects.crosstalk_share or settings.effects.afterpulse_share):
        return crosstalk, trapped
    rates = expected_rates(scene, instrument, settings)
    assert rates.secondary is not None
    everything = range(scene.shape[0])
    fired = rates.occupancy()[..., None]
    for share, occupancy in rates.secondary.neighbors(fired, everything, everything):
        crosstalk += (share * occupancy)[..., 0]
    if rates.secondary.afterpulse_share:
        for rows, probabilities in probability_tiles(rates):
            counted = probabilities[..., rates.bins.codes].sum(axis=-1)
            trapped[rows] = rates.secondary.afterpulse_share * counted
    return crosstalk, trapped


def write_truth(
    path: Path, scene: Scene, instrument: Instrument, settings: SimulationSettings | None = None
) -> None:
    """Write the ground truth of a capture as a compressed ``.npz`` file.

    The file replaces an existing one, but only when it is complete. It contains the arrays of
    `Truth` that have a pixel each (``depth``, ``reflectance``, ``shading``, ``lit``) and all those
    of `EffectTruth`, each under the name of its attribute.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    scene : Scene
        Scene, laid out for the same instrument.
    instrument : Instrument
        Instrument that looks at it.
    settings : SimulationSettings, optional
        Settings of the capture; the defaults if left out.

    Raises
    ------
    OutputError
        If the file can't be written.
    """
    ideal = scene.truth(instrument)
    arrays = {name: getattr(ideal, name) for name in ("depth", "reflectance", "shading", "lit")}
    effects = effect_truth(scene, instrument, settings)
    arrays |= {item.name: getattr(effects, item.name) for item in fields(effects)}
    with staged(path, overwrite=True) as partial:
        np.savez_compressed(partial, **arrays)


def _merged(
    depth: NDArray[np.float64], photons: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns of equal depth put together; (return, row, col) and (return, band, row, col)."""
    light = photons.sum(axis=1)
    depth = np.where(light > 0, depth, np.nan)  # what sends no light is not seen
    order = np.argsort(depth, axis=0, kind="stable")  # NaN last
    depth = np.take_along_axis(depth, order, axis=0)
    light = np.take_along_axis(light, order, axis=0)
    photons = np.take_along_axis(photons, order[:, None], axis=0)
    starts = np.diff(depth, axis=0, prepend=-np.inf) > _SAME_DEPTH_M
    group = np.maximum(np.cumsum(starts, axis=0) - 1, 0)
    count = max(1, int(group.max()) + 1)
    merged_depth = np.full((count, *depth.shape[1:]), np.nan)
    merged_photons = np.zeros((count, *photons.shape[1:]))
    for index in range(count):
        members = (group == index) & (light > 0)
        weight = np.where(members, light, 0)
        total = weight.sum(axis=0)
        mean = (weight * np.where(members, depth, 0)).sum(axis=0)
        np.divide(mean, total, out=merged_depth[index], where=total > 0)
        merged_photons[index] = np.where(members[:, None], photons, 0).sum(axis=0)
    return merged_depth, merged_photons
