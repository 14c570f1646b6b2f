# SPDX-License-Identifier: Apache-2.0
"""Options that several commands have, and how their values are read."""

from __future__ import annotations

from collections.abc import Sequence

from cyclopts import Parameter, Token

from hueflight.errors import HueflightError


def _whole(_: object, tokens: Sequence[Token]) -> int:
    number = tokens[0].value
    if not float(number).is_integer():  # the parser would round it
        raise ValueError(number)
    return int(number) if number.lstrip("+-").isdecimal() else int(float(number))


WHOLE = Parameter(converter=_whole)  #: of an option that takes a whole number


def band_list(bands: str | None) -> list[str] | None:
    """Read the value of ``--bands``.

    Parameters
    ----------
    bands : str or None
        Names or numbers, separated by commas.

    Returns
    -------
    list of str or None
        One entry for each band; None where the option was not given.
    """
    return None if bands is None else [name.strip() for name in bands.split(",")]


def region_slices(region: str | None) -> tuple[slice, slice] | None:
    """Read the value of ``--region``.

    Parameters
    ----------
    region : str or None
        Rows and columns, such as ``10:20,30:40`` or ``:,30:40``.

    Returns
    -------
    tuple of slice or None
        Rows and columns; None where the option was not given.

    Raises
    ------
    HueflightError
        If it is no such text.
    """
    if region is None:
        return None
    parts = [part.strip().split(":") for part in region.split(",")]
    numbers = [number.strip() for part in parts for number in part]
    shaped = len(parts) == 2 and all(len(part) == 2 for part in parts)
    if not shaped or not all(number.isdecimal() or not number for number in numbers):
        raise HueflightError(
            f"--region {region}: give rows and columns as FIRST:END,FIRST:END, such as 10:20,30:40"
        )
    top, bottom, left, right = (int(number) if number else None for number in numbers)
    return slice(top, bottom), slice(left, right)


def require_threads(threads: int) -> None:
    """Refuse a number of threads that can't be.

    Parameters
    ----------
    threads : int
        What ``--threads`` says.

    Raises
    ------
    HueflightError
        If it is below 1.
    """
    if threads < 1:
        raise HueflightError(f"--threads {threads}: at least one thread is needed")
