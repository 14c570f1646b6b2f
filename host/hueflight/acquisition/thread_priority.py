"""How urgent a thread is to the system's scheduler.

What must not be late runs in real time where the system allows it. Niceness is the second best: it
counts only among the processes of one unit or session, so that a browser in another could keep
acquisition waiting for tens of milliseconds.
"""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from enum import Enum


class ThreadPriority(Enum):
    """What a thread does, with its real-time priority (0 for none) and its niceness."""

    ACQUISITION = (12, -10)
    RECORDING = (10, -10)
    RECONSTRUCTION = (0, 5)
    CALIBRATION = (0, 10)

    @property
    def real_time(self) -> int:
        """Priority among real-time threads, from 1; 0 for a thread that is none."""
        return self.value[0]

    @property
    def niceness(self) -> int:
        """Where it does not run in real time: from -20, the first, to 19."""
        return self.value[1]


def adopt(urgency: ThreadPriority, /) -> str:
    """Schedule the calling thread, and those that it begins, by what it does.

    Returns
    -------
    In words what the system allowed: ``"real time"``, ``"niceness -10"`` or ``"ordinary"``.
    """
    if urgency.real_time and _schedule("SCHED_RR", urgency.real_time):
        return "real time"
    _schedule("SCHED_OTHER", 0)  # a thread begun by one in real time is in real time
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), urgency.niceness)
        return f"niceness {urgency.niceness}"
    return "ordinary"


def _schedule(policy: str, priority: int) -> bool:
    if not hasattr(os, "sched_setscheduler"):  # not every Unix has it
        return False
    with suppress(OSError):  # limits (LimitRTPRIO), containers, kernels with groups of real time
        os.sched_setscheduler(0, getattr(os, policy), os.sched_param(priority))
        return True
    return False
