# SPDX-License-Identifier: Apache-2.0
"""Depth from real photons by methods of others and ours.

    python3 tools/dev.py bench scoreboard [DATA SET ...] [--write]
    python3 tools/dev.py bench scoreboard --two-returns FILE ...

Data sets: face, night, whose depths are judged by photons that no method has seen, and robot, whose
depths are known. They are read beside the project, in ../shared/data. `--write` puts the tables
where the documentation shows them. `two_returns.py` states what a file of captures with two
surfaces must hold.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
import robot
import two_returns
from _measure import table
from _tmf8820 import FILE as ROBOT_FILE
from data_sets import DATA_SETS, FILES, Half, halves
from methods import METHODS, Method
from score import held_out_bits

ROOT = Path(__file__).resolve().parents[3]
RESULTS = ROOT / "docs" / "results"
HEAD = ["method", "bits per photon", "halves apart, cm", "pixels with a depth", "processor time"]


def rows_of(one: Half, other: Half) -> list[list[str]]:
    """Run every method on both halves."""
    rows, least = [], None
    for name, variants in METHODS.items():
        tried = [(_run(method, one, other), words) for words, method in variants.items()]
        (bits, apart, known, seconds), words = max(tried, key=lambda each: each[0][0])
        least = seconds if least is None else least
        rows.append(
            [
                name + (f", {words}" if words else ""),
                f"{bits:.3f}",
                f"{100 * apart:.2f}",
                f"{known:.0%}",
                f"{seconds / least:.1f} ×",
            ]
        )
        print("  ", *rows[-1], flush=True)
    return rows


def _run(method: Method, one: Half, other: Half) -> tuple[float, float, float, float]:
    """Bits per photon, median distance of the halves' depths, share known, processor seconds."""
    started = time.process_time()
    first = method(one)
    seconds = time.process_time() - started
    second = method(other)
    bits = 0.5 * (held_out_bits(first, other) + held_out_bits(second, one))
    both = np.isfinite(first) & np.isfinite(second)
    apart = np.median(np.abs(first - second)[both]) if both.any() else np.nan
    return bits, float(apart), float(both.mean()), seconds


def held_out(names: list[str]) -> str:
    """Return the tables of data sets whose depths are not known."""
    text = ""
    for name in names:
        one, other = halves(name)
        about = (DATA_SETS[name].__doc__ or "").splitlines()[0]
        print(about, flush=True)
        text += (
            f"**{about}** Half of them are used.\n\n{table(HEAD, rows_of(one, other)).strip()}\n\n"
        )
    return text.strip() + "\n"


def main() -> None:
    """Print the tables, and write them if that is wanted."""
    files = {**FILES, "robot": ROBOT_FILE}
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", nargs="*", choices=[*files, []], help="data sets; default all")
    parser.add_argument(
        "--write", action="store_true", help=f"write tables in {RESULTS.relative_to(ROOT)}"
    )
    parser.add_argument(
        "--two-returns", nargs="+", type=Path, metavar="FILE", help="captures with two surfaces"
    )
    arguments = parser.parse_args()
    for path in arguments.two_returns or ():
        print(f"{path.name}: half of the photons are used.", flush=True)
        print(table(two_returns.HEAD, two_returns.rows_of(two_returns.read(path))))
    if arguments.two_returns:
        return
    names = arguments.sets or list(files)
    for name in names:
        if not files[name].exists():
            raise SystemExit(f"{name}: {files[name]} is not there, so nothing is measured")
    made = {}
    if "robot" in names:
        made["scoreboard-robot"] = table(robot.HEAD, robot.rows())
    if judged := [name for name in names if name in DATA_SETS]:
        made["scoreboard"] = held_out(judged)
    for name, text in made.items():
        print(text)
        whole = name != "scoreboard" or len(judged) == len(DATA_SETS)
        if arguments.write and whole:
            (RESULTS / f"{name}.inc").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
