"""Quality flags of an image's pixels: why a number is missing or less than it seems."""

from __future__ import annotations

from enum import IntFlag


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
    AMBIGUOUS : int
        A second depth is nearly as likely.
    SKIPPED : int
        The pixel was left out on request.
    NO_RETURN : int
        Background alone explains the counts: no surface was detected.
    OUT_OF_RANGE : int
        The best delay lies at the end of the searched range, or behind the camera.
    """

    DEAD = 1
    HOT = 2
    LOW_SIGNAL = 4
    SATURATED = 8
    AMBIGUOUS = 16
    SKIPPED = 32
    NO_RETURN = 64
    OUT_OF_RANGE = 128
    STARVED = LOW_SIGNAL
