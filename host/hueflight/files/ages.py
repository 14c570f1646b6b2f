# SPDX-License-Identifier: Apache-2.0
"""How long ago something was made, in words."""

from __future__ import annotations

from datetime import UTC, datetime

#: seconds of each unit, the longest first
UNITS = (("day", 86_400), ("hour", 3600), ("minute", 60))


def age(made: str, *, now: datetime | None = None) -> str:
    """Return the age of something.

    Parameters
    ----------
    made : str
        Time at which it was made, ISO 8601; UTC unless it says otherwise.
    now : datetime, optional
        Time that counts as now.

    Returns
    -------
    str
        The age in its largest unit, such as "3 days ago"; "age not known" if the time can't be
        read or lies ahead.
    """
    try:
        then = datetime.fromisoformat(made)
    except ValueError:
        return "age not known"
    if then.tzinfo is None:
        then = then.replace(tzinfo=UTC)
    seconds = ((now or datetime.now(UTC)) - then).total_seconds()
    if seconds < -UNITS[-1][1]:
        return "age not known"
    for unit, length in UNITS:
        if (count := int(seconds // length)) >= 1:
            return f"{count} {unit}{'s' if count > 1 else ''} ago"
    return "just now"
