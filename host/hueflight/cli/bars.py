# SPDX-License-Identifier: Apache-2.0
"""Progress bars on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress


class Bars:
    """Progress bars on the terminal's error stream, one below the other."""

    def __init__(self) -> None:
        self._bars = RichProgress(
            TextColumn("{task.description:<14}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=Console(stderr=True),
        )
        self._open: list[TaskID] = []

    def start(self, task: str, total: float | None) -> None:
        """Show a bar for a task that begins.

        Parameters
        ----------
        task : str
            Its name.
        total : float or None
            Number of steps, if known.
        """
        if not self._open:
            self._bars.start()
        self._open.append(self._bars.add_task(task, total=total))

    def advance(self, steps: float = 1) -> None:
        """Move the bar of the innermost task.

        Parameters
        ----------
        steps : float, default 1
            How many steps were done since.
        """
        self._bars.advance(self._open[-1], steps)

    def finish(self) -> None:
        """Leave the bar of the innermost task as it is."""
        self._bars.stop_task(self._open.pop())
        if not self._open:
            self._bars.stop()
