# SPDX-License-Identifier: Apache-2.0
"""A Dask cluster, real processes included."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import distributed
import numpy as np
import pytest

import hueflight as hf
from hueflight.batch import reconstruct_many
from hueflight.importers import read_image
from hueflight.importers.captures import read_capture

# what dask's own shutdown leaves open is not ours to mend
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")


@pytest.fixture
def threads() -> Iterator[distributed.LocalCluster]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster


def test_a_cluster_gives_the_same_images(
    captures: list[Path],
    calibration: hf.Calibration,
    tmp_path: Path,
    threads: distributed.LocalCluster,
) -> None:
    captures[3].write_bytes(b"not counts")
    address = threads.scheduler_address
    report = reconstruct_many(
        captures, tmp_path / "out", calibration=calibration, scheduler=address
    )
    assert [o.state for o in report.outcomes] == ["done", "done", "done", "failed", "done"]
    for path, outcome in zip(captures, report.outcomes, strict=True):
        if outcome.state == "done":
            wanted = hf.reconstruct(read_capture(path).counts, calibration)
            np.testing.assert_array_equal(read_image(outcome.store)["depth"], wanted["depth"])
    again = reconstruct_many(captures, tmp_path / "out", calibration=calibration, scheduler=address)
    assert [o.state for o in again.outcomes] == ["kept", "kept", "kept", "failed", "kept"]


def reads(pid: int, name: str) -> bool:
    folder = Path(f"/proc/{pid}/fd")
    for link in folder.iterdir() if folder.is_dir() else ():
        with suppress(OSError):  # closed meanwhile
            if name in str(link.readlink()):
                return True
    return False


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs /proc to find the reader")
def test_a_killed_cluster_worker_costs_nothing_but_time(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    counts = read_capture(captures[2]).counts
    captures[2] = captures[2].with_suffix(".npy")  # a named pipe, on which the reader waits
    real = tmp_path / "real.npy"
    np.save(real, counts)
    os.mkfifo(captures[2])
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
    ) as cluster:

        def kill_the_reader() -> None:
            while True:
                try:
                    handle = os.open(captures[2], os.O_WRONLY | os.O_NONBLOCK)
                    break
                except OSError:
                    time.sleep(0.05)
            readers: list[int] = []
            while not readers:  # its opening may take a moment longer than ours
                readers = [n.pid for n in cluster.workers.values() if reads(n.pid, "run2.npy")]
            real.replace(captures[2])
            os.kill(readers[0], signal.SIGKILL)
            while reads(readers[0], "run2.npy"):
                time.sleep(0.01)
            os.close(handle)

        killer = threading.Thread(target=kill_the_reader)
        killer.start()
        report = reconstruct_many(
            captures,
            tmp_path / "out",
            calibration=calibration,
            scheduler=cluster.scheduler_address,
        )
        killer.join()
    assert not report.failed
    wanted = hf.reconstruct(counts, calibration)
    np.testing.assert_array_equal(read_image(report.outcomes[2].store)["depth"], wanted["depth"])
