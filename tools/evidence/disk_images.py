# SPDX-License-Identifier: Apache-2.0
"""What may be on a disk after a power cut: every mixture that the waits for the disk allow.

Only a finished wait (`Sync`) orders anything. What was written since may have reached the disk in
any order and in part: each sector holds what it held at the last wait or after any later write; the
file has the size that it had then or after any later write; each file has the name that it had when
the names of the folder were last waited for, or any later one, or none if it was made since. A
sector that was never written reads as zeros, or as noise.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass

from disk_log import Event, Rename, Sync, Write

SECTOR = 512
NOISE_SHARE = 0.1
"""Of sampled sectors that were never written, how many read as noise instead of zeros."""

Image = dict[str, bytes]


@dataclass(frozen=True)
class FileState:
    """What is possible for one file at a moment.

    Attributes
    ----------
    names : tuple of (str or None)
        Possible names, the oldest first; None if the file may be missing.
    settled : bytes
        Content that is on the disk for certain.
    sizes : tuple of int
        Possible sizes.
    sectors : tuple of tuple of bytes
        Possible contents of each sector that is not settled, from ``len(settled) // SECTOR`` on,
        the oldest first.
    """

    names: tuple[str | None, ...]
    settled: bytes
    sizes: tuple[int, ...]
    sectors: tuple[tuple[bytes, ...], ...]

    @property
    def count(self) -> int:
        """Number of combinations."""
        return math.prod(map(len, self.sectors)) * len(self.names) * len(self.sizes)


def file_states(events: list[Event], cut: int) -> list[FileState]:
    """Return what is possible for each file after the first `cut` events."""
    past = events[:cut]
    files = {event.file for event in past if isinstance(event, Rename)}
    return [_file_state(past, file) for file in sorted(files)]


def _file_state(past: list[Event], file: int) -> FileState:
    waited = _waited(past, file)
    named = _waited(past, None)
    names: list[str | None] = [None]
    for number, event in enumerate(past):
        if isinstance(event, Rename) and event.file == file:
            names = [event.name] if number < named else [*names, event.name]
    content = bytearray()
    settled = b""
    versions: list[bytes] = []
    for number, event in enumerate(past):
        if isinstance(event, Write) and event.file == file:
            if event.offset != len(content):
                raise AssertionError("a file that only grows was written in its middle")
            content += event.data
            if number < waited:
                settled = bytes(content)
            else:
                versions.append(bytes(content))
    first, stop = len(settled) // SECTOR, -(-len(content) // SECTOR)
    sectors = tuple(
        tuple(dict.fromkeys(_sector(version, at) for version in (settled, *versions)))
        for at in range(first, stop)
    )
    sizes = tuple(dict.fromkeys((len(settled), *map(len, versions))))
    return FileState(tuple(names), settled, sizes, sectors)


def _waited(past: list[Event], file: int | None) -> int:
    """Number of the event before which everything of a file, or all names, are on the disk."""
    return max((e.begun for e in past if isinstance(e, Sync) and e.file == file), default=0)


def _sector(content: bytes, at: int) -> bytes:
    return content[at * SECTOR : (at + 1) * SECTOR].ljust(SECTOR, b"\0")


def images(states: list[FileState], *, most: int, rng: random.Random) -> Iterator[Image]:
    """Yield all possible images, or a sample of `most` if there are more."""
    if math.prod(state.count for state in states) <= most:
        yield from _all_images(states)
        return
    for _ in range(most):
        yield _image(states, [_sampled(state, rng) for state in states])


Choice = tuple[str | None, int, tuple[bytes, ...]]


def _all_images(states: list[FileState]) -> Iterator[Image]:
    each = [
        list(itertools.product(state.names, state.sizes, itertools.product(*state.sectors)))
        for state in states
    ]
    for choices in itertools.product(*each):
        yield _image(states, list(choices))


def _sampled(state: FileState, rng: random.Random) -> Choice:
    """One combination; often nearly all or nearly none of the sectors have arrived."""
    newest = rng.choice((0.02, 0.5, 0.98))
    sectors = []
    for versions in state.sectors:
        content = versions[-1] if rng.random() < newest else rng.choice(versions)
        if not any(content) and rng.random() < NOISE_SHARE:
            content = rng.randbytes(SECTOR)
        sectors.append(content)
    return rng.choice(state.names), rng.choice(state.sizes), tuple(sectors)


def _image(states: list[FileState], choices: list[Choice]) -> Image:
    made = {}
    for state, (name, size, sectors) in zip(states, choices, strict=True):
        if name is not None:
            whole = len(state.settled) // SECTOR * SECTOR
            made[name] = (state.settled[:whole] + b"".join(sectors))[:size]
    return made
