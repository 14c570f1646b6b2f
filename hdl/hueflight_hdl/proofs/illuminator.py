"""What is proved of the illuminator."""

from __future__ import annotations

from functools import partial

from ..pulse.config import Limits
from .illuminator_banks import OtherBankHarness, TrainHarness
from .illuminator_limits import DutyHarness, OnTimeHarness
from .illuminator_requests import LONGEST, AnswerHarness
from .illuminator_safety import DarkHarness, WatchdogHarness
from .proof import Proof

LANES = (1, 2, 4)

PROOFS = (
    Proof(
        "illuminator-dark",
        "No LED is on unless the board is armed, with any schedules, triggers and programs, and "
        "however they change.",
        DarkHarness,
        depth=4,
    ),
    Proof(
        "illuminator-watchdog",
        "The board is armed only if the last word written was the key, and no longer than the "
        "watchdog's time after the last key or feed.",
        WatchdogHarness,
        depth=2,
    ),
    *(
        Proof(
            f"illuminator-on-time-{lanes}",
            f"No LED is on for longer than its limit, whatever is demanded of it; {lanes} lanes.",
            partial(OnTimeHarness, Limits(), lanes=lanes),
            depth={1: 140, 2: 76, 4: 44}[lanes],
        )
        for lanes in LANES
    ),
    *(
        Proof(
            f"illuminator-duty-{lanes}",
            "In any stretch of L ticks no LED is on for more than L / divisor + burst, whatever "
            f"is demanded of it; {lanes} lanes.",
            partial(DutyHarness, Limits(), lanes=lanes),
            depth=8,
        )
        for lanes in LANES
    ),
    Proof(
        "illuminator-bank",
        "Bank, phase, mask and marker of a train change only when a new one begins, and without "
        "a restart that is after the period.",
        TrainHarness,
        depth=20,
    ),
    Proof(
        "illuminator-other-bank",
        "What the bank that is not in use holds, and how it changes, makes no difference to any "
        "tick.",
        OtherBankHarness,
        depth=20,
        induction=False,
    ),
    Proof(
        "illuminator-answers",
        f"Every request that is accepted is answered once, or counted as damaged, within {LONGEST} "
        "clocks, waits of the link not counted.",
        AnswerHarness,
        depth=4,
    ),
)
"""Of the default limits and gearings; see `docs/illuminator.md` for what each means."""
