# SPDX-License-Identifier: Apache-2.0
"""Progress behind one small interface, so that a terminal, a daemon or a notebook can show it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """Told how far long work has come."""

    def start(self, task: str, total: float | None) -> None:
        """Work named `task` begins; `total` steps are expected, if that is known."""
        ...

    def advance(self, steps: float = 1) -> None:
        """Some steps are done."""
        ...

    def finish(self) -> None:
        """The work named last is done."""
        ...


class Silent:
    """Shows nothing."""

    def start(self, task: str, total: float | None) -> None:
        """Begin, unseen."""

    def advance(self, steps: float = 1) -> None:
        """Advance, unseen."""

    def finish(self) -> None:
        """End, unseen."""


@contextmanager
def task(progress: Progress, name: str, total: float | None = None) -> Iterator[None]:
    """One piece of work, finished even when it fails."""
    progress.start(name, total)
    try:
        yield
    finally:
        progress.finish()


def tracked(
    items: Iterable[Item], progress: Progress, name: str, total: float | None = None
) -> Iterator[Item]:
    """The items, one step of progress after each."""
    with task(progress, name, total):
        for item in items:
            yield item
            progress.advance()
