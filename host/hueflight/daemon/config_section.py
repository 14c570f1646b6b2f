# SPDX-License-Identifier: Apache-2.0
"""What the tables of a daemon's configuration have in common."""

from __future__ import annotations

import msgspec

from hueflight.errors import HueflightError


class ConfigError(HueflightError):
    """A configuration that can't be read, or that would be unsafe."""


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A strict, immutable table."""


def require_ranges(section: Section, prefix: str, /, **ranges: tuple[float, float]) -> None:
    """Refuse numbers outside their ranges; a number that is not finite is outside of any.

    Parameters
    ----------
    section : Section
        Table that holds the numbers.
    prefix : str
        Name of the table with a dot, for messages; empty for the topmost one.
    **ranges : tuple of float
        Least and greatest value by the name of the entry.

    Raises
    ------
    ConfigError
        If a number is out of its range.
    """
    for name, (low, high) in ranges.items():
        value = getattr(section, name)
        if not low <= value <= high:
            raise ConfigError(f"{prefix}{name} = {value}: must be from {low:g} to {high:.10g}")
