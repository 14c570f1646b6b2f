# SPDX-License-Identifier: Apache-2.0
"""Fog: attenuates the light of the scene, and returns light from all ranges in front of it.

A slab of fog of thickness dr at range r returns, relative to a white surface there, the fraction
backscatter · extinction · dr. Its light falls with the square of the range, like that of the
surface, and is attenuated on both ways by exp(-2 · extinction · r). Light that is scattered more
than once is left out; `Effects.tail_share` delays a part of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.simulator.effects.returns import Return
from hueflight.simulator.effects.settings import Effects

#: Fog in a direction without a surface ends here; behind it there is less than 1 % of its light.
FOG_END_M = 10.0
_SLABS = 16  # quadrature over 1/range: exact to 1e-6 up to a surface at 3 m, to 1e-4 up to 10 m


def attenuation(effects: Effects, range_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the fraction of light that passes through fog to a range and back.

    Parameters
    ----------
    effects : Effects
        Effects with the extinction of the fog.
    range_m : ndarray of float
        Range along the ray, m.

    Returns
    -------
    ndarray of float, same shape
        Fraction of the light, 1 without fog.
    """
    return np.exp(-2 * effects.fog_per_m * range_m)


def fog_returns(
    effects: Effects, light: NDArray[np.float64], range_m: NDArray[np.float64]
) -> tuple[Return, ...]:
    """Return the light that fog scatters back, as thin slabs.

    Parameters
    ----------
    effects : Effects
        Effects with the properties of the fog.
    light : ndarray of float, shape (band, row, col)
        Detectable photons per period from a white surface at a range of 1 m that faces each ray.
    range_m : ndarray of float, shape (row, col)
        Range at which the ray leaves the fog, m.

    Returns
    -------
    tuple of Return
        One entry for each slab; without depth, as no surface returns it.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_SLABS)
    # with u = 1/r, dr/r² = -du: the light per du has no pole
    near = 1 / effects.fog_start
    far = np.minimum(1 / range_m, near)
    middle, half = (near + far) / 2, (near - far) / 2
    slabs = []
    for node, weight in zip(nodes, weights, strict=True):
        slab_m = 1 / (middle + half * node)
        share = effects.fog_per_m * effects.fog_backscatter * weight * half
        photons = light * (share * attenuation(effects, slab_m))
        delay_ns = 2 * slab_m / SPEED_OF_LIGHT_M_PER_NS
        slabs.append(Return("fog", photons, delay_ns, np.full(range_m.shape, np.nan)))
    return tuple(slabs)
