# SPDX-License-Identifier: Apache-2.0
"""Captures from object stores and results into them: files, memory, and a server that speaks S3."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.batch import BatchReport, Job, Outcome, reconstruct_stored
from hueflight.batch.job import work
from hueflight.errors import BatchError
from hueflight.importers import read_image
from hueflight.importers.captures import read_capture, write_counts
from hueflight.recording import RecordingWriter
from hueflight_protocol import encode_frame

S3_PACKAGES = ("moto", "flask", "s3fs")
FRAMES = 60


class InThisProcess:
    """An executor without processes of its own."""

    def run(self, job: Job, captures: Sequence[str], /) -> Iterator[Outcome]:
        yield from (work(capture, job) for capture in captures)


@pytest.fixture
def s3() -> Iterator[tuple[str, dict[str, Any]]]:
    """Address of a bucket on a server of the test, and how to reach it."""
    for name in S3_PACKAGES:
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"other programs are not installed: {name}")
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    storage = {"key": "test", "secret": "test", "endpoint_url": f"http://{host}:{port}"}
    fsspec.filesystem("s3", **storage).mkdir("bucket")
    yield "s3://bucket", storage
    server.stop()


@pytest.fixture(params=["file", "memory", "s3"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, dict[str, Any]]:
    if request.param == "s3":
        return request.getfixturevalue("s3")
    if request.param == "file":
        return f"file://{tmp_path}/store", {}
    return f"memory://{tmp_path.name}", {}


@pytest.fixture
def stored(
    place: tuple[str, dict[str, Any]],
    camera: hf.Instrument,
    captures: list[Path],
    tmp_path: Path,
) -> list[str]:
    """Addresses of a recording of several segments and of two files of counts, in the store."""
    address, storage = place
    rng = np.random.default_rng(1)
    shape = (FRAMES, camera.sensor.rows, camera.sensor.cols)
    here = tmp_path / "here"
    with RecordingWriter(here / "film.mcap", camera, chunk_bytes=500, segment_bytes=8000) as writer:
        for at, codes in enumerate(rng.integers(0, 512, shape)):
            writer.write(encode_frame(codes, sequence=at, frame=at, timestamp=at))
    segments = sorted(here.iterdir())
    assert len(segments) > 2
    files, path = fsspec.core.url_to_fs(f"{address}/in", **storage)
    files.makedirs(path, exist_ok=True)
    for file in (*segments, *captures[:2]):
        files.put_file(str(file), f"{path}/{file.name}")
    return [f"{address}/in/{name}" for name in ("film.mcap", captures[0].name, captures[1].name)]


@pytest.fixture
def again(
    place: tuple[str, dict[str, Any]], stored: list[str], calibration: hf.Calibration
) -> Callable[..., BatchReport]:
    address, storage = place

    def run(**how: Any) -> BatchReport:
        how = {"executor": InThisProcess(), "at_once": 2, "storage": storage} | how
        return reconstruct_stored(stored, f"{address}/out", calibration=calibration, **how)

    return run


def states(report: BatchReport) -> list[str]:
    return [outcome.state for outcome in report.outcomes]


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_results_are_those_of_local_files(
    place: tuple[str, dict[str, Any]],
    stored: list[str],
    again: Callable[..., BatchReport],
    captures: list[Path],
    calibration: hf.Calibration,
    camera: hf.Instrument,
    tmp_path: Path,
) -> None:
    address, storage = place
    report = again()
    assert states(report) == ["done"] * 3
    assert [o.capture for o in report.outcomes] == stored
    with hf.open_recording(tmp_path / "here" / "film.mcap") as recording:
        wanted = [recording.histogram(), *(read_capture(path).counts for path in captures[:2])]
    files, path = fsspec.core.url_to_fs(address, **storage)
    for outcome, counts in zip(report.outcomes, wanted, strict=True):
        name = outcome.store.rpartition("/")[2]
        files.get(f"{path}/out/{name}", str(tmp_path / name), recursive=True)
        image = read_image(tmp_path / name)
        np.testing.assert_array_equal(image["depth"], hf.reconstruct(counts, calibration)["depth"])
    assert states(again()) == ["kept"] * 3
    assert states(again(options={"method": "paper"})) == ["done"] * 3
    write_counts(tmp_path / "other.npz", wanted[2], camera)
    files.put_file(str(tmp_path / "other.npz"), f"{path}/in/{captures[0].name}")
    assert states(again(options={"method": "paper"})) == ["kept", "done", "kept"]


def test_failures_are_told_and_unfinished_results_made_again(
    tmp_path: Path, captures: list[Path], calibration: hf.Calibration
) -> None:
    address = f"memory://{tmp_path.name}"
    files = fsspec.filesystem("memory")
    names = [str(captures[0]), str(tmp_path / "missing.npz"), f"{address}/no/folder.mcap"]

    def run() -> BatchReport:
        executor = InThisProcess()
        return reconstruct_stored(names, address, calibration=calibration, executor=executor)

    report = run()
    assert states(report) == ["done", "failed", "failed"]
    for outcome, name in zip(report.failed, ("missing.npz", "folder.mcap"), strict=True):
        assert name in str(outcome.error)
    files.rm_file(f"/{tmp_path.name}/run0.zarr.complete.json")  # as if it had been cut off
    assert states(run()) == ["done", "failed", "failed"]
    assert states(run()) == ["kept", "failed", "failed"]


def test_what_can_not_be_begun_is_said_first(calibration: hf.Calibration) -> None:
    def run(*captures: str, **how: Any) -> None:
        reconstruct_stored(captures, "memory://out", calibration=calibration, **how)

    with pytest.raises(BatchError, match="no captures"):
        run()
    with pytest.raises(BatchError, match="at_once = 0"):
        run("memory://a.npz", at_once=0)
    with pytest.raises(BatchError, match="would have results of the same name"):
        run("memory://a/run.npz", "memory://b/run.npz")
    with pytest.raises(BatchError, match="nosuch"):
        run("nosuch://a/run.npz")
