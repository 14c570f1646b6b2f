# SPDX-License-Identifier: Apache-2.0
"""What happens in a run, all of it decided by the seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Disk = Literal["folder", "small", "image"]
RESERVE_MB = 8  #: of disk space that recordings leave free

#: faults by what they concern; each run has one kind of disk, which decides about the last ones
CAMERA = ("unplug", "power", "stall", "overflow", "zero_length", "short", "damage", "deaf")
HOST = ("pause",)
PROGRAM = ("acquisition_fails", "pictures_fail", "recorder_fails")
HARMLESS = ("idle", "slow_viewers", "flood", "clock", "calibration", "commands")
KILL = ("kill",)
DISK: dict[Disk, tuple[str, ...]] = {
    "folder": ("write_eio", "write_enospc", "room_eio", "some_writes", "end_sync", "end_rename"),
    "small": ("full",),
    "image": ("unmount",),
}
DISKS: tuple[Disk, ...] = ("folder", "folder", "small", "image")
GROUPS = (CAMERA, HOST, PROGRAM, HARMLESS, KILL, ("disk",))
#: faults that may cost frames before they are delivered
COSTLY = frozenset((*CAMERA, *HOST, "acquisition_fails", "kill"))


@dataclass(frozen=True)
class Step:
    """One fault.

    Attributes
    ----------
    fault : name of the fault.
    hold_s : time for which it lasts, after it was noticed if it is to be noticed.
    pause_s : time of peace after it.
    amount : from 0 to 1: how strong it is, where that can be said.
    """

    fault: str
    hold_s: float
    pause_s: float
    amount: float


@dataclass(frozen=True)
class FaultPlan:
    """One run.

    Attributes
    ----------
    seed : seed that decides about everything.
    rate_hz : frame rate.
    occupancy : share of pixels with a photon.
    disk : what the data folder lies on.
    options, server, recording : lines of the configuration.
    steps : faults, one after another.
    """

    seed: int
    rate_hz: int
    occupancy: float
    disk: Disk
    options: str
    server: str
    recording: str
    steps: tuple[Step, ...]

    @property
    def harmless(self) -> bool:
        """True if no fault may cost a frame before it is delivered."""
        return not any(step.fault in COSTLY for step in self.steps)


def make_plan(seed: int) -> FaultPlan:
    """The run of a seed."""
    rng = np.random.default_rng(seed)
    disk = DISKS[rng.integers(len(DISKS))]
    return FaultPlan(
        seed=seed,
        rate_hz=int(rng.choice([240, 480, 1000, 2000, 4000])),
        occupancy=float(rng.uniform(0, 0.6)),
        disk=disk,
        options=_options(rng),
        server=f"max_connections = {rng.choice([4, 16, 64])}",
        recording=f"min_free_mb = {RESERVE_MB}\nqueue_mb = {rng.choice([1, 8, 128])}",
        steps=tuple(_step(rng, disk) for _ in range(rng.integers(1, 5))),
    )


def _options(rng: np.random.Generator) -> str:
    """Odd values within their ranges."""
    found = []
    for name, values in (
        ("pictures_hz", (0, 0.5, 1000)),
        ("picture_frames", (0, 1, 10_000_000)),
        ("change_sigma", (0, 4, 100)),
        ("threads", (1, 3)),
        ("method", ('""', '"paper"', '"joint"')),
    ):
        if rng.random() < 0.3:
            found.append(f"{name} = {values[rng.integers(len(values))]}")
    return "\n".join(found)


def _step(rng: np.random.Generator, disk: Disk) -> Step:
    group = GROUPS[rng.choice(len(GROUPS), p=[0.3, 0.07, 0.1, 0.2, 0.08, 0.25])]
    names = DISK[disk] if group == ("disk",) else group
    return Step(
        str(rng.choice(names)), float(rng.uniform(0.05, 1.0)), float(rng.uniform(0.05, 0.6)),
        float(rng.random()),
    )  # fmt: skip
