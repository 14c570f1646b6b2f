# SPDX-License-Identifier: Apache-2.0
"""Power cuts with reordered and torn writes: what a wait for the disk covered is never lost."""

import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

Evidence = Callable[[str], ModuleType]


def test_what_is_acknowledged_survives(evidence: Evidence) -> None:
    result = evidence("power_cuts").run(wanted=600)
    assert result.findings == []
    assert result.outcomes.total() == 600
    assert result.acknowledged > 1000
    assert result.outcomes["whole"]
    assert result.outcomes["lossy"]


def test_a_forgotten_wait_for_the_names_is_found(
    evidence: Evidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hueflight.recording.segment.sync_folder", lambda folder: None)
    assert "lost" in evidence("power_cuts").run(wanted=600).findings[0]


def test_a_forgotten_wait_for_the_bytes_is_found(
    evidence: Evidence, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plain = os.fsync
    disk_log = evidence("disk_log")

    def folders_only(self: Any, _: Any) -> Callable[[int], None]:
        def synced(fd: int) -> None:
            plain(fd)
            if fd in self._folders:
                self.events.append(disk_log.Sync(None, len(self.events)))

        return synced

    monkeypatch.setattr(disk_log.DiskLog, "_syncing", folders_only)
    assert "lost" in evidence("power_cuts").run(wanted=600).findings[0]


def test_every_mixture_is_made(evidence: Evidence) -> None:
    """Two sectors in flight, a size and a name: all 2 × 2 × 2 × 2 images, and no other."""
    log, disk = evidence("disk_log"), evidence("disk_images")
    events = [
        log.Rename(0, "a.part"),
        log.Sync(None, 1),
        log.Write(0, 0, b"x" * 512),
        log.Sync(0, 3),
        log.Write(0, 512, b"y" * 1024),
        log.Rename(0, "a"),
    ]
    states = disk.file_states(events, len(events))
    assert states[0].count == 16
    made = {tuple(image.items()) for image in disk.images(states, most=100, rng=None)}
    settled, zeros, new = b"x" * 512, bytes(512), b"y" * 512
    contents = {settled} | {settled + a + b for a in (zeros, new) for b in (zeros, new)}
    assert made == {((name, content),) for name in ("a.part", "a") for content in contents}
