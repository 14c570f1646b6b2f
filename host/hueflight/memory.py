# SPDX-License-Identifier: Apache-2.0
"""How much memory work may take: estimated before it begins, and refused where there is too little.

Work that would not fit is refused at once, with a figure and advice, instead of filling the memory
until the operating system ends the process.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from hueflight.errors import HueflightError, MemoryLimitError

__all__ = ["LIMIT_NAME", "limit_bytes", "require_memory", "sizes", "within_memory"]

SHARE = 0.75  #: of the memory that this process may have, which one piece of work may take
LIMIT_NAME = "HUEFLIGHT_MEMORY"  #: environment variable with a limit of the user, such as "4 GB"
UNITS = {"B": 1, "kB": 10**3, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
CGROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def limit_bytes() -> int | None:
    """Return how much memory one piece of work may take.

    Returns
    -------
    int or None
        Three quarters of the memory of the machine, or of the limit of this process or its
        container where that is less; or what the environment variable ``HUEFLIGHT_MEMORY`` says.
        None where nothing of this is known.

    Raises
    ------
    HueflightError
        If ``HUEFLIGHT_MEMORY`` is not an amount of memory.
    """
    if given := os.environ.get(LIMIT_NAME):
        return _parsed(given)
    known = [size for size in (_physical(), _of_container(), _of_process()) if size is not None]
    return int(SHARE * min(known)) if known else None


def require_memory(needed: float, purpose: str, *, advice: str) -> None:
    """Refuse work that needs more memory than it may take.

    Parameters
    ----------
    needed : float
        Estimated memory, bytes.
    purpose : str
        What it is for, in the words of an error: "the tables of the joint fit".
    advice : str
        What to do instead, a sentence without its full stop.

    Raises
    ------
    MemoryLimitError
        If that is more than `limit_bytes`.
    """
    limit = limit_bytes()
    if limit is not None and needed > limit:
        raise MemoryLimitError(
            f"{purpose} would take about {sizes(needed)} of memory, more than the {sizes(limit)} "
            f"that it may take here ({SHARE:.0%} of the memory, or {LIMIT_NAME}). {advice}"
        )


@contextmanager
def within_memory(purpose: str, *, advice: str) -> Iterator[None]:
    """Say in one sentence that work was given up because memory was exhausted.

    As a block, or as the decorator of a function.

    Parameters
    ----------
    purpose : str
        What the memory was for, in the words of an error: "the reconstruction".
    advice : str
        What to do, or what is left of the work; a sentence without its full stop.

    Yields
    ------
    None
        Nothing.

    Raises
    ------
    MemoryLimitError
        If the block raises `MemoryError`.
    """
    try:
        yield
    except MemoryLimitError:
        raise
    except MemoryError as error:
        raise MemoryLimitError(f"memory is exhausted: {purpose} was given up. {advice}") from error


def sizes(count: float) -> str:
    """Write an amount of memory for people.

    Parameters
    ----------
    count : float
        Bytes.

    Returns
    -------
    str
        The amount with two or three digits and a unit.
    """
    unit = next(u for u, size in reversed(UNITS.items()) if count >= size or size == 1)
    return f"{count / UNITS[unit]:.3g} {unit}"


def _parsed(given: str) -> int:
    text = given.strip()
    unit = next((u for u in sorted(UNITS, key=len, reverse=True) if text.endswith(u)), "")
    number = text.removesuffix(unit)
    try:
        count = float(number) * UNITS.get(unit, 1)
        if count > 0:
            return int(count)
    except (ValueError, OverflowError):
        pass
    raise HueflightError(
        f"{LIMIT_NAME} = {given!r}: must be an amount of memory above 0, such as '4 GB' or '500 MB'"
    )


def _physical() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not on every system
        return None


@cache
def _of_container() -> int | None:
    """Limit of the container, looked up once: opening files takes time in every picture."""
    for name in CGROUP_LIMITS:
        try:
            text = Path(name).read_text().strip()
        except OSError:
            continue
        if text.isdigit():
            return int(text)
    return None


def _of_process() -> int | None:
    try:
        import resource
    except ImportError:  # not on Windows
        return None
    limits = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA))
    known = [limit for limit in limits if limit != resource.RLIM_INFINITY]
    return min(known) if known else None
