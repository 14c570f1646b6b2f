# SPDX-License-Identifier: Apache-2.0
"""The page of mutation testing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import beta

from mutation.subjects import Subject

_HEAD = """# Mutation testing

Test suites are judged by faults that are put into the sources on purpose: one operator, constant,
condition, assignment or call in one file is changed, and the tests of that part are run. A mutant
that makes a test fail, or run without end, is *killed*; one that no test notices has *survived*.
Mutants of the gateware that give the same netlists for all boards as the original, those of the
software that give the same bytecode or the same compiled kernels, and those listed below with a
reason, are *equivalent* and do not count.

Only what functions do is changed: declarations such as register maps, macros, generated files, and
texts are not. The gateware's reduction to sums is not among the sources yet.

```sh
python tools/mutate.py run --count 200              # the gateware; goes on where it stopped
python tools/mutate.py run --of host --count 200    # the software from packets to images
python tools/mutate.py page                         # writes this page
```

The mutants of a part that were judged are a simple random sample of them (seed {seed}). For
survivors tests were added, and they were judged again. The *score* is what became of the sample in
the end; it says little of mutants that were not drawn. For those the score *at first* is an
estimate, that of the tests before they knew the sample, with the exact binomial (Clopper-Pearson)
interval, which covers the true score in at least {confidence:.0%} of such samples. The scores of
all weigh parts by their mutants where one part was sampled more than another. Survivors are
counted as faults that the tests miss, unless a reason below says otherwise.
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


@dataclass(frozen=True)
class Judged:
    """A sample of the mutants of a subject.

    Parameters
    ----------
    subject : Subject
        What has mutants.
    results : mapping of str to sequence of mapping
        Records of ``tools/mutate.py`` for each part, a random sample of its mutants; ``first`` is
        the status of a mutant when it was first judged.
    totals : mapping of str to int
        Number of mutants that each part has.
    simple : bool
        Whether all of them together are a simple random sample of all mutants.
    """

    subject: Subject
    results: Mapping[str, Sequence[Mapping[str, Any]]]
    totals: Mapping[str, int]
    simple: bool

    @property
    def every(self) -> list[Mapping[str, Any]]:
        """Records of all parts."""
        return [result for part in self.results.values() for result in part]


def write_page(judged: Sequence[Judged], reasons: Mapping[str, str], *, seed: int) -> str:
    """Return the page in Markdown.

    Parameters
    ----------
    judged : sequence of Judged
        Samples; those without results are left out.
    reasons : mapping of str to str
        Why mutants are equivalent, by key.
    seed : int
        Seed of the samples.

    Returns
    -------
    str
        The page.
    """
    lines = [_HEAD.format(seed=seed, confidence=CONFIDENCE)]
    for sample in judged:
        if sample.every:
            lines += _section(sample, reasons)
    return "\n".join(lines) + "\n"


def _section(sample: Judged, reasons: Mapping[str, str]) -> list[str]:
    """Return the section of a subject: scores of its parts, survivors, equivalent mutants."""
    counts, at_first = (
        {
            name: Counter(_status(result, reasons, key) for result in part)
            for name, part in sorted(sample.results.items())
        }
        for key in ("status", "first")
    )
    every = sum(counts.values(), Counter())
    known = f"{len(sample.every):,} of {sum(sample.totals.values()):,} mutants were judged."
    if every["not compiled"]:
        known += f" {every['not compiled']} of them cannot be compiled and do not count."
    lines = [
        f"## {sample.subject.title}",
        "",
        known,
        "",
        "| part | mutants | killed | survived | equivalent | score | at first "
        f"| {CONFIDENCE:.0%} interval |",
        "|---|---|---|---|---|---|---|---|",
    ]
    firsts = [*at_first.values(), sum(at_first.values(), Counter())]
    for (name, found), first in zip([*counts.items(), ("all", every)], firsts, strict=True):
        total = sample.totals.get(name, sum(sample.totals.values()))
        score = then = shown = "–"
        alone = name != "all" or sample.simple
        if found["killed"] + found["survived"]:
            score = f"{_share(found) if alone else _weighted(counts, sample.totals):.1%}"
        if first["killed"] + first["survived"]:
            then = f"{_share(first) if alone else _weighted(at_first, sample.totals):.1%}"
            bounds = interval(first["killed"], first["survived"])
            shown = " to ".join(f"{bound:.1%}" for bound in bounds) if alone else "–"
        numbers = (found[status] for status in ("killed", "survived", "equivalent"))
        cells = (name, f"{total:,}", *numbers, score, then, shown)
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += _table("Survivors", sample, reasons, "survived")
    return [*lines, *_table("Equivalent mutants", sample, reasons, "equivalent"), ""]


def _share(found: Counter[str]) -> float:
    return found["killed"] / (found["killed"] + found["survived"])


def _weighted(counts: Mapping[str, Counter[str]], totals: Mapping[str, int]) -> float:
    """Return the score of all parts of which mutants were judged, by their numbers of mutants."""
    parts = {
        name: _share(found) for name, found in counts.items() if found["killed"] + found["survived"]
    }
    return sum(share * totals[name] for name, share in parts.items()) / sum(
        totals[name] for name in parts
    )


def _status(result: Mapping[str, Any], reasons: Mapping[str, str], key: str = "status") -> str:
    if result[key] in ("same netlist", "same code"):
        return "equivalent"
    if result[key] == "survived" and result["key"] in reasons:
        return "equivalent"
    return result[key]


def _table(title: str, sample: Judged, reasons: Mapping[str, str], status: str) -> list[str]:
    """Return a section that lists the mutants of a status."""
    rows = []
    for result in sorted(sample.every, key=lambda r: (r["path"], r["line"])):
        if _status(result, reasons) != status:
            continue
        file = result["path"]
        for prefix in ("hdl/hueflight_hdl/", "host/hueflight/", "protocol/hueflight_protocol/"):
            file = file.removeprefix(prefix)
        after = _code(result["after"]) if result["after"] else "removed"
        cells = [f"{file}:{result['line']}", result["where"], _code(result["before"]), after]
        known = result["status"] if status == "equivalent" else result["key"]
        rows.append("| " + " | ".join([*cells, reasons.get(result["key"], known)]) + " |")
    if not rows:
        return []
    last = "reason" if status == "equivalent" else "key"
    return [
        "",
        f"### {title}: {sample.subject.name}",
        "",
        f"| place | function | before | after | {last} |",
        "|---|---|---|---|---|",
        *rows,
    ]


def _code(text: str) -> str:
    flat = " ".join(text.split()).replace("|", "\\|")
    return f"`{flat if len(flat) <= 70 else flat[:67] + '…'}`"
