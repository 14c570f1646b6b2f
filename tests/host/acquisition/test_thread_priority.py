# SPDX-License-Identifier: Apache-2.0
"""What must not be late is scheduled first, as far as the system lets it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import pytest

from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority

T = TypeVar("T")


def in_a_thread(work: Callable[[], T]) -> T:
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(work).result()


def scheduled() -> tuple[int, int, int]:
    """Policy, real-time priority and niceness of the calling thread."""
    niceness = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, niceness


def allowed(attempt: Callable[[], None]) -> bool:
    def tried() -> bool:
        try:
            attempt()
        except OSError:
            return False
        return True

    return in_a_thread(tried)


REAL_TIME = allowed(lambda: os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(12)))
NICE = allowed(lambda: os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), -10))


@pytest.mark.parametrize("task", [ThreadPriority.ACQUISITION, ThreadPriority.RECORDING])
def test_as_much_as_the_system_allows(task: ThreadPriority) -> None:
    said, (policy, priority, niceness) = in_a_thread(
        lambda: (set_thread_priority(task), scheduled())
    )
    if REAL_TIME:
        assert (said, policy, priority) == ("real time", os.SCHED_RR, task.real_time)
    elif NICE:
        assert (said, policy, niceness) == ("niceness -10", os.SCHED_OTHER, -10)
    else:
        assert (said, policy, niceness) == ("ordinary", os.SCHED_OTHER, 0)


def test_acquisition_comes_before_recording_and_both_before_the_rest() -> None:
    ranks = [task.real_time for task in ThreadPriority]
    assert ranks == sorted(ranks, reverse=True)
    assert ThreadPriority.ACQUISITION.real_time > ThreadPriority.RECORDING.real_time > 0
    assert ThreadPriority.RECONSTRUCTION.real_time == 0 < ThreadPriority.RECONSTRUCTION.niceness


def test_a_thread_begun_by_an_urgent_one_steps_back() -> None:
    """Otherwise the fits of a stop rule would compete with the acquisition that begins them."""

    def begin() -> object:
        set_thread_priority(ThreadPriority.ACQUISITION)
        return in_a_thread(
            lambda: (set_thread_priority(ThreadPriority.RECONSTRUCTION), scheduled())
        )

    assert in_a_thread(begin) == ("niceness 5", (os.SCHED_OTHER, 0, 5))


def test_where_the_system_allows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError("Operation not permitted")

    before = in_a_thread(scheduled)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    if NICE:
        assert in_a_thread(lambda: set_thread_priority(ThreadPriority.RECORDING)) == "niceness -10"
    monkeypatch.setattr(os, "setpriority", refuse)
    assert in_a_thread(lambda: (set_thread_priority(ThreadPriority.RECORDING), scheduled())) == (
        "ordinary",
        before,
    )


def test_a_system_without_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_setscheduler")
    said = in_a_thread(lambda: set_thread_priority(ThreadPriority.ACQUISITION))
    assert said == ("niceness -10" if NICE else "ordinary")
