# SPDX-License-Identifier: Apache-2.0
"""Many captures: the same images as one by one, nothing done twice, failures alone."""

import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.batch import BatchReport, DaskCluster, Job, LocalWorkers, Outcome, reconstruct_many
from hueflight.batch.job import work
from hueflight.errors import BatchError, CalibrationError, MissingPackageError
from hueflight.importers import read_image
from hueflight.importers.captures import read_capture, write_counts

T = TypeVar("T")


class InThisProcess:
    """The simplest executor; also shows that a user may bring one."""

    def run(self, job: Job, captures: Sequence[str], /) -> Iterator[Outcome]:
        for capture in captures:
            yield work(capture, job)


def states(report: BatchReport) -> list[str]:
    return [outcome.state for outcome in report.outcomes]


def expected(path: Path, calibration: hf.Calibration) -> xr.Dataset:
    return hf.reconstruct(read_capture(path).counts, calibration)


def test_two_workers_give_what_one_call_at_a_time_gives(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    report = reconstruct_many(captures, out, calibration=calibration, workers=2)
    assert states(report) == ["done"] * 5
    assert [outcome.capture for outcome in report.outcomes] == [str(path) for path in captures]
    assert len({outcome.worker for outcome in report.outcomes}) == 2
    for path, outcome in zip(captures, report.outcomes, strict=True):
        image = read_image(outcome.store)
        wanted = expected(path, calibration)
        for name in wanted.data_vars:
            np.testing.assert_array_equal(image[name], wanted[name])
        assert image.attrs["capture"] == path.name
        assert json.loads(image.attrs["calibration"])["distance_m"] == 0.4
    assert 10e6 < report.peak_memory_bytes < 2e9
    written = json.loads((out / "batch.json").read_text())
    assert written == report.to_dict()
    assert written["done"] == 5


def test_what_is_done_is_not_done_again(
    captures: list[Path],
    calibration: hf.Calibration,
    camera: hf.Instrument,
    draw: Callable[..., np.ndarray],
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"

    def again(calibration: hf.Calibration = calibration, **options: object) -> list[str]:
        return states(
            reconstruct_many(
                captures, out, calibration=calibration, executor=InThisProcess(), options=options
            )
        )

    assert again() == ["done"] * 5
    assert again() == ["kept"] * 5
    # a capture that is new under its old name
    write_counts(captures[1], draw(camera, depth=0.9, seed=77), camera)
    assert again() == ["kept", "done", "kept", "kept", "kept"]
    # stores that are half there, or damaged
    (out / "run2.zarr" / "depth" / "0.0").unlink()
    (out / "run3.zarr" / ".zattrs").write_text("{}")
    (out / "run4.zarr" / "quality" / "0.0").write_bytes(b"x")
    assert again() == ["kept", "kept", "done", "done", "done"]
    # other options, another calibration
    assert again(range_correction=True) == ["done"] * 5
    assert again(range_correction=True) == ["kept"] * 5
    other = hf.calibrate(draw(camera, depth=0.4, photons=20_000, seed=5), camera, distance=0.4)
    assert again(other) == ["done"] * 5


def test_failures_stay_alone_and_are_told(
    captures: list[Path],
    calibration: hf.Calibration,
    small: Callable[..., hf.Instrument],
    draw: Callable[..., np.ndarray],
    tmp_path: Path,
) -> None:
    stranger = small(rows=3, cols=3)
    write_counts(captures[0], draw(stranger), stranger)
    captures[1].write_bytes(captures[1].read_bytes()[:1000])
    captures[2].unlink()
    np.savez(captures[3], np.full((10, 8, 512), np.nan))
    report = reconstruct_many(
        captures, tmp_path / "out", calibration=calibration, executor=InThisProcess()
    )
    assert states(report) == ["failed"] * 4 + ["done"]
    errors = [outcome.error or "" for outcome in report.failed]
    assert "sensor.rows: 3 != 10" in errors[0]
    assert "run1.npz" in errors[1]
    assert "run2.npz" in errors[2]
    assert "counts must be finite" in errors[3]
    assert sorted(p.name for p in (tmp_path / "out").glob("*.zarr")) == [
        "calibration.zarr",
        "run4.zarr",
    ]
    assert not list((tmp_path / "out").glob(".*.partial"))


def as_pipe(capture: Path) -> tuple[Path, Path]:
    """A named pipe that looks like a capture, on which a reader waits; and the real one."""
    counts = read_capture(capture).counts
    capture.unlink()
    pipe, real = capture.with_suffix(".npy"), capture.with_name("real.npy")
    np.save(real, counts)
    os.mkfifo(pipe)
    return pipe, real


def kill_readers(pipe: Path, times: int, replacement: Path | None) -> threading.Thread:
    """Kill every worker that reads `pipe`, so many times; then put a real capture in its place."""

    def act() -> None:
        for time_killed in range(times):
            # readers wait as long as this end is open, so it is closed whatever happens
            handle = soon(lambda: _opened(pipe))
            try:
                # its opening may take a moment longer than ours
                victim = soon(lambda: _reader(pipe))
                if replacement is not None and time_killed == times - 1:
                    replacement.replace(pipe)
                os.kill(victim, signal.SIGKILL)
                soon(lambda victim=victim: None if _reads(victim, pipe) else True)
            finally:
                os.close(handle)

    thread = threading.Thread(target=act)
    thread.start()
    return thread


def soon(look: Callable[[], T | None]) -> T:
    """What `look` finds once it finds something."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        found = look()
        if found is not None:
            return found
        time.sleep(0.01)
    raise TimeoutError("nothing to be seen for a minute")


def _opened(pipe: Path) -> int | None:
    """A pipe's writing end, if somebody reads from it or waits to."""
    with suppress(OSError):
        return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    return None


def _reader(pipe: Path) -> int | None:
    pids = [process.pid for process in multiprocessing.active_children()]
    return next((pid for pid in pids if pid is not None and _reads(pid, pipe)), None)


def _reads(pid: int, pipe: Path) -> bool:
    with suppress(OSError):  # it has ended
        for link in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # closed meanwhile
                if str(link.readlink()).startswith(str(pipe)):
                    return True
    return False


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs /proc to find the reader")
def test_a_killed_worker_costs_nothing_but_time(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    captures[2], real = as_pipe(captures[2])
    killer = kill_readers(captures[2], times=1, replacement=real)
    report = reconstruct_many(captures, tmp_path / "out", calibration=calibration, workers=2)
    killer.join()
    assert states(report) == ["done"] * 5
    assert [outcome.attempts for outcome in report.outcomes] == [1, 1, 2, 1, 1]
    image = read_image(report.outcomes[2].store)
    wanted = hf.reconstruct(np.load(captures[2]), calibration)
    np.testing.assert_array_equal(image["depth"], wanted["depth"])


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs /proc to find the reader")
def test_a_capture_that_kills_its_workers_fails_alone(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    captures[0], _ = as_pipe(captures[0])
    killer = kill_readers(captures[0], times=2, replacement=None)
    report = reconstruct_many(captures[:2], tmp_path / "out", calibration=calibration, workers=1)
    killer.join()
    assert states(report) == ["failed", "done"]
    assert report.failed[0].error == "2 workers died on it, the last by SIGKILL: out of memory?"
    assert report.failed[0].attempts == 2


def test_left_over_pieces_of_a_killed_run_are_swept(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    stale = out / ".run1.zarr.abc123.partial" / "run1.zarr"
    stale.mkdir(parents=True)
    other = out / ".someone-elses.zarr.xyz.partial"
    other.mkdir()
    reconstruct_many(captures, out, calibration=calibration, executor=InThisProcess())
    assert not stale.exists()
    assert other.exists()


def test_two_batches_keep_out_of_each_others_way(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    class Nested:
        def run(self, job: Job, captures: Sequence[str], /) -> Iterator[Outcome]:
            with pytest.raises(BatchError, match="another batch is writing to"):
                reconstruct_many(
                    captures, job.out, calibration=calibration, executor=InThisProcess()
                )
            yield from InThisProcess().run(job, captures)

    report = reconstruct_many(
        captures[:1], tmp_path / "out", calibration=calibration, executor=Nested()
    )
    assert states(report) == ["done"]


def test_segments_of_a_recording_are_one_capture(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    seen: list[str] = []

    class PreparedHistogram(InThisProcess):
        def run(self, job: Job, captures: Sequence[str], /) -> Iterator[Outcome]:
            seen.extend(Path(capture).name for capture in captures)
            return super().run(job, captures)

    names = ["run.mcap", "run.000001.mcap", "run.000002.mcap", "lone.000003.mcap"]
    reconstruct_many(
        [tmp_path / name for name in names],
        tmp_path / "out",
        calibration=calibration,
        executor=PreparedHistogram(),
    )
    assert seen == ["run.mcap", "lone.000003.mcap"]


def test_what_can_not_be_begun_is_said_first(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with pytest.raises(BatchError, match="no captures"):
        reconstruct_many([], out, calibration=calibration)
    with pytest.raises(BatchError, match=r"would both become run0\.zarr"):
        reconstruct_many([captures[0], tmp_path / "b" / "run0.npz"], out, calibration=calibration)
    with pytest.raises(BatchError, match="workers = 0"):
        reconstruct_many(captures, out, calibration=calibration, workers=0)
    with pytest.raises(BatchError, match="one of workers, scheduler"):
        reconstruct_many(captures, out, calibration=calibration, workers=1, scheduler="tcp://x:1")
    with pytest.raises(CalibrationError, match="there is no such folder"):
        reconstruct_many(captures, out, calibration=tmp_path / "none.zarr")
    (tmp_path / "file").write_text("")
    with pytest.raises(BatchError, match="can't make the folder"):
        reconstruct_many(captures, tmp_path / "file" / "x", calibration=calibration)


def test_progress_is_told_after_each(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    told: list[object] = []

    class Told:
        def start(self, task: str, total: float | None) -> None:
            told.append((task, total))

        def advance(self, steps: float = 1) -> None:
            told.append(steps)

        def finish(self) -> None:
            told.append("finished")

    reconstruct_many(
        captures,
        tmp_path / "out",
        calibration=calibration,
        executor=InThisProcess(),
        progress=Told(),
    )
    assert told == [("reconstructing", 5.0), 1, 1, 1, 1, 1, "finished"]


def test_no_scheduler_is_an_error_that_says_how_to_start_one(
    captures: list[Path], monkeypatch: pytest.MonkeyPatch, calibration: hf.Calibration,
    tmp_path: Path,
) -> None:  # fmt: skip
    monkeypatch.setattr("hueflight.batch.cluster.CONNECT_SECONDS", 0.3)
    with pytest.raises(BatchError, match=r"no Dask scheduler at 'tcp://127\.0\.0\.1:1'.*dask"):
        reconstruct_many(
            captures, tmp_path / "out", calibration=calibration, scheduler="tcp://127.0.0.1:1"
        )
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'hueflight\[batch\]'"):
        next(DaskCluster("x").run(_any_job(tmp_path), []))


def _any_job(folder: Path) -> Job:
    return Job(str(folder), "", str(folder), {}, "0")


def test_workers_use_one_thread_each() -> None:
    before = dict(os.environ)
    assert LocalWorkers(3).workers == 3
    assert dict(os.environ) == before


def test_a_store_that_no_batch_made_is_not_replaced(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    single = hf.reconstruct_file(captures[0], out / "run0.zarr", calibration=calibration)
    with pytest.raises(BatchError, match=r"run0\.zarr was made from another capture"):
        reconstruct_many(captures[:1], out, calibration=calibration, executor=InThisProcess())
    assert read_image(single.store).attrs["capture"] == "run0.npz"
    report = reconstruct_many(
        captures[:1], out, calibration=calibration, executor=InThisProcess(), overwrite=True
    )
    assert states(report) == ["done"]


def test_a_store_of_version_0_1_is_known_by_the_report_beside_it(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    """Stores did not say then which capture they were made from; batch.json did."""
    out = tmp_path / "out"
    reconstruct_many(captures[:1], out, calibration=calibration, executor=InThisProcess())
    attributes = json.loads((out / "run0.zarr" / ".zattrs").read_text())
    del attributes["capture_path"]
    (out / "run0.zarr" / ".zattrs").write_text(json.dumps(attributes))
    again = reconstruct_many(
        captures[:1], out, calibration=calibration, executor=InThisProcess(),
        options={"range_correction": True},
    )  # fmt: skip
    assert states(again) == ["done"]


def test_one_file_and_a_batch_give_the_same_image_and_summary(
    captures: list[Path], calibration: hf.Calibration, tmp_path: Path
) -> None:
    single = hf.reconstruct_file(captures[1], tmp_path / "one.zarr", calibration=calibration)
    many = reconstruct_many(
        captures[1:2], tmp_path / "out", calibration=calibration, executor=InThisProcess()
    )
    assert many.outcomes[0].summary == single.summary()
    assert single.summary()["depth_50_percent_m"] == pytest.approx(0.6, abs=0.02)
    stored = read_image(many.outcomes[0].store)
    for name in single.image.data_vars:
        np.testing.assert_array_equal(stored[name], single.image[name])
    assert stored.attrs["capture_losses"] == "none"
