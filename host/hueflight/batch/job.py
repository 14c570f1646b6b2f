# SPDX-License-Identifier: Apache-2.0
"""What is done to one capture of a batch: nothing if its image is there already."""

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

from hueflight.batch.one_file import reconstruct_file
from hueflight.calibration import Calibration
from hueflight.errors import FileFormatError, HueflightError
from hueflight.export.description import calibration_origin
from hueflight.files import PARTIAL_SUFFIX, verify_checksums
from hueflight.importers.options import ReadOptions
from hueflight.recording.layout import segment_files

KEY = "task"  #: attribute of a store: digest of what it was made from, and how
CAPTURE_PATH = "capture_path"  #: attribute of a store: absolute path of its capture


@dataclass(frozen=True)
class Job:
    """What is done to every capture of a batch; small, so that it travels to any worker.

    Attributes
    ----------
    calibration : str
        Path of the calibration, which every worker can read.
    calibration_digest : str
        Digest of the calibration's content; a worker must find the same.
    out : str
        Folder for the results, which every worker can write.
    options : mapping of str to Any
        Keywords of `reconstruct`.
    software : str
        Version of the software that makes the results.
    reading : ReadOptions
        What to take from files of counts.
    """

    calibration: str
    calibration_digest: str
    out: str
    options: Mapping[str, Any]
    software: str
    reading: ReadOptions = field(default_factory=ReadOptions)

    def store(self, capture: str) -> Path:
        """Path of the image of a capture.

        Parameters
        ----------
        capture : str
            Path of the capture.

        Returns
        -------
        Path
            A Zarr store in the folder for the results.
        """
        return Path(self.out) / f"{Path(capture).stem}.zarr"

    def key(self, capture: str) -> str:
        """Digest of everything that the image of a capture depends on.

        Parameters
        ----------
        capture : str
            Path of the capture.

        Returns
        -------
        str
            Equal as long as capture, calibration, options and software are.
        """
        files = [
            (file.name, file.stat().st_size, file.stat().st_mtime_ns)
            for file in capture_files(Path(capture))
        ]
        # the number of threads changes no result
        options = {name: value for name, value in self.options.items() if name != "threads"}
        # named even where it is the default, because that has changed since version 0.1.0
        options.setdefault("range_correction", None)
        parts = [files, self.calibration_digest, options, self.software]
        if self.reading != ReadOptions():
            parts.append(asdict(self.reading))
        described = json.dumps(parts, sort_keys=True, default=repr)
        return hashlib.sha256(described.encode()).hexdigest()[:32]


@dataclass(frozen=True)
class Outcome:
    """Result of one capture of a batch.

    Attributes
    ----------
    capture : str
        Path of the capture.
    store : str
        Path of its image.
    state : str
        ``"done"`` if it was reconstructed now, ``"kept"`` if an earlier run had done it, or
        ``"failed"``.
    error : str or None
        Why it failed.
    seconds : float
        Duration of the work, s.
    worker : str
        Which worker did it.
    peak_memory_bytes : int
        Most memory that this worker has held so far.
    attempts : int
        How often the capture was begun: more than once if a worker died on it.
    summary : mapping of str to Any
        Summary of the image, as `FileResult.summary` gives, if it was reconstructed now.
    """

    capture: str
    store: str
    state: Literal["done", "kept", "failed"]
    error: str | None = None
    seconds: float = 0.0
    worker: str = ""
    peak_memory_bytes: int = 0
    attempts: int = field(default=1, compare=False)
    summary: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON.

        Returns
        -------
        dict
            All attributes by name.
        """
        return asdict(self)


def work(capture: str, job: Job) -> Outcome:
    """Reconstruct one capture unless that was done already.

    Parameters
    ----------
    capture : str
        Path of the capture.
    job : Job
        What to do.

    Returns
    -------
    Outcome
        The result; an error is reported in it and never raised.
    """
    start = time.perf_counter()
    store = job.store(capture)
    state: Literal["done", "kept", "failed"] = "failed"
    error = None
    summary: Mapping[str, Any] = {}
    try:
        key = job.key(capture)
        if is_done(store, key):
            state = "kept"
        else:
            sweep(store)
            result = reconstruct_file(
                capture,
                store,
                calibration=_calibration(job.calibration, job.calibration_digest),
                options=job.options,
                reading=job.reading,
                overwrite=True,
                attributes={KEY: key, CAPTURE_PATH: str(Path(capture).absolute())},
            )
            summary = result.summary()
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
        summary=summary,
    )


def is_done(store: Path, key: str) -> bool:
    """Tell whether a store with a key is there and intact.

    Parameters
    ----------
    store : Path
        The store.
    key : str
        As `Job.key` gives.

    Returns
    -------
    bool
        False also for a damaged store, so that it is made again.
    """
    if key_of(store) != key:
        return False
    try:
        verify_checksums(store)
    except (OSError, FileFormatError):
        return False
    return True


def key_of(store: Path) -> str | None:
    """Key of a store that a batch made.

    Parameters
    ----------
    store : Path
        A Zarr store.

    Returns
    -------
    str or None
        As `Job.key` gives, or None if no batch made the store.
    """
    return _attributes(store).get(KEY)


def capture_of(store: Path) -> str | None:
    """Path of the capture that a store was made from.

    Parameters
    ----------
    store : Path
        A Zarr store.

    Returns
    -------
    str or None
        Absolute path, or None if the store does not say: no batch made it, or one of version 0.1.
    """
    return _attributes(store).get(CAPTURE_PATH)


def _attributes(store: Path) -> dict[str, Any]:
    """Attributes of a store; empty if it has none that can be read."""
    try:
        attributes = json.loads((store / ".zattrs").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return attributes if isinstance(attributes, dict) else {}


def capture_files(capture: Path) -> list[Path]:
    """All files of a capture.

    Parameters
    ----------
    capture : Path
        Path of a recording's first file, of a store or of a file.

    Returns
    -------
    list of Path
        The segments of a recording, the parts of a store, or the file itself.
    """
    if capture.suffix.lower() == ".mcap":
        finished, _ = segment_files(capture)
        return finished or [capture]
    if capture.is_dir():
        return sorted(path for path in capture.rglob("*") if path.is_file())
    return [capture]


def sweep(store: Path) -> None:
    """Remove what a killed worker left of a store.

    Parameters
    ----------
    store : Path
        The store that it was writing.
    """
    for partial in store.parent.glob(f".{store.name}.*{PARTIAL_SUFFIX}"):
        shutil.rmtree(partial, ignore_errors=True)


def peak_memory_bytes() -> int:
    """Most memory that this process has held.

    Returns
    -------
    int
        Bytes; 0 where the system does not say.
    """
    try:
        import resource
    except ImportError:  # not on Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


@lru_cache(maxsize=1)
def _calibration(path: str, digest: str) -> Calibration:
    """Calibration, read once per worker; one that has changed has another `digest`."""
    calibration = Calibration.load(path)
    if calibration_origin(calibration)["digest"] != digest:
        raise HueflightError(
            f"calibration {path} has changed since this batch was started: start it again"
        )
    return calibration
