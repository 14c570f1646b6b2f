# SPDX-License-Identifier: Apache-2.0
"""The page of mutation testing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import beta

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

The sources have {total} mutants. The {judged} that were judged are a simple random sample of them
(seed {seed}), so the score of all is known to within the interval given with it: the exact binomial
(Clopper-Pearson) interval, which covers the true score in at least {confidence:.0%} of such
samples. Survivors are counted as faults that the tests miss, unless a reason below says otherwise.
"""
CONFIDENCE = 0.95


def interval(
    killed: int, survived: int, /, *, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of the share of mutants that are killed.

    Parameters
    ----------
    killed, survived : int
        Mutants of a random sample.
    confidence : float
        Share of samples whose interval contains the true share, at least.

    Returns
    -------
    tuple of float
        Lower and upper bound.
    """
    tail = (1 - confidence) / 2
    low = beta.ppf(tail, killed, survived + 1) if killed else 0.0
    high = beta.ppf(1 - tail, killed + 1, survived) if survived else 1.0
    return float(low), float(high)


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
    count = len(results)
    lines = [
        _HEAD.format(count=count, seed=seed, total=total, judged=count, confidence=CONFIDENCE),
        f"| part | killed | survived | equivalent | score | {CONFIDENCE:.0%} interval |",
        "|---|---|---|---|---|---|",
    ]
    for name, counts in [*by_suite.items(), ("all", sum(by_suite.values(), Counter()))]:
        killed, survived = counts["killed"], counts["survived"]
        score = shown = "–"
        if killed + survived:
            score = f"{killed / (killed + survived):.1%}"
            shown = " to ".join(f"{bound:.1%}" for bound in interval(killed, survived))
        cells = (name, killed, survived, counts["equivalent"], score, shown)
        lines.append(f"| {' | '.join(map(str, cells))} |")
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
