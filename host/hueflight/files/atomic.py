# SPDX-License-Identifier: Apache-2.0
"""Files and folders that appear under their name only when they are complete.

Everything is written into a hidden folder beside its target and renamed from there: a full
disk, an error or a killed process leaves what was there before, never an incomplete file.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hueflight.errors import OutputError, OutputExistsError
from hueflight.files.checksums import CHECKSUM_LIST
from hueflight.files.descriptors import sync_folder
from hueflight.memory import within_memory

FULL_DISK_BYTES = 1 << 20  #: a disk with less free space than this counts as full
DISCARD_TRIES = 100  #: one every 20 ms: two seconds in all
SURELY_GONE = 5  #: tries in a row that find no folder, after which no thread writes any more
RESERVE_BYTES = 1 << 17  #: of memory for the removal of what was written when there is no other
NOTHING_LEFT = "Nothing new was left under that name"
PARTIAL_SUFFIX = ".partial"  #: ends the names of folders that hold unfinished work


@contextmanager
def staged(target: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a path to write to, which becomes `target` when the block ends without an error.

    Files that the block writes beside the path (the data beside a header) are moved as well. The
    one named `target` is moved last, so that a reader that sees it finds all of them.

    Parameters
    ----------
    target : str or Path
        Final name of the file or folder.
    overwrite : bool
        Replace what exists under that name.

    Yields
    ------
    Path
        Where the block writes the file or makes the folder.

    Raises
    ------
    OutputExistsError
        If the target exists and may not be replaced.
    OutputError
        If the folder of the target is missing or the disk refuses; what was there before under
        the target's name is left as it was.
    MemoryLimitError
        If memory is exhausted; what was there before is left too.
    """
    target = Path(target)
    if not target.parent.is_dir():
        raise OutputError(f"can't write {str(target)!r}: there is no folder {str(target.parent)!r}")
    refuse_existing(target, overwrite=overwrite)
    # the name first: a folder whose name is not known any more could not be removed
    folder = target.parent / f".{target.name}.{secrets.token_hex(4)}{PARTIAL_SUFFIX}"
    reserve: list[bytearray] = []
    complete = False
    try:
        with within_memory(f"the writing of {str(target)!r}", advice=NOTHING_LEFT):
            reserve.append(bytearray(RESERVE_BYTES))
            folder.mkdir(0o700)
            yield folder / target.name
            written = sorted(folder.iterdir(), key=lambda path: path.name == target.name)
            for path in written:
                refuse_existing(target.parent / path.name, overwrite=overwrite)
                _sync(path)
            for path in written:
                _move(path, target.parent / path.name, aside=folder)
            _sync(target.parent, entries=False)
        complete = True
    except OutputError:
        raise  # it is an OSError too, but explained already
    except OSError as error:
        raise _explained(target, error) from error
    finally:
        reserve.clear()
        _discard(folder, at_once=complete)


def make_parent(target: str | Path) -> None:
    """Make the folder that a file is to be written to, with the folders above it.

    Parameters
    ----------
    target : str or Path
        Name of the file.

    Raises
    ------
    OutputError
        If the disk refuses, or a file is where a folder should be.
    """
    parent = Path(target).parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"can't make the folder {str(parent)!r}: {error.strerror or error}"
        ) from error


def replace_file(target: str | Path, content: str | bytes) -> None:
    """Write a file, replacing the one of that name only when the new one is complete.

    Parameters
    ----------
    target : str or Path
        Name of the file.
    content : str or bytes
        What the file is to hold; text is encoded as UTF-8, with line ends as they are.

    Raises
    ------
    OutputError
        If the folder of the file is missing or the disk refuses.
    """
    with staged(target, overwrite=True) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


def _discard(folder: Path, *, at_once: bool) -> None:
    """Remove a folder; unless `at_once`, a library's own threads may make it again meanwhile."""
    gone = 0
    for _ in range(DISCARD_TRIES):
        with suppress(MemoryError):
            shutil.rmtree(folder, ignore_errors=True)
            gone = 0 if folder.exists() else gone + 1
            if gone >= (1 if at_once else SURELY_GONE):
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
    OutputExistsError
        If there is one and it may not be replaced.
    """
    if not overwrite and target.exists():
        raise OutputExistsError(describe_existing(target))


def describe_existing(target: Path) -> str:
    """Give the message for a name that is taken, the same for every kind of output.

    Parameters
    ----------
    target : Path
        File or folder that exists.

    Returns
    -------
    str
        The message.
    """
    return (
        f"{str(target)!r} exists already: choose another name or allow overwriting "
        "(--overwrite, overwrite=True)"
    )


def _explained(target: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    advice = ""
    # some libraries report a short write without the system's reason
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    if full or (error.errno is None and shutil.disk_usage(target.parent).free < FULL_DISK_BYTES):
        advice = " (the disk is full: free some space or write elsewhere)"
    return OutputError(f"can't write {str(target)!r}: {reason}{advice}. {NOTHING_LEFT}")


def _sync(path: Path, *, entries: bool = True) -> None:
    """Wait until the disk holds it, so that the new name never precedes its content.

    Folders with checksums don't wait: should the power fail, these show the damage.
    """
    if (path / CHECKSUM_LIST).exists():
        return
    if path.is_dir() and entries:
        for entry in path.iterdir():
            _sync(entry)
    if path.is_dir():
        sync_folder(path)
        return
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
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
