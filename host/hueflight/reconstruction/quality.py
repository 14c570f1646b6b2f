# SPDX-License-Identifier: Apache-2.0
"""Quality flags of an image's pixels: why a number is missing or less than it seems."""

from __future__ import annotations

from enum import IntFlag
from typing import Any


class Quality(IntFlag):
    """Bits of the variable `quality` of an image; a pixel may carry several.

    Attributes
    ----------
    DEAD : int
        The pixel never detects a photon.
    HOT : int
        The pixel fires whatever the LEDs do.
    LOW_SIGNAL : int
        There are too few photons to tell the depth. Images of earlier versions call it
        ``starved`` in ``flag_meanings``; `STARVED` is the same bit.
    SATURATED : int
        A counter may have reached its end.
    AMBIGUOUS_LAG : int
        One surface, but a second lag of its pulses is nearly as likely: `other_depth` is the depth
        that belongs to it. Images of earlier versions call it ``ambiguous`` in ``flag_meanings``;
        `AMBIGUOUS` is the same bit.
    SKIPPED : int
        The pixel was left out on request.
    NO_RETURN : int
        Background alone explains the counts: no surface was detected.
    OUT_OF_RANGE : int
        The best delay lies at the end of the searched range, or behind the camera. A calibration
        whose reference has the distance 0 does not tell where the camera is.
    MISFIT : int
        One surface with the calibrated pulses does not explain the counts: for example two
        surfaces in the pixel, whose reported depth may lie between them.
    MIXED : int
        The pixel lies at an edge and sees the surfaces on both sides: `depth` is that of the near
        one, and `second_depth` that of the far one.
    TWO_RETURNS : int
        The counts of the pixel itself show two surfaces, as of glass in front of a wall: `depth` is
        that of the near one, and `second_depth` that of the far one.
    CONTRADICTED : int
        The pixel's own photons show another depth than those of its neighbors; the depth is that
        of its own.
    PILED_UP : int
        So many exposures hold a photon that the correction of lost ones multiplies what is left:
        fewer than 1 period in 20 is still open at its end, or 1 exposure in 100.
    """

    DEAD = 1
    HOT = 2
    LOW_SIGNAL = 4
    SATURATED = 8
    AMBIGUOUS_LAG = 16
    SKIPPED = 32
    NO_RETURN = 64
    OUT_OF_RANGE = 128
    MISFIT = 256
    MIXED = 512
    TWO_RETURNS = 1024
    CONTRADICTED = 2048
    PILED_UP = 4096
    STARVED = LOW_SIGNAL
    AMBIGUOUS = AMBIGUOUS_LAG


def flag_attributes() -> dict[str, Any]:
    """Return the attributes of the variable `quality` that say what its bits mean.

    Returns
    -------
    dict
        ``flag_masks`` and ``flag_meanings`` of the CF conventions.
    """
    return {
        "flag_masks": [int(flag) for flag in Quality],
        "flag_meanings": " ".join((flag.name or "").lower() for flag in Quality),
    }
