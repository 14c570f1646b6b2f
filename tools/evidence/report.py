# SPDX-License-Identifier: Apache-2.0
"""What a measurement of the evidence hands back: a table for the page, and what must not be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"


@dataclass(frozen=True)
class Report:
    """Result of a measurement.

    Attributes
    ----------
    text : str
        Markdown for the page.
    findings : list of str
        What must not happen.
    """

    text: str
    findings: list[str]


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
