# SPDX-License-Identifier: Apache-2.0
"""What a program does to the files of one folder, in order, as a disk would see it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any
from unittest import mock


@dataclass(frozen=True)
class Write:
    """Bytes that went into a file at an offset."""

    file: int
    offset: int
    data: bytes


@dataclass(frozen=True)
class Rename:
    """A name that a file has got; its first one if it was made."""

    file: int
    name: str


@dataclass(frozen=True)
class Sync:
    """The end of a wait for the disk, of a file or (None) of the names in the folder.

    What happened before the event number `begun` is on the disk from here on.
    """

    file: int | None
    begun: int


@dataclass(frozen=True)
class Claim:
    """What the program says is safe: the first `size` bytes of a file."""

    file: int
    size: int


Event = Write | Rename | Sync | Claim


@dataclass
class DiskLog:
    """Events in the folder `folder`, from all threads."""

    folder: Path
    events: list[Event] = field(default_factory=list)
    _files: dict[int, int] = field(default_factory=dict)  # descriptor → file
    _names: dict[str, int] = field(default_factory=dict)
    _sizes: dict[int, int] = field(default_factory=dict)
    _folders: set[int] = field(default_factory=set)
    _lock: Lock = field(default_factory=Lock)

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Record what this process does, until the end of the block."""
        with (
            mock.patch("os.open", self._opening(os.open)),
            mock.patch("os.writev", self._writing(os.writev)),
            mock.patch("os.fsync", self._syncing(os.fsync)),
            mock.patch("os.replace", self._renaming(os.replace)),
            mock.patch("os.close", self._closing(os.close)),
            mock.patch("os.ftruncate", self._refusing),
        ):
            yield

    def claim(self, path: Path, size: int) -> None:
        """Note that the program takes the first `size` bytes of a file for safe."""
        with self._lock:
            self.events.append(Claim(self._names[path.name], size))

    def content(self, file: int, cut: int) -> bytes:
        """Return what was written into a file before an event."""
        past = self.events[:cut]
        return b"".join(e.data for e in past if isinstance(e, Write) and e.file == file)

    def claimed(self, cut: int) -> list[bytes]:
        """Return what the program takes for safe at a moment, of each file."""
        sizes = {e.file: e.size for e in self.events[:cut] if isinstance(e, Claim)}
        return [self.content(file, cut)[:size] for file, size in sizes.items()]

    def _refusing(self, *_: object) -> None:
        raise AssertionError("files of a recording only grow as long as the disk does not fail")

    def _opening(self, plain: Any) -> Any:
        def opened(path: Any, flags: int, *rest: Any, **options: Any) -> int:
            with self._lock:
                fd = plain(path, flags, *rest, **options)
                if Path(path) == self.folder:
                    self._folders.add(fd)
                elif Path(path).parent == self.folder and flags & os.O_CREAT:
                    file = self._names[Path(path).name] = len(self._sizes)
                    self._files[fd], self._sizes[file] = file, 0
                    self.events.append(Rename(file, Path(path).name))
                return fd

        return opened

    def _writing(self, plain: Any) -> Any:
        def written(fd: int, parts: Sequence[memoryview]) -> int:
            with self._lock:
                size = plain(fd, parts)
                if fd in self._files:
                    file = self._files[fd]
                    data = b"".join(parts)[:size]
                    self.events.append(Write(file, self._sizes[file], data))
                    self._sizes[file] += size
                return size

        return written

    def _syncing(self, plain: Any) -> Any:
        def synced(fd: int) -> None:
            with self._lock:
                begun = len(self.events)
            plain(fd)
            with self._lock:
                if fd in self._files:
                    self.events.append(Sync(self._files[fd], begun))
                elif fd in self._folders:
                    self.events.append(Sync(None, begun))

        return synced

    def _renaming(self, plain: Any) -> Any:
        def renamed(before: Any, after: Any) -> None:
            with self._lock:
                plain(before, after)
                if Path(before).name in self._names:
                    file = self._names.pop(Path(before).name)
                    self._names[Path(after).name] = file
                    self.events.append(Rename(file, Path(after).name))

        return renamed

    def _closing(self, plain: Any) -> Any:
        def closed(fd: int) -> None:
            with self._lock:
                self._files.pop(fd, None)
                self._folders.discard(fd)
                plain(fd)

        return closed
