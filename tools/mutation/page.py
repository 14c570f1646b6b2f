# SPDX-License-Identifier: Apache-2.0
"""The page of mutation testing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

_HEAD = """# Mutation testing of the gateware

A test suite is judged by faults that are put into the gateware on purpose: one operator, constant,
condition or assignment of one source file is changed, and the tests of that part are run. A mutant
that makes a test fail, or run without end, is *killed*; one that no test notices has *survived*.
Mutants that give the same netlists for all boards as the original, and those listed below with a
reason, are *equivalent* and do not count.

```sh
python tools/mutate.py run --count {count} --seed {seed}   # goes on where it stopped
python tools/mutate.py page                         # writes this page
```

The sources have {total} mutants; {judged} of them were drawn at random (seed {seed}), evenly over
the parts, and judged.
"""


def write_page(
    results: Sequence[Mapping[str, Any]], reasons: Mapping[str, str], *, total: int, seed: int
) -> str:
    """Return the page in Markdown.

    Parameters
    ----------
    results : sequence of mapping
        Records of ``tools/mutate.py``.
    reasons : mapping of str to str
        Why mutants are equivalent, by key.
    total : int
        Number of mutants that the sources have.
    seed : int
        Seed of the sample.

    Returns
    -------
    str
        The page.
    """
    by_suite: dict[str, Counter[str]] = {}
    for result in results:
        by_suite.setdefault(result["suite"], Counter())[_status(result, reasons)] += 1
    lines = [_HEAD.format(count=len(results), seed=seed, total=total, judged=len(results))]
    lines += ["| part | killed | survived | equivalent | score |", "|---|---|---|---|---|"]
    for name, counts in [*by_suite.items(), ("all", sum(by_suite.values(), Counter()))]:
        killed, survived = counts["killed"], counts["survived"]
        score = f"{killed / (killed + survived):.1%}" if killed + survived else "–"
        lines.append(f"| {name} | {killed} | {survived} | {counts['equivalent']} | {score} |")
    lines += _table("Survivors", results, reasons, "survived")
    lines += _table("Equivalent mutants", results, reasons, "equivalent")
    return "\n".join(lines) + "\n"


def _status(result: Mapping[str, Any], reasons: Mapping[str, str]) -> str:
    if result["status"] == "same netlist":
        return "equivalent"
    if result["status"] == "survived" and result["key"] in reasons:
        return "equivalent"
    return result["status"]


def _table(
    title: str, results: Sequence[Mapping[str, Any]], reasons: Mapping[str, str], status: str
) -> list[str]:
    """Return a section that lists the mutants of a status."""
    rows = []
    for result in sorted(results, key=lambda r: (r["path"], r["line"])):
        if _status(result, reasons) != status:
            continue
        file = result["path"].removeprefix("hdl/hueflight_hdl/")
        after = _code(result["after"]) if result["after"] else "removed"
        cells = [f"{file}:{result['line']}", result["where"], _code(result["before"]), after]
        cells.append(
            reasons.get(result["key"], "same netlist" if status == "equivalent" else result["key"])
        )
        rows.append("| " + " | ".join(cells) + " |")
    if not rows:
        return []
    last = "reason" if status == "equivalent" else "key"
    return [
        "",
        f"## {title}",
        "",
        f"| place | function | before | after | {last} |",
        "|---|---|---|---|---|",
        *rows,
    ]


def _code(text: str) -> str:
    flat = " ".join(text.split()).replace("|", "\\|")
    return f"`{flat if len(flat) <= 70 else flat[:67] + '…'}`"
