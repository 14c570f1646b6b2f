# SPDX-License-Identifier: Apache-2.0
"""Processes that draw photons for a simulated camera."""

from __future__ import annotations

import os
from contextlib import suppress

__all__ = ["take_ordinary_priority"]


def take_ordinary_priority() -> None:
    """Give this process the priority of any other program.

    It was started by the thread of acquisition, whose real-time priority it would keep: drawing
    photons would then come before live pictures and everything else on the machine.
    """
    if not hasattr(os, "sched_setscheduler"):
        return  # no other system starts processes with a real-time priority
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        if os.getpriority(os.PRIO_PROCESS, 0) < 0:
            os.setpriority(os.PRIO_PROCESS, 0, 0)
