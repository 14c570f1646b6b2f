# SPDX-License-Identifier: Apache-2.0
"""Many captures into a folder of images: one task each, resumable, failures isolated."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from hueflight.arguments import PATH, SWITCH, TEXT, WHOLE, Kind, takes
from hueflight.batch.cluster import DaskCluster
from hueflight.batch.job import Job, Outcome, capture_of, key_of, sweep
from hueflight.batch.local import LocalWorkers
from hueflight.batch.one_file import CALIBRATION_OR_PATH
from hueflight.calibration import Calibration
from hueflight.errors import BatchError
from hueflight.export.description import calibration_origin
from hueflight.files import staged
from hueflight.importers.options import ReadOptions
from hueflight.progress import Progress, Silent, tracked
from hueflight.recording.layout import split_segment_path

CALIBRATION = "calibration.zarr"  #: name of a calibration given as an object, among the results
REPORT = "batch.json"  #: name of the outcomes of all captures
LOCK = ".batch.lock"


class Executor(Protocol):
    """Where work is done: `LocalWorkers`, `DaskCluster`, or an own implementation."""

    def run(self, job: Job, captures: Sequence[str], /) -> Iterator[Outcome]:
        """Do a job for all captures.

        Parameters
        ----------
        job : Job
            What is done to each capture, by `hueflight.batch.job.work`.
        captures : sequence of str
            Absolute paths of the captures.

        Yields
        ------
        Outcome
            One for each capture, in any order.
        """
        ...


@dataclass(frozen=True)
class BatchReport:
    """Outcomes of a batch.

    Attributes
    ----------
    outcomes : tuple of Outcome
        One for each capture, in the order in which they were given.
    """

    outcomes: tuple[Outcome, ...]

    @property
    def failed(self) -> tuple[Outcome, ...]:
        """Outcomes of the captures that could not be reconstructed."""
        return tuple(outcome for outcome in self.outcomes if outcome.state == "failed")

    @property
    def peak_memory_bytes(self) -> int:
        """Most memory that any one worker held."""
        return max((outcome.peak_memory_bytes for outcome in self.outcomes), default=0)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON.

        Returns
        -------
        dict
            Numbers of captures that are ``done``, ``kept`` and ``failed``,
            ``peak_memory_bytes``, and all ``outcomes``.
        """
        counts = Counter(outcome.state for outcome in self.outcomes)
        return {
            "done": counts["done"],
            "kept": counts["kept"],
            "failed": counts["failed"],
            "peak_memory_bytes": self.peak_memory_bytes,
            "outcomes": [outcome.to_dict() for outcome in self.outcomes],
        }


#: what `captures` may be
CAPTURES = Kind(
    "a list of paths",
    lambda value: isinstance(value, Iterable) and not isinstance(value, str | bytes),
)


@takes(
    captures=CAPTURES,
    out=PATH,
    calibration=CALIBRATION_OR_PATH,
    workers=WHOLE,
    scheduler=TEXT,
    options=Mapping,
    overwrite=SWITCH,
)
def reconstruct_many(
    captures: Iterable[str | Path],
    out: str | Path,
    /,
    *,
    calibration: Calibration | str | Path,
    workers: int | None = None,
    scheduler: str | None = None,
    executor: Executor | None = None,
    options: Mapping[str, Any] | None = None,
    reading: ReadOptions | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BatchReport:
    """Reconstruct many captures, each into a Zarr store ``OUT/NAME.zarr``.

    What an earlier run has done is not done again, unless capture, calibration, options or
    software have changed since. Captures that fail are listed in the result and in
    ``OUT/batch.json``; they do not stop the others.

    Parameters
    ----------
    captures : iterable of str or Path
        Recordings (``.mcap``) or counts (``.npz``, ``.npy``, ``.h5``, …).
    out : str or Path
        Folder for the results; it is made if it does not exist.
    calibration : Calibration, str or Path
        Calibration of the same instrument; an object is kept as ``OUT/calibration.zarr``.
    workers : int, optional
        Number of local processes; by default one for each processor core.
    scheduler : str, optional
        Address of a Dask scheduler, instead of local processes.
    executor : Executor, optional
        Anything else that does the work, instead of either.
    options : mapping, optional
        Keywords of `reconstruct`, such as ``{"method": "joint"}``.
    reading : ReadOptions, optional
        What to take from files of counts; it applies to every capture.
    overwrite : bool, default False
        Whether to replace stores of the same name that were made from other captures.
    progress : Progress, optional
        Told after each capture.

    Returns
    -------
    BatchReport
        The outcome of each capture.

    Raises
    ------
    BatchError
        If there are no captures, two would have the same result, a store of that name was made
        from another capture, the folder is in use by another batch, or there is no worker.
    CalibrationError
        If the calibration can't be read.

    Notes
    -----
    A script that calls this needs ``if __name__ == "__main__":`` around the call, as all that
    start processes do.
    """
    chosen = _whole_captures([Path(capture) for capture in captures])
    if sum(option is not None for option in (workers, scheduler, executor)) > 1:
        raise BatchError("give one of workers, scheduler and executor")
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BatchError(f"can't make the folder {str(out)!r}: {error.strerror}") from error
    if executor is None:
        local = LocalWorkers(workers if workers is not None else os.cpu_count() or 1)
        executor = local if scheduler is None else DaskCluster(scheduler)
    with _sole_user(out):
        job = _job(calibration, out, options or {}, reading or ReadOptions())
        if not overwrite:
            _refuse_other_captures(job, chosen, _earlier_captures(out))
        for capture in chosen:
            sweep(job.store(capture))
        running = executor.run(job, chosen)
        outcomes = {
            outcome.capture: outcome
            for outcome in tracked(
                running, progress or Silent(), "reconstructing", float(len(chosen))
            )
        }
        report = BatchReport(tuple(outcomes[capture] for capture in chosen))
        with staged(out / REPORT, overwrite=True) as partial:
            partial.write_text(json.dumps(report.to_dict(), indent=2), encoding="utf-8")
    return report


def _earlier_captures(out: Path) -> dict[str, str]:
    """Captures of the earlier batch in this folder by the name of their store."""
    try:
        report = json.loads((out / REPORT).read_text(encoding="utf-8"))
        return {Path(each["store"]).name: each["capture"] for each in report["outcomes"]}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _refuse_other_captures(job: Job, captures: Sequence[str], earlier: Mapping[str, str]) -> None:
    """Refuse to replace stores that were made from other captures of the same name."""
    for capture in captures:
        store = job.store(capture)
        if not store.exists():
            continue
        made_from = capture_of(store) or earlier.get(store.name)
        if made_from == capture:
            continue
        try:
            key = job.key(capture)
        except OSError:  # there is no such capture: it fails and replaces nothing
            continue
        if key_of(store) != key:
            raise BatchError(
                f"{store} was made from {made_from or 'another capture'}, not from {capture}: use "
                "another folder for the results, or allow overwriting (--overwrite, "
                "overwrite=True)"
            )


def _whole_captures(paths: list[Path]) -> list[str]:
    """Absolute paths of the captures; later segments of a recording belong to its first."""
    given = {path.absolute() for path in paths}
    chosen: dict[str, str] = {}
    for path in dict.fromkeys(path.absolute() for path in paths):
        first, number = split_segment_path(path)
        if number and first in given:
            continue
        if path.stem in chosen:
            raise BatchError(
                f"{chosen[path.stem]} and {path} would both become {path.stem}.zarr: rename one "
                "or use two folders for the results"
            )
        chosen[path.stem] = str(path)
    if not chosen:
        raise BatchError("no captures: name at least one recording")
    return list(chosen.values())


def _job(
    calibration: Calibration | str | Path,
    out: Path,
    options: Mapping[str, Any],
    reading: ReadOptions,
) -> Job:
    if isinstance(calibration, Calibration):
        path = out / CALIBRATION
        calibration.save(path, overwrite=True)
    else:
        path = Path(calibration)
        calibration = Calibration.load(path)
    return Job(
        calibration=str(path.absolute()),
        calibration_digest=calibration_origin(calibration)["digest"],
        out=str(out.absolute()),
        options=dict(options),
        software=version("hueflight"),
        reading=reading,
    )


@contextmanager
def _sole_user(out: Path) -> Iterator[None]:
    """Keep other batches out of the folder; the lock goes with the process that holds it."""
    try:
        import fcntl
    except ImportError:  # no such locks on Windows: there one has to take care
        yield
        return
    with (out / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BatchError(
                f"another batch is writing to {str(out)!r}: wait for it or use another folder"
            ) from None
        yield
