# SPDX-License-Identifier: Apache-2.0
"""The states of an acquisition, and which of them may follow which."""

from __future__ import annotations

from enum import Enum


class State(Enum):
    """What an acquisition is doing; `shown` is what `Snapshot.state` says.

    A rig is open in `IDLE` and `RUNNING`; a run is open in `RUNNING`, `INTERRUPTED` and `ENDING`.
    """

    SEARCHING = "searching"
    """No rig is open and no run is on: look for a rig."""
    IDLE = "idle"
    """A rig is open and no run is on: begin one when there is something to run."""
    RUNNING = "running"
    """A run is on: read its stream."""
    INTERRUPTED = "interrupted"
    """A run is on and its rig is gone: look for the rig, then go on with the run."""
    ENDING = "ending"
    """A run has reached its end: stop the camera, read the rest, close the recording."""
    FAILED = "failed"
    """Something unexpected happened; the run is given up, and the search begins again soon."""
    CLOSED = "closed"
    """The acquisition was closed; nothing follows."""

    @property
    def shown(self) -> str:
        """The state in the words of `Snapshot.state`."""
        return _SHOWN[self]


_SHOWN = {
    State.SEARCHING: "disconnected",
    State.IDLE: "idle",
    State.RUNNING: "running",
    State.INTERRUPTED: "disconnected",
    State.ENDING: "running",
    State.FAILED: "failed",
    State.CLOSED: "disconnected",
}

_AFTER_WORK: dict[State, frozenset[State]] = {
    State.SEARCHING: frozenset({State.SEARCHING, State.IDLE, State.CLOSED}),
    # beginning a run may lose the rig before the run is on
    State.IDLE: frozenset({State.IDLE, State.RUNNING, State.SEARCHING, State.CLOSED}),
    # a run that fails is over at once, without the work of ENDING
    State.RUNNING: frozenset(
        {State.RUNNING, State.INTERRUPTED, State.ENDING, State.IDLE, State.CLOSED}
    ),
    State.INTERRUPTED: frozenset(
        {
            State.INTERRUPTED,
            State.RUNNING,
            State.ENDING,
            State.SEARCHING,
            State.IDLE,
            State.CLOSED,
        }
    ),
    # the rig may be lost while the rest of the stream is read
    State.ENDING: frozenset({State.IDLE, State.SEARCHING, State.INTERRUPTED, State.CLOSED}),
}
TRANSITIONS: dict[State, frozenset[State]] = {
    **{state: following | {State.FAILED} for state, following in _AFTER_WORK.items()},
    State.FAILED: frozenset({State.SEARCHING, State.CLOSED}),
    State.CLOSED: frozenset(),
}
"""States that may follow each state."""


class TransitionError(RuntimeError):
    """A fault in the acquisition itself: a state followed another that it must not follow."""


def follow(present: State, following: State, /) -> State:
    """Check a transition.

    Parameters
    ----------
    present, following : State
        The state that is left and the one that follows.

    Returns
    -------
    State
        The state that follows.

    Raises
    ------
    TransitionError
        If `TRANSITIONS` does not allow it.
    """
    if following not in TRANSITIONS[present]:
        raise TransitionError(f"acquisition: {following.name} must not follow {present.name}")
    return following
