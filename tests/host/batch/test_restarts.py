# SPDX-License-Identifier: Apache-2.0
"""A cluster of processes that loses workers and its scheduler: nothing is lost or done twice."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

import hueflight as hf
from hueflight.batch import reconstruct_many
from hueflight.errors import BatchError
from hueflight.importers import read_image
from hueflight.importers.captures import write_counts

CAPTURES = int(os.environ.get("HUEFLIGHT_CAPTURES", "25"))
MEMORY_BYTES = 400 << 20  #: of a worker, for any number of captures

# what dask's own shutdown leaves open is not ours to mend
pytestmark = pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::UserWarning"
)


class Cluster:
    """A scheduler and two workers with nannies, as processes of the command ``dask``."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self._folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Start all of it, on the same address each time."""
        host, port = self.address.removeprefix("tcp://").split(":")
        dask = [sys.executable, "-m", "dask"]
        scheduler = [*dask, "scheduler", "--host", host, "--port", port]
        # a port of its own, since other tests run clusters at the same time
        scheduler += ["--dashboard-address", "127.0.0.1:0"]
        workers = [*dask, "worker", self.address, "--nworkers", "2", "--nthreads", "1"]
        workers += ["--no-dashboard", "--local-directory", str(self._folder)]
        for command in (scheduler, workers):
            with (self._folder / "log").open("ab") as log:
                self._processes.append(subprocess.Popen(command, stdout=log, stderr=log))

    def kill_worker(self) -> None:
        """Kill a process that works; its nanny starts another one."""
        nannies = psutil.Process(self._processes[1].pid)
        working = [p for p in nannies.children() if "spawn_main" in " ".join(p.cmdline())]
        os.kill(working[0].pid, signal.SIGKILL)

    def kill_scheduler(self) -> None:
        """Kill the scheduler, without which the workers end."""
        self._processes[0].kill()

    def stop(self) -> None:
        """End all processes."""
        for process in reversed(self._processes):
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
            process.kill()
            process.wait()
        self._processes.clear()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    folder = tmp_path / "dask"
    folder.mkdir()
    made = Cluster(folder)
    made.start()
    yield made
    made.stop()


def disturb(out: Path, faults: dict[int, Callable[[], None]]) -> threading.Thread:
    """Cause faults when so many results are there."""

    def watch() -> None:
        for count, cause in sorted(faults.items()):
            while len(list(out.glob("run*.zarr"))) < count:
                time.sleep(0.02)
            cause()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread


@pytest.mark.slow
def test_workers_and_the_scheduler_are_killed(
    cluster: Cluster,
    calibration: hf.Calibration,
    camera: hf.Instrument,
    draw: Callable[..., np.ndarray],
    tmp_path: Path,
) -> None:
    depths = 0.4 + 0.01 * (np.arange(CAPTURES) % 25)
    for at in range(CAPTURES):
        write_counts(tmp_path / f"run{at:04}.npz", draw(camera, depth=depths[at], seed=at), camera)
    captures, out = sorted(tmp_path.glob("run*.npz")), tmp_path / "results"
    faults = {
        CAPTURES // 5: cluster.kill_worker,
        2 * CAPTURES // 5: cluster.kill_worker,
        3 * CAPTURES // 5: cluster.kill_scheduler,
    }
    watching = disturb(out, faults)
    with pytest.raises(BatchError, match=r"the Dask scheduler at .* is gone"):
        reconstruct_many(captures, out, calibration=calibration, scheduler=cluster.address)
    watching.join()
    cluster.stop()
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("run*.zarr")}
    assert 3 * CAPTURES // 5 <= len(before) < CAPTURES
    cluster.start()
    report = reconstruct_many(captures, out, calibration=calibration, scheduler=cluster.address)
    assert not report.failed
    assert 0 < report.peak_memory_bytes < MEMORY_BYTES
    kept = {Path(o.store).name for o in report.outcomes if o.state == "kept"}
    assert kept == set(before)
    assert all((out / name).stat().st_mtime_ns == changed for name, changed in before.items())
    means = [float(read_image(o.store)["depth"].mean()) for o in report.outcomes]
    np.testing.assert_allclose(means, depths, atol=0.02)
