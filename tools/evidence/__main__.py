# SPDX-License-Identifier: Apache-2.0
"""The evidence that recordings and kernels are right: measurements of docs/evidence.md.

    python3 tools/dev.py run python tools/evidence NAME ... [--quick] [--write]

Without a name, all are made. `coverage:PACKAGE` runs the tests of one package and shows it with
what was measured before. `--write` puts the results where the page shows them; `--quick` makes
small ones. The exit code is 1 if something was found that must not be.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import import_module

from branch_coverage import PARTS
from report import RESULTS, Report

MEASUREMENTS = {
    "power-cuts": "power_cuts",
    "allocations": "allocations",
    "memory": "memory",
    "memory-of-results": "memory_of_results",
    "threads": "threads",
    "coverage": "branch_coverage",
}
"""Modules with a function `report`, by name."""


def measure(name: str, *, quick: bool, write: bool) -> list[str]:
    """Make a measurement, print its table, and return its findings."""
    began = time.monotonic()
    name, _, part = name.partition(":")
    module = import_module(MEASUREMENTS[name])
    result: Report = module.report(quick, part) if part else module.report(quick)
    print(f"{result.text}\n({name}: {time.monotonic() - began:.0f} s)", flush=True)
    if write:
        path = RESULTS / f"evidence-{name}.inc"
        path.write_text(f"`python tools/evidence {name}`\n\n{result.text}", encoding="utf-8")
    return [f"{name}: {finding}" for finding in result.findings]


def main() -> None:
    """Read the command line and make the measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MEASUREMENTS))
    parser.add_argument("--quick", action="store_true", help="small measurements, for tests")
    parser.add_argument("--write", action="store_true", help="write the results for the page")
    arguments = parser.parse_args()
    known = [*MEASUREMENTS, *(f"coverage:{part}" for part in PARTS)]
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        parser.error(f"{unknown[0]!r} is not one of {', '.join(known)}")
    if arguments.quick and arguments.write:
        parser.error("results of --quick are not for the page")
    findings = []
    for name in arguments.names or MEASUREMENTS:
        findings += measure(name, quick=arguments.quick, write=arguments.write)
    for finding in findings:
        print(finding, file=sys.stderr)
    raise SystemExit(bool(findings))


if __name__ == "__main__":
    main()
