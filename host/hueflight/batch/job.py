"""What is done to one capture: read, reconstruct, write a store; kept where it is done already."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from hueflight.calibration import Calibration
from hueflight.errors import FileFormatError, HueflightError
from hueflight.export.description import calibration_origin, describe
from hueflight.export.stores import write_zarr
from hueflight.files.atomic import PARTIAL_SUFFIX
from hueflight.files.checksums import check_seal
from hueflight.importers.captures import read_capture
from hueflight.reconstruction.reconstruct import reconstruct
from hueflight.recording.layout import segment_files

KEY = "task"  #: attribute of a store: what it was made from, and how


@dataclass(frozen=True)
class Job:
    """What is done to every capture of a batch; small, so that it travels to any worker.

    Attributes
    ----------
    calibration : path of the calibration, which every worker can read.
    calibration_digest : of its content; a worker must find the same.
    out : folder for the results, which every worker can write.
    options : keywords of `reconstruct`.
    software : version that makes the results.
    """

    calibration: str
    calibration_digest: str
    out: str
    options: Mapping[str, Any]
    software: str

    def store(self, capture: str) -> Path:
        """Where the capture's image goes."""
        return Path(self.out) / f"{Path(capture).stem}.zarr"

    def key(self, capture: str) -> str:
        """Digest of everything that the capture's image depends on."""
        files = [
            (file.name, file.stat().st_size, file.stat().st_mtime_ns)
            for file in capture_files(Path(capture))
        ]
        described = json.dumps(
            [files, self.calibration_digest, dict(self.options), self.software],
            sort_keys=True,
            default=repr,
        )
        return hashlib.sha256(described.encode()).hexdigest()[:32]


@dataclass(frozen=True)
class Outcome:
    """What became of one capture.

    Attributes
    ----------
    capture, store : paths.
    state : ``"done"`` now, ``"kept"`` from an earlier run, or ``"failed"``.
    error : why it failed.
    seconds : that it took.
    worker : who did it; peak_memory_bytes : the most that worker has held so far.
    attempts : how often it was begun; more than 1 where a worker died on it.
    """

    capture: str
    store: str
    state: Literal["done", "kept", "failed"]
    error: str | None = None
    seconds: float = 0.0
    worker: str = ""
    peak_memory_bytes: int = 0
    attempts: int = field(default=1, compare=False)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def work(capture: str, job: Job) -> Outcome:
    """Do one capture; what goes wrong with it is told, never raised."""
    start = time.perf_counter()
    store = job.store(capture)
    state: Literal["done", "kept", "failed"] = "failed"
    error = None
    try:
        key = job.key(capture)
        if is_done(store, key):
            state = "kept"
        else:
            _reconstruct(Path(capture), store, key, job)
            state = "done"
    except HueflightError as failure:
        error = str(failure)
    except Exception as failure:  # one bad capture must not end the others
        error = f"{type(failure).__name__}: {failure}"
    return Outcome(
        capture=capture,
        store=str(store),
        state=state,
        error=error,
        seconds=time.perf_counter() - start,
        worker=str(os.getpid()),
        peak_memory_bytes=peak_memory_bytes(),
    )


def is_done(store: Path, key: str) -> bool:
    """Whether a whole store of that key is there; a damaged one is not done."""
    try:
        attributes = json.loads((store / ".zattrs").read_text(encoding="utf-8"))
        if attributes.get(KEY) != key:
            return False
        check_seal(store)
    except (OSError, ValueError, FileFormatError):
        return False
    return True


def capture_files(capture: Path) -> list[Path]:
    """All files of a capture: the segments of a recording, the parts of a store."""
    if capture.suffix == ".mcap":
        finished, _ = segment_files(capture)
        return finished or [capture]
    if capture.is_dir():
        return sorted(path for path in capture.rglob("*") if path.is_file())
    return [capture]


def sweep(store: Path) -> None:
    """Remove what a killed worker left of this store."""
    for partial in store.parent.glob(f".{store.name}.*{PARTIAL_SUFFIX}"):
        shutil.rmtree(partial, ignore_errors=True)


def peak_memory_bytes() -> int:
    """The most memory that this process has held, 0 where the system doesn't say."""
    try:
        import resource
    except ImportError:  # not on Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _reconstruct(capture: Path, store: Path, key: str, job: Job) -> None:
    calibration = _calibration(job.calibration, job.calibration_digest)
    taken = read_capture(capture, calibration.instrument)
    image = reconstruct(taken.counts, calibration, **job.options)
    described = describe(image, calibration, **{"capture": capture.name, KEY: key})
    sweep(store)
    write_zarr(described, store, overwrite=True)


@lru_cache(maxsize=1)
def _calibration(path: str, digest: str) -> Calibration:
    """The calibration, read once per worker; `digest` makes a changed one be read again."""
    calibration = Calibration.load(path)
    if calibration_origin(calibration)["digest"] != digest:
        raise HueflightError(
            f"calibration {path} is not the one that this batch was begun with: start again"
        )
    return calibration
