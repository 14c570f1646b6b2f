"""Files that appear under their name only when they are whole.

Everything is written into a hidden folder beside its target and renamed from there: a full
disk, an error or a killed process leaves what was there before and nothing half-done.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from hueflight.errors import ExportError
from hueflight.files.checksums import SEAL

LITTLE_BYTES = 1 << 20  #: a disk with less room than this counts as full
DISCARD_TRIES = 50  #: a second in all
PARTIAL_SUFFIX = ".partial"  #: ends the names of folders that hold unfinished work


@contextmanager
def staged(target: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A path to write a file or a folder to, that becomes `target` when the block ends well.

    Files that the block writes beside it (the data beside a header) come along; the one named
    `target` comes last, so that whoever sees it finds all of it.

    Raises
    ------
    ExportError
        If the target exists and may not be replaced, its folder is missing, or the disk did
        not take it; nothing is left under the target's name then but what was there before.
    """
    target = Path(target)
    if not target.parent.is_dir():
        raise ExportError(f"can't write {str(target)!r}: there is no folder {str(target.parent)!r}")
    refuse_existing(target, overwrite=overwrite)
    try:
        folder = Path(
            tempfile.mkdtemp(
                prefix=f".{target.name}.", suffix=PARTIAL_SUFFIX, dir=target.parent or "."
            )
        )
    except OSError as error:
        raise _explained(target, error) from error
    try:
        yield folder / target.name
        written = sorted(folder.iterdir(), key=lambda path: path.name == target.name)
        for path in written:
            refuse_existing(target.parent / path.name, overwrite=overwrite)
            _sync(path)
        for path in written:
            _move(path, target.parent / path.name, aside=folder)
        _sync(target.parent, entries=False)
    except OSError as error:
        raise _explained(target, error) from error
    finally:
        _discard(folder)


def optional(module: str, *, extra: str = "export") -> Any:
    """A module that only some formats need.

    Raises
    ------
    ExportError
        If it is not installed, naming the extra that brings it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise ExportError(
            f"this needs the package {package!r}: pip install 'hueflight[{extra}]' ({error})"
        ) from None


def _discard(folder: Path) -> None:
    """Remove a folder, though a library's own threads may still be writing into it."""
    for _ in range(DISCARD_TRIES):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return
        time.sleep(0.02)


def refuse_existing(target: Path, *, overwrite: bool = False) -> None:
    """Check that a name is free before work on what it is for begins.

    Parameters
    ----------
    target : Path
        File or folder to be written.
    overwrite : bool, default False
        Whether an existing one may be replaced.

    Raises
    ------
    ExportError
        If there is one and it may not be replaced.
    """
    if not overwrite and target.exists():
        raise ExportError(
            f"{str(target)!r} exists already: choose another name or allow overwriting "
            "(--overwrite, overwrite=True)"
        )


def _explained(target: Path, error: OSError) -> ExportError:
    reason = error.strerror or str(error)
    advice = ""
    # some libraries report a short write without the system's reason
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    if full or (error.errno is None and shutil.disk_usage(target.parent).free < LITTLE_BYTES):
        advice = " (the disk is full: make room or write elsewhere)"
    return ExportError(
        f"can't write {str(target)!r}: {reason}{advice}. Nothing new was left under that name"
    )


def _sync(path: Path, *, entries: bool = True) -> None:
    """Wait until the disk has it, so that a rename never overtakes its content.

    Sealed folders don't wait: should the power fail, their checksums tell.
    """
    if (path / SEAL).exists():
        return
    if path.is_dir() and entries:
        for entry in path.iterdir():
            _sync(entry)
    if os.name == "nt" and path.is_dir():
        return  # folders can't be opened there
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _move(source: Path, target: Path, *, aside: Path) -> None:
    """Rename; a folder in the way is first moved aside and comes back if that fails."""
    if not target.is_dir():
        source.replace(target)
        return
    old = aside / f"{target.name}.replaced"
    target.rename(old)
    try:
        source.rename(target)
    except OSError:
        old.rename(target)
        raise
