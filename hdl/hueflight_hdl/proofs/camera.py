"""What is proved of the camera."""

from __future__ import annotations

from .camera_capture import AbortHarness, VerdictHarness
from .camera_counters import CountersHarness
from .camera_formatter import (
    CollisionHarness,
    ProgressHarness,
    SealHarness,
    StableHarness,
    SteadyWalkHarness,
    WalkHarness,
)
from .proof import Proof

PROOFS = (
    Proof(
        "camera-stable",
        "A word that waits for the link stays as it is.",
        StableHarness,
        depth=2,
    ),
    Proof(
        "camera-counters",
        "A capture's counters never decrease: 32-bit ones stay at their end, 64-bit ones count "
        "for millennia.",
        CountersHarness,
        depth=2,
    ),
    Proof(
        "camera-abort",
        "An abort ends a capture within 8 clocks, and a start begins one within 8 clocks of "
        "being allowed to, with any register contents, sensor and link.",
        AbortHarness,
        depth=30,
        induction=False,
    ),
    Proof(
        "camera-verdict",
        "Every readout is passed, dropped or aborted, once.",
        VerdictHarness,
        depth=30,
        induction=False,
    ),
    Proof(
        "camera-seal",
        "Sealing passes on every word once, and the length that it fills in is the packet's.",
        SealHarness,
        depth=20,
        induction=False,
    ),
    Proof(
        "camera-packets",
        "No packet is shorter or longer than its chunks say, aborted ones included, and its "
        "totals are right; with room for every word.",
        SteadyWalkHarness,
        depth=29,
        induction=False,
    ),
    Proof(
        "camera-packets-stalled",
        "The same with any stalls, as far as the first packets begin to end.",
        WalkHarness,
        depth=24,
        induction=False,
    ),
    Proof(
        "camera-collisions",
        "No memory of chunks is read where it is written in the same clock.",
        CollisionHarness,
        depth=36,
        induction=False,
    ),
    Proof(
        "camera-progress",
        "With a link that takes every word, all that has come has left 34 clocks later, and all "
        "banks are free.",
        ProgressHarness,
        depth=40,
        induction=False,
    ),
)
"""In the order of what they cost."""
