#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Run the daemon's own process with faults at random, and check its books.

    python3 tools/dev.py faults                      500 runs
    python3 tools/dev.py faults --seed 17 --runs 1   the run of one seed again
    python3 tools/dev.py faults --runs 0             until Ctrl-C

In each run, a seed decides about the frame rate, the disk, odd values of the configuration, and one
to four faults: of cable, camera and power (on real libusb, by an emulated bus), of the disk (errors
of its calls, full, unmounted), of the program, of clients, of the wall clock, and the end of the
process by SIGKILL. In the end every frame must be accounted for, every recording whole up to its
fault, and `/health` must have told of each fault.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.emulation import missing_packages  # noqa: E402 - after the path that it lies on
from support.fault_runs.machine import LATE_S  # noqa: E402
from support.fault_runs.run import FaultResult, fault_run  # noqa: E402

NICENESS = 10
RUNS_EACH = 20  #: of a process; then another one takes its place


def results(seeds: Iterator[int], *, jobs: int, build: Path, keep: bool) -> Iterator[FaultResult]:
    """Results of the runs of these seeds, as they come."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, max_tasks_per_child=RUNS_EACH) as pool:
        running: set[Future[FaultResult]] = set()
        while True:
            for seed in itertools.islice(seeds, jobs - len(running)):
                running.add(pool.submit(fault_run, seed, build, keep=keep))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)


def read_log(path: Path) -> list[FaultResult]:
    """Results in a log; of runs of the same seed, the last one."""
    found = [FaultResult(**json.loads(line)) for line in path.read_text().splitlines()]
    return sorted({result.seed: result for result in found}.values(), key=lambda each: each.seed)


def summary(found: list[FaultResult], command: str) -> str:
    """The results as tables in Markdown."""
    counts = Counter(fault for result in found for fault in result.faults)
    told = defaultdict(list)
    for result in found:
        for fault, seconds in result.told_s:
            told[fault].append(seconds)
    times = sorted(seconds for each in told.values() for seconds in each)
    failed = [result for result in found if result.failure]
    rows = [
        ("runs", f"{len(found)}, seeds {found[0].seed} to {found[-1].seed}"),
        ("faults", sum(counts.values())),
        ("runs in which something was wrong", len(failed)),
        ("frames exposed", f"{sum(result.frames_exposed for result in found):,}"),
        ("frames in recordings", f"{sum(result.frames_recorded for result in found):,}"),
        ("time per run", f"{sum(result.seconds for result in found) / len(found):.1f} s"),
    ]
    if times:
        late = sum(seconds > LATE_S for seconds in times)
        rows += [
            ("faults that `/health` has told of", len(times)),
            (
                "time until it told: median, 99 %, longest",
                f"{times[len(times) // 2]:.2f}, {times[int(0.99 * len(times))]:.2f}, "
                f"{times[-1]:.2f} s",
            ),
            (f"later than {LATE_S:g} s", late),
        ]
    lines = [f"`{command}`", "", "| what | value |", "| --- | --- |"]
    lines += [f"| {name} | {value} |" for name, value in rows]
    lines += ["", "| fault | times |", "| --- | --- |"]
    lines += [f"| {name} | {number} |" for name, number in sorted(counts.items())]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=500, help="0: until Ctrl-C")
    parser.add_argument("--seed", type=int, default=1, help="of the first run")
    parser.add_argument("--jobs", type=int, default=2, help="runs at the same time")
    parser.add_argument("--keep", action="store_true", help="keep the folder of every run")
    parser.add_argument("--log", type=Path, help="file for one line of JSON per run, appended to")
    parser.add_argument("--read", type=Path, help="sum up the runs of such a file, run nothing")
    parser.add_argument("--docs", action="store_true", help="write docs/results/fault-runs.inc")
    chosen = parser.parse_args()
    found = read_log(chosen.read) if chosen.read is not None else run(chosen)
    if not found:
        return
    first, last = found[0].seed, found[-1].seed
    command = f"python tools/dev.py faults --seed {first} --runs {last - first + 1}"
    text = summary(found, command)
    print(text)
    if chosen.docs:
        (ROOT / "docs/results/fault-runs.inc").write_text(text)
    raise SystemExit(any(result.failure for result in found))


def run(chosen: argparse.Namespace) -> list[FaultResult]:
    """Make the runs that are asked for."""
    if missing := missing_packages():
        raise SystemExit(f"the Debian packages {' '.join(missing)} are needed")
    if os.geteuid() != 0:
        raise SystemExit("disks are mounted in these runs: start them as root, in a container")
    os.nice(NICENESS)
    seeds = itertools.count(chosen.seed)
    if chosen.runs:
        seeds = itertools.islice(seeds, chosen.runs)
    found: list[FaultResult] = []
    build = Path(tempfile.gettempdir()) / "hueflight-shims"
    try:
        for result in results(seeds, jobs=chosen.jobs, build=build, keep=chosen.keep):
            found.append(result)
            print(
                f"{result.seed}: {result.failure or 'well'} ({', '.join(result.faults)}; "
                f"{result.seconds} s)",
                flush=True,
            )
            if chosen.log is not None:
                with chosen.log.open("a") as file:
                    file.write(result.as_json() + "\n")
    except KeyboardInterrupt:
        print("ended")
    return sorted(found, key=lambda result: result.seed)


if __name__ == "__main__":
    main()
