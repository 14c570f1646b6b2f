# SPDX-License-Identifier: Apache-2.0
"""Captures in object stores and results into them, through fsspec: S3, memory, a web server, …"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from hueflight.batch.batch import BatchReport, reconstruct_many
from hueflight.batch.job import Outcome
from hueflight.calibration import Calibration
from hueflight.errors import BatchError
from hueflight.export.description import calibration_origin
from hueflight.files import import_optional
from hueflight.recording.layout import split_segment_path

AT_ONCE = 32
MARKER = ".complete.json"
"""Ends the name of the object that is written when all of a result is there."""


def reconstruct_stored(
    captures: Iterable[str],
    out: str,
    /,
    *,
    calibration: Calibration | str | Path,
    options: Mapping[str, Any] | None = None,
    at_once: int = AT_ONCE,
    folder: str | Path | None = None,
    storage: Mapping[str, Any] | None = None,
    **how: Any,
) -> BatchReport:
    """Reconstruct captures from an object store, each into a Zarr store in an object store.

    Captures are copied into a local folder, some at a time, reconstructed by `reconstruct_many`,
    and their results copied to the object store. Last an object ``NAME.zarr.complete.json`` is
    written. A capture that has one is not even fetched, unless the capture, the calibration, the
    options or the software have changed.

    Parameters
    ----------
    captures : iterable of str
        Addresses such as ``s3://bucket/run.mcap``; paths of local files are allowed too. The
        segments of a recording are found beside its first one.
    out : str
        Address under which the results are written.
    calibration : Calibration, str or Path
        Calibration of the same instrument, or the path of its local store.
    options : mapping, optional
        Keywords of `reconstruct`.
    at_once : int
        Captures that are fetched before they are reconstructed; the local folder has room for them.
    folder : str or Path, optional
        Folder for the copies, by default a temporary one. Workers of a cluster must see it.
    storage : mapping, optional
        Options of the file system, such as ``{"endpoint_url": ...}``.
    **how
        Further keywords of `reconstruct_many`: ``workers``, ``scheduler``, ``executor``, ...

    Returns
    -------
    BatchReport
        The outcome of each capture, with addresses in the place of paths.

    Raises
    ------
    BatchError
        If `at_once` is below 1, two captures would have the same result, or as `reconstruct_many`
        does.
    MissingPackageError
        If fsspec, or the package for a kind of address, is not installed.
    """
    if at_once < 1:
        raise BatchError(f"at_once = {at_once}: must be at least 1")
    if not isinstance(calibration, Calibration):
        calibration = Calibration.load(calibration)
    waiting = list(dict.fromkeys(captures))
    _refuse_same_results(waiting)
    parts = [calibration_origin(calibration)["digest"], dict(options or {}), version("hueflight")]
    store = _Store(out, storage or {}, parts)
    outcomes: dict[str, Outcome] = {}
    for some in _batches(waiting, at_once):
        keys = {capture: store.key(capture) for capture in some}
        due = [capture for capture in some if not store.has(capture, keys[capture])]
        for capture in set(some) - set(due):
            outcomes[capture] = Outcome(capture, store.result(capture), "kept")
        if not due:
            continue
        with tempfile.TemporaryDirectory(dir=folder) as name:
            here = Path(name).absolute()
            copies = {store.fetch(capture, here / "captures"): capture for capture in due}
            report = reconstruct_many(
                copies, here / "results", calibration=calibration, options=options, **how
            )
            for outcome in report.outcomes:
                capture = copies[Path(outcome.capture)]
                if outcome.state != "failed":
                    store.send(Path(outcome.store), capture, keys[capture])
                outcomes[capture] = replace(outcome, capture=capture, store=store.result(capture))
    return BatchReport(tuple(outcomes[capture] for capture in waiting))


def _batches(captures: Sequence[str], size: int) -> Iterator[list[str]]:
    rest = iter(captures)
    while some := list(islice(rest, size)):
        yield some


def _refuse_same_results(captures: Sequence[str]) -> None:
    if not captures:
        raise BatchError("no captures: name at least one recording")
    names: dict[str, str] = {}
    for capture in captures:
        other = names.setdefault(PurePosixPath(capture).stem, capture)
        if other != capture:
            raise BatchError(
                f"{other} and {capture} would have results of the same name: rename one or use "
                "two places for the results"
            )


class _Store:
    """Where captures come from and results go."""

    def __init__(self, out: str, storage: Mapping[str, Any], parts: list[Any]) -> None:
        self._fsspec = import_optional("fsspec", extra="objects")
        self._out, self._storage, self._parts = out.rstrip("/"), storage, parts

    def result(self, capture: str) -> str:
        """Address of the image of a capture."""
        return f"{self._out}/{PurePosixPath(capture).stem}.zarr"

    def _at(self, address: str) -> tuple[Any, str]:
        """File system and path of an address."""
        kind = address.partition("://")[0] if "://" in address else "file"
        try:
            self._fsspec.get_filesystem_class(kind)
        except (ImportError, ValueError) as error:
            raise BatchError(f"{address}: {error}") from None
        own = self._storage if kind not in ("file", "memory") else {}
        return self._fsspec.core.url_to_fs(address, **own)

    def _files(self, capture: str) -> list[str]:
        """Paths of the segments of a recording, or of the file itself."""
        files, path = self._at(capture)
        if not path.endswith(".mcap"):
            return [path]
        try:
            beside = files.ls(files._parent(path), detail=False)
        except FileNotFoundError:  # what is missing is said of the capture, beside the others
            return [path]
        return [each for each in sorted(beside) if _first_segment(each) == path] or [path]

    def key(self, capture: str) -> str:
        """Digest of what a result depends on; of objects, what the store says of them."""
        files, _ = self._at(capture)
        try:
            said = [(path, str(files.checksum(path))) for path in self._files(capture)]
        except FileNotFoundError:
            said = []
        described = json.dumps([said, *self._parts], sort_keys=True, default=repr)
        return hashlib.sha256(described.encode()).hexdigest()[:32]

    def has(self, capture: str, key: str) -> bool:
        """Whether a result with this key is complete."""
        files, path = self._at(self.result(capture) + MARKER)
        try:
            return json.loads(files.cat_file(path)) == {"key": key}
        except (FileNotFoundError, ValueError):
            return False

    def fetch(self, capture: str, folder: Path) -> Path:
        """Copy a capture; if there is none, the reader of its copy will say so."""
        files, _ = self._at(capture)
        folder.mkdir(parents=True, exist_ok=True)
        for path in self._files(capture):
            if files.exists(path):
                files.get_file(path, str(folder / PurePosixPath(path).name))
        return folder / PurePosixPath(capture).name

    def send(self, store: Path, capture: str, key: str) -> None:
        """Copy a result, and say last that it is complete."""
        files, path = self._at(self.result(capture))
        if files.exists(path + MARKER):
            files.rm_file(path + MARKER)
        if files.exists(path):
            files.rm(path, recursive=True)
        for each in sorted(store.rglob("*")):
            if each.is_file():
                target = f"{path}/{each.relative_to(store).as_posix()}"
                files.makedirs(files._parent(target), exist_ok=True)
                files.put_file(str(each), target)
        files.pipe_file(path + MARKER, json.dumps({"key": key}).encode())


def _first_segment(path: str) -> str:
    first, _ = split_segment_path(Path(path))
    return first.as_posix()
