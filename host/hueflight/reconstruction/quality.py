"""Quality flags of an image's pixels: why a number is missing or less than it seems."""

from __future__ import annotations

from enum import IntFlag


class Quality(IntFlag):
    """Bits of `image.quality`; a pixel may carry several.

    DEAD : never sees a photon. HOT : fires whatever the LEDs do. LOW_SIGNAL : too few photons to
    say where it is. SATURATED : a counter may have hit its end. AMBIGUOUS : a second depth is
    nearly as likely. SKIPPED : left out on request.
    """

    DEAD = 1
    HOT = 2
    LOW_SIGNAL = 4
    SATURATED = 8
    AMBIGUOUS = 16
    SKIPPED = 32
