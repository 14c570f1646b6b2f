# SPDX-License-Identifier: Apache-2.0
"""The states of an acquisition follow one another as the table allows, whatever happens."""

from __future__ import annotations

import pytest

import hueflight as hf
from hueflight.acquisition import runner
from hueflight.acquisition.plan import RunPlan
from hueflight.acquisition.runner import WORK, Acquisition
from hueflight.acquisition.states import TRANSITIONS, State, TransitionError, follow
from support.faulty_rig import FaultyRig

WAIT_S = 60.0


def test_every_state_has_its_work_and_its_transitions() -> None:
    assert set(TRANSITIONS) == set(State)
    assert set(WORK) == set(State) - {State.FAILED, State.CLOSED}
    assert {state.shown for state in State} == {"disconnected", "idle", "running", "failed"}
    reached = {State.SEARCHING}
    for _ in State:
        reached |= {following for state in reached for following in TRANSITIONS[state]}
    assert reached == set(State)


@pytest.mark.parametrize(
    ("present", "following"),
    [
        (State.SEARCHING, State.RUNNING),
        (State.IDLE, State.ENDING),
        (State.ENDING, State.RUNNING),
        (State.CLOSED, State.SEARCHING),
    ],
)
def test_other_transitions_are_refused(present: State, following: State) -> None:
    with pytest.raises(TransitionError, match=f"{following.name} must not follow {present.name}"):
        follow(present, following)


def test_a_run_and_a_gap_go_through_the_states(
    rig: FaultyRig, fast: hf.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = [State.SEARCHING]

    def note(present: State, following: State) -> State:
        if following is not present:
            seen.append(following)
        return follow(present, following)

    monkeypatch.setattr(runner, "follow", note)
    acquisition = Acquisition(rig.connect, fast)
    try:
        acquisition.run(RunPlan(frames=50)).result(WAIT_S)
        rig.faults.late_reads = 3
        future = acquisition.run(RunPlan(frames=2000))
        while acquisition.snapshot.run_frames < 50:
            assert not future.done()
        rig.faults.plugged = False
        while acquisition.snapshot.state != "disconnected":
            assert not future.done()
        rig.faults.plugged = True
        future.result(WAIT_S)
    finally:
        acquisition.close()
    assert seen == [
        State.SEARCHING,
        State.IDLE,
        State.RUNNING,
        State.ENDING,
        State.IDLE,
        State.RUNNING,
        State.INTERRUPTED,
        State.RUNNING,
        State.ENDING,
        State.IDLE,
        State.CLOSED,
    ]
