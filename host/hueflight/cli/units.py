# SPDX-License-Identifier: Apache-2.0
"""Checks of numbers that were probably typed in another unit: millimetres, or percent."""

from __future__ import annotations

from collections.abc import Iterable

from hueflight.errors import HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument

#: a target so many times farther than the range that a period covers is one in millimetres
RANGES = 5.0
BRIGHTEST = 2.0  #: a target is hardly brighter than twice white


def require_meters(distance: float | None, instrument: Instrument) -> None:
    """Refuse a distance that only makes sense in millimetres.

    Parameters
    ----------
    distance : float or None
        Distance of a target as it was typed, meant in metres.
    instrument : Instrument
        Instrument whose period, or codes, cover a range.

    Raises
    ------
    HueflightError
        If the distance is more than `RANGES` times this range.
    """
    if distance is None:
        return
    span_m = instrument.time_bins().span_ns * SPEED_OF_LIGHT_M_PER_NS / 2
    if distance > RANGES * span_m:
        raise HueflightError(
            f"--distance {distance:g}: instrument {instrument.name!r} covers a range of "
            f"{span_m:.3g} m; give the distance in metres, such as {distance / 1000:g} for "
            f"{distance:g} mm"
        )


def require_share(reflectance: Iterable[float] | None) -> None:
    """Refuse a reflectance that only makes sense in percent.

    Parameters
    ----------
    reflectance : iterable of float or None
        Reflectance of a target as it was typed, where 1 is white.

    Raises
    ------
    HueflightError
        If a value is above `BRIGHTEST`.
    """
    for value in reflectance or ():
        if value > BRIGHTEST:
            raise HueflightError(
                f"--reflectance {value:g}: 1 is white; give {value / 100:g} for {value:g} %"
            )
