# SPDX-License-Identifier: Apache-2.0
"""Compare two runs of a benchmark, each written with `--json`.

    python3 tools/dev.py bench compare OLD NEW

Every row of both files is printed with its times and their ratio: above 1 where NEW is faster. The
machine's own limits come first: where they differ, so do the machines, or what else ran on them.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from _measure import table


def rows_of(old: dict[str, float], new: dict[str, float]) -> list[list[str]]:
    """Lines of the rows that both have: name, milliseconds of both, ratio."""
    return [
        [name, f"{old[name] * 1e3:.2f}", f"{new[name] * 1e3:.2f}", f"{old[name] / new[name]:.2f}"]
        for name in old
        if name in new
    ]


def read(path: Path) -> dict[str, Any]:
    """Record in a file."""
    record = json.loads(path.read_text(encoding="utf-8"))
    if record.get("format") != 1:
        raise SystemExit(f"{path} was not written by a benchmark with --json")
    return record


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    given = parser.parse_args()
    old, new = read(given.old), read(given.new)
    for name, record in (("old", old), ("new", new)):
        print(f"{name}: {record['kernel']}, on {record['processor'] or record['machine']}")
    head = ["", "old, ms", "new, ms", "old ÷ new"]
    tables = {"The machine's limits": (old["limits"], new["limits"])}
    shared = [title for title in old["tables"] if title in new["tables"]]
    tables |= {title: (old["tables"][title], new["tables"][title]) for title in shared}
    for title, pair in tables.items():
        print(f"\n## {title}\n\n{table(head, rows_of(*pair))}", flush=True)


if __name__ == "__main__":
    main()
