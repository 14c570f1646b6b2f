# SPDX-License-Identifier: Apache-2.0
"""Speed and memory of many captures on one worker, on two, and on a Dask cluster.

    python3 tools/dev.py bench batch [CAPTURES] [METHOD]

Every figure is a ratio to one worker in the same run. Each run starts its workers anew, so that
their start (a second or two) counts.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import distributed
import numpy as np

import hueflight as hf
from hueflight import simulator
from hueflight.batch import BatchReport, reconstruct_many
from hueflight.importers.captures import write_counts


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=int, nargs="?", default=200, help="number of captures")
    parser.add_argument("method", nargs="?", default="paper", help="method of reconstruction")
    arguments = parser.parse_args()
    captures, method = arguments.captures, arguments.method
    instrument = hf.Instrument.load("paper")
    reference = simulator.simulate_capture("reference", instrument, frames=2000)
    calibration = hf.calibrate(reference, instrument, distance=0.4)
    scene = simulator.scene("fig1", instrument)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"run{number:03d}.npy" for number in range(captures)]
        first = Path(folder) / "first.npz"
        write_counts(first, simulator.simulate_histogram(scene, instrument, frames=500), instrument)
        counts = np.load(first)["histogram"]
        for path in paths:  # the same counts under many names, since only the time matters here
            np.save(path, counts)
        common: dict[str, Any] = {"calibration": calibration, "options": {"method": method}}
        runs: list[tuple[str, float, BatchReport]] = []
        for workers in (1, 2):
            start = time.perf_counter()
            report = reconstruct_many(paths, f"{folder}/{workers}", workers=workers, **common)
            runs.append((f"{workers} local", time.perf_counter() - start, report))
        # port 0: any that is free
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster:
            start = time.perf_counter()
            address = str(getattr(cluster, "scheduler_address"))  # noqa: B009 - untyped there
            report = reconstruct_many(paths, f"{folder}/dask", scheduler=address, **common)
            runs.append(("2 on Dask", time.perf_counter() - start, report))
    one = runs[0][1]
    print(f"{captures} captures of {instrument.image_shape[0]}×{instrument.image_shape[1]} pixels")
    print("workers      speed   work/wall   most memory of a worker   failed")
    for name, seconds, report in runs:
        work = sum(outcome.seconds for outcome in report.outcomes)
        memory = report.peak_memory_bytes / 2**20
        failed = len(report.failed)
        print(
            f"{name:<11} {one / seconds:5.2f}× {work / seconds:9.2f} {memory:18.0f} MiB {failed:13}"
        )


if __name__ == "__main__":
    main()
