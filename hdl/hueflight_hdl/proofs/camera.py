# SPDX-License-Identifier: Apache-2.0
"""Formally verified properties of the camera."""

from __future__ import annotations

from .camera_capture import AbortHarness, VerdictHarness
from .camera_counters import CountersHarness
from .camera_formatter import (
    CollisionHarness,
    ProgressHarness,
    StableHarness,
    SteadyWalkHarness,
    TrailerHarness,
    WalkHarness,
)
from .camera_reduction import (
    DrainHarness,
    SumCollisionHarness,
    SumHarness,
    WindowsHarness,
    WriterHarness,
    WriterProgressHarness,
)
from .camera_time import TimeHarness
from .proof import Proof

PROOFS = (
    Proof(
        "camera-stable",
        "A word that waits for the link does not change.",
        StableHarness,
        depth=2,
    ),
    Proof(
        "camera-counters",
        "The counters of a capture never decrease: 32-bit counters saturate, 64-bit counters do "
        "not wrap within thousands of years.",
        CountersHarness,
        depth=2,
    ),
    Proof(
        "camera-abort",
        "An abort ends a capture within 8 clocks, and a start begins one within 8 clocks of "
        "being allowed to, with any register contents, any sensor and any link.",
        AbortHarness,
        depth=30,
        induction=False,
    ),
    Proof(
        "camera-time",
        "Cameras on one clock that waited for an edge and got it have the same time from then on, "
        "until the clock of one fails or it waits for another; nothing else sets the time.",
        TimeHarness,
        depth=4,
    ),
    Proof(
        "camera-verdict",
        "Every readout is either passed, dropped or aborted, exactly once.",
        VerdictHarness,
        depth=30,
        induction=False,
    ),
    Proof(
        "camera-trailer",
        "The trailer writer passes on every word once and fills in the length of the packet.",
        TrailerHarness,
        depth=20,
        induction=False,
    ),
    Proof(
        "camera-packets",
        "Every packet has the length that its chunks state, aborted packets too, and correct "
        "totals, if the buffer has room for every word.",
        SteadyWalkHarness,
        depth=29,
        induction=False,
    ),
    Proof(
        "camera-packets-stalled",
        "Packets have the length that their chunks state with any stalls of the link, checked up "
        "to the end of the first packets.",
        WalkHarness,
        depth=24,
        induction=False,
    ),
    Proof(
        "camera-collisions",
        "The chunk memories are never read at the address that is written in the same clock.",
        CollisionHarness,
        depth=36,
        induction=False,
    ),
    Proof(
        "camera-progress",
        "With a link that takes every word, everything received has been sent 34 clocks later, "
        "and all banks are free.",
        ProgressHarness,
        depth=40,
        induction=False,
    ),
    Proof(
        "camera-sums",
        "A sum is exact or stands at its greatest value, and never decreases.",
        SumHarness,
        depth=2,
    ),
    Proof(
        "camera-sum-windows",
        "Sums that can be fetched hold just the frames that are said of them until they are given "
        "back, with any frames, settings and reader.",
        WindowsHarness,
        depth=16,
        induction=False,
    ),
    Proof(
        "camera-sum-collisions",
        "The sums of a group are never read while they are written, but where they begin anew.",
        SumCollisionHarness,
        depth=18,
        induction=False,
    ),
    Proof(
        "camera-sum-end",
        "Nothing is left to be fetched 50 clocks after the end of a capture, with any settings and "
        "any frames before it.",
        DrainHarness,
        depth=66,
        induction=False,
    ),
    Proof(
        "camera-sum-progress",
        "A block has been read 50 clocks after it can be, with any contents of the registers and a "
        "link that takes every word.",
        WriterProgressHarness,
        depth=60,
        induction=False,
    ),
    Proof(
        "camera-sum-packets",
        "No word of a packet of sums is lost, with any sums and a link that takes none, checked "
        "for the two packets that the buffer holds, and that a third waits, of the smallest "
        "writer.",
        WriterHarness,
        depth=90,
        induction=False,
    ),
)
