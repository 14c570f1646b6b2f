# SPDX-License-Identifier: Apache-2.0
"""Depth from real photons by methods of others and ours, judged by photons that none has seen.

    python3 tools/dev.py bench scoreboard [DATA SET ...] [--write]

Data sets: face, night; they are read beside the project, in ../shared/data/photons. `--write` puts
the tables where the documentation shows them.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from _measure import table
from data_sets import DATA_SETS, FILES, Half, halves
from methods import METHODS, Method
from score import held_out_bits

ROOT = Path(__file__).resolve().parents[3]
RESULT = ROOT / "docs" / "results" / "scoreboard.inc"
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


def main() -> None:
    """Print the tables, and write them if that is wanted."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", nargs="*", choices=[*DATA_SETS, []], help="data sets; default all")
    parser.add_argument("--write", action="store_true", help=f"write {RESULT.relative_to(ROOT)}")
    arguments = parser.parse_args()
    text = ""
    for name in arguments.sets or DATA_SETS:
        if not FILES[name].exists():
            raise SystemExit(f"{name}: {FILES[name]} is not there, so nothing is measured")
        one, other = halves(name)
        about = (DATA_SETS[name].__doc__ or "").splitlines()[0]
        print(about, flush=True)
        text += (
            f"**{about}** Half of them are used.\n\n{table(HEAD, rows_of(one, other)).strip()}\n\n"
        )
    print(text)
    if arguments.write:
        RESULT.write_text(text.strip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
