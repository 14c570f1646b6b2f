# SPDX-License-Identifier: Apache-2.0
"""Formally verified properties of the illuminator."""

from __future__ import annotations

from functools import partial

from hueflight_protocol.illuminator_map import MAX_FILTER_TICKS

from ..illuminator.pulse_generator.config import Limits
from ..illuminator.pulse_generator.trigger_filter import filter_latency
from .illuminator_banks import OtherBankHarness, TrainHarness
from .illuminator_filter import FilterHarness
from .illuminator_limits import DutyHarness, OnTimeHarness
from .illuminator_requests import LONGEST, AnswerHarness
from .illuminator_safety import DarkHarness, WatchdogHarness
from .proof import Proof
from .reference_clock import INTERVAL, ReferenceHarness

LANES = (1, 2, 4)

PROOFS = (
    Proof(
        "illuminator-dark",
        "No LED is on unless the board is armed, with any schedules, triggers and programs, and "
        "however these change.",
        DarkHarness,
        depth=4,
    ),
    Proof(
        "illuminator-watchdog",
        "The board is armed only if the last word written was the key and the clock has not "
        "failed since, and no longer than the watchdog time after the last key or feed.",
        WatchdogHarness,
        depth=2,
    ),
    *(
        Proof(
            f"illuminator-on-time-{lanes}",
            f"No LED is on for longer than its limit, whatever the demand; {lanes} lanes.",
            partial(OnTimeHarness, Limits(), lanes=lanes),
            depth={1: 140, 2: 76, 4: 44}[lanes],
        )
        for lanes in LANES
    ),
    *(
        Proof(
            f"illuminator-duty-{lanes}",
            "In any window of L ticks no LED is on for more than L / divisor + burst ticks, "
            f"whatever the demand; {lanes} lanes.",
            partial(DutyHarness, Limits(), lanes=lanes),
            depth=8,
        )
        for lanes in LANES
    ),
    *(
        Proof(
            f"illuminator-filter-{lanes}",
            "The filter of the trigger finds the first edge in each clock between levels that last "
            f"for its width, and no other, at any input; {lanes} lanes.",
            partial(FilterHarness, lanes),
            depth=filter_latency(lanes) + MAX_FILTER_TICKS // lanes + 2,
        )
        for lanes in LANES
    ),
    Proof(
        "illuminator-bank",
        "Bank, phase, mask and marker change only when a new train begins; without a restart, "
        "that is after the period.",
        TrainHarness,
        depth=20,
    ),
    Proof(
        "illuminator-other-bank",
        "The content of the bank that is not in use, and changes of it, do not affect any tick.",
        OtherBankHarness,
        depth=20,
        induction=False,
    ),
    Proof(
        "illuminator-reference",
        "The source of the clock changes only while the PLL is in reset, which lasts for the "
        f"settling time before and after; an external clock that stops for {INTERVAL + 4:g} "
        "clocks, is not wanted, or to which the PLL does not lock, is not in use. For any "
        "external clock.",
        ReferenceHarness,
        depth=24,
    ),
    Proof(
        "illuminator-answers",
        f"Every accepted request is answered once, or counted as damaged, within {LONGEST} clocks, "
        "not counting the clocks in which the link waits.",
        AnswerHarness,
        depth=4,
    ),
)
"""For the default limits and gearings; ``docs/illuminator.md`` explains each."""
