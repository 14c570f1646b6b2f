# SPDX-License-Identifier: Apache-2.0
"""Scheduling priority of threads.

Threads that must not be late get a real-time priority where the system allows it. Niceness is
second best: it counts only among the processes of one unit or session, so that a browser in another
one could delay acquisition by tens of milliseconds.
"""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from enum import Enum


class ThreadPriority(Enum):
    """Tasks of threads, each with its real-time priority (0 for none) and its niceness."""

    ACQUISITION = (12, -10)
    RECORDING = (10, -10)
    RECONSTRUCTION = (0, 5)
    CALIBRATION = (0, 10)

    @property
    def real_time(self) -> int:
        """Priority among real-time threads, from 1; 0 for a thread without one."""
        return self.value[0]

    @property
    def niceness(self) -> int:
        """Niceness without a real-time priority, from -20 (scheduled first) to 19."""
        return self.value[1]


def set_thread_priority(priority: ThreadPriority, /) -> str:
    """Set the priority of the calling thread, and of threads that it starts.

    Parameters
    ----------
    priority : ThreadPriority
        What the thread does.

    Returns
    -------
    str
        What the system allowed: ``"real time"``, ``"niceness -10"`` or ``"ordinary"``.
    """
    if priority.real_time and _schedule("SCHED_RR", priority.real_time):
        return "real time"
    _schedule("SCHED_OTHER", 0)  # a thread begun by one in real time is in real time
    if set_niceness(threading.get_native_id(), priority):
        return f"niceness {priority.niceness}"
    return "ordinary"


def set_niceness(number: int, priority: ThreadPriority, /) -> bool:
    """Set the niceness of a process or of one thread.

    Parameters
    ----------
    number : int
        Its number in the system.
    priority : ThreadPriority
        What it does.

    Returns
    -------
    bool
        Whether the system knows niceness and allowed it.
    """
    if not hasattr(os, "setpriority"):  # Windows
        return False
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, number, priority.niceness)
        return True
    return False


def _schedule(policy: str, priority: int) -> bool:
    if not hasattr(os, "sched_setscheduler"):  # not every Unix has it
        return False
    with suppress(OSError):  # limits (LimitRTPRIO), containers, kernels with groups of real time
        os.sched_setscheduler(0, getattr(os, policy), os.sched_param(priority))
        return True
    return False
