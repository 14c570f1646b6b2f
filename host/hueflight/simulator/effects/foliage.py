# SPDX-License-Identifier: Apache-2.0
"""Leaves in front of a scene: every pixel receives light from several random depths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.simulator.effects.settings import Effects

LEAF_SURFACE = "green brick"  #: surface of `hueflight.model.spectra` whose color the leaves have
_LEAVES = 3
_PURPOSE = 7  # of the seed; the numbers before it belong to the sensor


@dataclass(frozen=True)
class Leaf:
    """The leaf that each pixel sees at one place of the order from near to far.

    Attributes
    ----------
    depth_m : ndarray of float, shape (row, col)
        Depth along the optical axis, m.
    cover : ndarray of float, shape (row, col)
        Fraction that it covers of what the leaves in front of it leave free.
    """

    depth_m: NDArray[np.float64]
    cover: NDArray[np.float64]


def leaves(effects: Effects, shape: tuple[int, int], seed: int) -> tuple[Leaf, ...]:
    """Draw the leaves that each pixel sees.

    The cover of each follows a beta distribution whose mean makes all of them together cover
    `Effects.foliage_share` on average.

    Parameters
    ----------
    effects : Effects
        Effects with depth, thickness and density of the foliage.
    shape : tuple of int
        Numbers of rows and columns.
    seed : int
        Seed of the sensor's imperfections.

    Returns
    -------
    tuple of Leaf
        Leaves from near to far; empty without foliage.
    """
    if effects.foliage_share == 0:
        return ()
    rng = np.random.default_rng([seed, _PURPOSE])
    places = np.sort(rng.random((_LEAVES, *shape)), axis=0)
    mean = 1 - (1 - effects.foliage_share) ** (1 / _LEAVES)
    cover = rng.beta(2 * mean, 2 * (1 - mean), (_LEAVES, *shape))
    depth_m = effects.foliage_depth + effects.foliage_thickness * places
    return tuple(Leaf(depth, part) for depth, part in zip(depth_m, cover, strict=True))


def free_share(
    foliage: tuple[Leaf, ...], depth_m: NDArray[np.float64], visible: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the fraction of each pixel that no leaf covers.

    Parameters
    ----------
    foliage : tuple of Leaf
        Leaves from near to far.
    depth_m : ndarray of float, shape (row, col)
        Depth of what lies behind the leaves, m. Leaves behind it cover nothing.
    visible : ndarray of bool, shape (row, col)
        Where there is something; elsewhere all leaves are in front.

    Returns
    -------
    ndarray of float, shape (row, col)
        Fraction of each pixel, 1 without leaves.
    """
    free = np.ones(depth_m.shape)
    for leaf in foliage:
        in_front = ~visible | (leaf.depth_m < depth_m)
        free = free * np.where(in_front, 1 - leaf.cover, 1.0)
    return free
