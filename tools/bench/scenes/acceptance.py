# SPDX-License-Identifier: Apache-2.0
"""Rows of the table that says whether the project keeps its promises on scenes as they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

NO_DATA = "not measured: no data"  #: of rows whose real photons are not beside the project


@dataclass(frozen=True)
class Row:
    """One promise and what was measured.

    Attributes
    ----------
    what : str
        The condition and the figure, as one line.
    measured : str
        The figure with its unit.
    at_least : str
        The limit that must hold; empty where the figure is only stated.
    aim : str
        What is aimed at; may be empty.
    holds : bool or None
        Whether the limit holds; None where there is none.
    """

    what: str
    measured: str
    at_least: str = ""
    aim: str = ""
    holds: bool | None = None

    def cells(self) -> list[str]:
        """Return the row as cells of a Markdown table."""
        verdict = {True: "yes", False: "**no**", None: ""}[self.holds]
        return [self.what, self.measured, self.at_least, self.aim, verdict]


#: A group draws its own data; quick ones are for a look, with few pixels.
Group = Callable[[bool], Iterator[Row]]
