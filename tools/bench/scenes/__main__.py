# SPDX-License-Identifier: Apache-2.0
"""What the reconstruction does on scenes, sensors and days as they are: a table of promises.

    python3 tools/dev.py bench scenes [GROUP ...] [--quick] [--write]

Data come from `outside_model.py`, which shares no code with the project, from the simulator where
a row says so, and from real captures. `--write` puts the table where the documentation shows it;
it needs every group. The exit code is 1 if a limit does not hold.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import as_they_were
import clean
import departures
import deviations
import edges
import one_pixel
import pileup
import pooled_checks
import returns
import second_returns
from _measure import table
from acceptance import Group, Row

#: name → function that draws data and yields rows
GROUPS: dict[str, Group] = {
    "clean": clean.rows,
    "deviations": deviations.rows,
    "edges": edges.rows,
    "departures": departures.rows,
    "returns": returns.rows,
    "pooled": pooled_checks.rows,
    "pileup": pileup.rows,
    "as-they-were": as_they_were.rows,
    "second-returns": second_returns.rows,
    "one-pixel": one_pixel.rows,
}
PAGE = Path(__file__).parents[3] / "docs" / "results" / "scenes.inc"


def main() -> None:
    """Measure the groups that were asked for, all by default, and print the table."""
    names = [name for name in sys.argv[1:] if not name.startswith("--")]
    unknown = set(names) - set(GROUPS)
    if unknown:
        raise SystemExit(f"no such group: {', '.join(unknown)}; there are {', '.join(GROUPS)}")
    chosen = names or list(GROUPS)
    rows: list[Row] = []
    for name in chosen:
        start = time.perf_counter()
        for row in GROUPS[name]("--quick" in sys.argv):
            rows.append(row)
            print(" | ".join(row.cells()), flush=True)
        print(f"({name}: {time.perf_counter() - start:.0f} s)", file=sys.stderr)
    text = table(["what", "measured", "limit", "aim", "holds"], [row.cells() for row in rows])
    if "--write" in sys.argv:
        if chosen != list(GROUPS):
            raise SystemExit("--write needs every group")
        PAGE.write_text(text)
    sys.exit(any(row.holds is False for row in rows))


if __name__ == "__main__":
    main()
