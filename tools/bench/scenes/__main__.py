# SPDX-License-Identifier: Apache-2.0
"""What the reconstruction does on scenes, sensors and days as they are: a table of promises.

    python3 tools/dev.py bench scenes [GROUP ...] [--quick] [--write]
    python3 tools/dev.py bench scenes --effects [EFFECT ...] [--write]
    python3 tools/dev.py bench scenes --reflections [--write]
    python3 tools/dev.py bench scenes --pictures

Data come from `outside_model.py`, which shares no code with the project, from the simulator where
a row says so, and from real captures. `--write` puts the table where the documentation shows it;
of some groups or effects alone, it replaces their rows. The exit code is 1 if a limit does not
hold. `--effects` shows instead what each effect of the simulator does to every method,
`--reflections` what fixed reflections of any strength do, and `--pictures` draws scenes before and
after they are tested.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import as_they_were
import clean
import departures
import deviations
import edges
import effects_table
import one_pixel
import one_pixel_pairs
import pictures
import pileup
import pooled_checks
import real_sensor
import reflections
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
    "real-sensor": real_sensor.rows,
    "pileup": pileup.rows,
    "as-they-were": as_they_were.rows,
    "second-returns": second_returns.rows,
    "one-pixel-pairs": one_pixel_pairs.rows,
    "one-pixel": one_pixel.rows,
}
RESULTS = Path(__file__).parents[3] / "docs" / "results"
PAGE, EFFECTS_PAGE = RESULTS / "scenes.inc", RESULTS / "scenes-effects.inc"
REFLECTIONS_PAGE = RESULTS / "scenes-reflections.inc"
HEAD = ["what", "measured", "limit", "aim", "holds"]


def main() -> None:
    """Do what the arguments ask for: by default, measure all groups and print the table."""
    names = [name for name in sys.argv[1:] if not name.startswith("--")]
    if "--pictures" in sys.argv:
        print(pictures.draw())
    elif "--effects" in sys.argv:
        _require_known(names, effects_table.REMEDIES, "effect")
        _show(EFFECTS_PAGE, effects_table.HEAD, effects_table.lines(names), whole=not names)
    elif "--reflections" in sys.argv:
        _show(REFLECTIONS_PAGE, reflections.head(), reflections.lines(), whole=True)
    else:
        _promises(names)


def _promises(names: list[str]) -> None:
    """Measure groups and print their rows; exit code 1 if a limit does not hold."""
    _require_known(names, GROUPS, "group")
    chosen = names or list(GROUPS)
    rows: list[Row] = []
    for name in chosen:
        start = time.perf_counter()
        for row in GROUPS[name]("--quick" in sys.argv):
            rows.append(row)
            print(" | ".join(row.cells()), flush=True)
        print(f"({name}: {time.perf_counter() - start:.0f} s)", file=sys.stderr)
    if "--write" in sys.argv:
        _write(PAGE, HEAD, [row.cells() for row in rows], whole=not names)
    sys.exit(any(row.holds is False for row in rows))


def _show(page: Path, head: list[str], lines: Iterable[list[str]], *, whole: bool) -> None:
    """Print the lines of a table as they are measured, and write it if asked to."""
    shown = []
    for line in lines:
        shown.append(line)
        print(" | ".join(line), flush=True)
    if "--write" in sys.argv:
        _write(page, head, shown, whole=whole)


def _require_known(names: list[str], known: Iterable[str], kind: str) -> None:
    if unknown := sorted(set(names) - set(known)):
        raise SystemExit(f"no such {kind}: {', '.join(unknown)}; there are {', '.join(known)}")


def _write(page: Path, head: list[str], rows: list[list[str]], *, whole: bool) -> None:
    """Write a table; rows that it has already, by their first cell, are replaced."""
    kept: dict[str, list[str]] = {}
    if not whole and page.exists():
        for line in page.read_text().splitlines()[2:]:
            cells = [
                cell.strip()
                for cell in line.strip().removeprefix("|").removesuffix("|").split(" | ")
            ]
            kept[cells[0]] = cells
    page.write_text(table(head, list((kept | {row[0]: row for row in rows}).values())))


if __name__ == "__main__":
    main()
