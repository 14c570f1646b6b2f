# SPDX-License-Identifier: Apache-2.0
"""Acquisition: one thread that owns the rig, runs plans, and never waits for anyone.

Whoever looks (a viewer, a recorder, a client) is handed what there is and can't delay it. When the
rig goes away, the thread looks for it until it is back; the gap is marked and the run goes on.
`hueflight.acquisition.states` has the states of the thread and the transitions between them.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from hueflight.acquisition.connecting import lose_rig, reconnect, search
from hueflight.acquisition.delay_histogram import DelayHistogram
from hueflight.acquisition.ending import end_run, fail_run, finish, give_up
from hueflight.acquisition.plan import CaptureError, RunPlan, RunResult
from hueflight.acquisition.run_settings import RunSettings
from hueflight.acquisition.running import read_stream
from hueflight.acquisition.session import Session
from hueflight.acquisition.snapshot import LiveBlock, LiveSums, Snapshot
from hueflight.acquisition.starting import begin_next
from hueflight.acquisition.states import State, follow
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.devices.camera_controls import CameraControls
from hueflight.devices.errors import DeviceError
from hueflight.devices.rig import Connect
from hueflight.devices.simulation import Simulation
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument

WORK: dict[State, Callable[[Session], State]] = {
    State.SEARCHING: search,
    State.IDLE: begin_next,
    State.RUNNING: read_stream,
    State.INTERRUPTED: reconnect,
    State.ENDING: end_run,
}
"""What is done in each state; it returns the state that follows."""

#: seconds that one step may take: a simulated rig draws its photons before its first run, and the
#: end of a recording waits for the disk
PATIENCE_S = {State.RUNNING: 5.0, State.IDLE: 330.0}
LONGER_PATIENCE_S = 60.0


class Acquisition:
    """Runs plans on a rig, in a thread of its own.

    Parameters
    ----------
    connect : callable
        Opens the rig; called again and again while there is none.
    instrument : Instrument
        The instrument that the rig should be.
    settings : RunSettings, optional
        Sizes of blocks and queues, by default those that suit the instrument.
    live : RunPlan, optional
        Run to fall back to when nothing else is asked; by default none.
    on_block : callable, optional
        Receives every block; must return at once.
    on_event : callable, optional
        Receives the name and the details of what happens.

    Attributes
    ----------
    thread : SupervisedThread
        The acquisition thread, which begins anew after a fault of the program.
    """

    def __init__(
        self,
        connect: Connect,
        instrument: Instrument,
        /,
        *,
        settings: RunSettings | None = None,
        live: RunPlan | None = None,
        on_block: Callable[[LiveBlock | LiveSums], None] | None = None,
        on_event: Callable[[str, dict[str, Any]], None] | None = None,
    ) -> None:
        self.instrument = instrument
        self.settings = settings or RunSettings.of(instrument)
        self._session = Session(
            connect, instrument, self.settings, live, on_block, on_event or (lambda _, __: None)
        )
        self._closing = False
        self.thread = SupervisedThread(self._work, name="acquisition", on_failure=self._give_up)
        self.thread.start()

    # -- from any thread ----------------------------------------------------------------------

    @property
    def snapshot(self) -> Snapshot:
        """Present status; a new object whenever it changes."""
        return self._session.snapshot

    @property
    def simulation(self) -> Simulation | None:
        """Other side of the simulated camera that is or was connected; None for a real one."""
        return self._session.simulation

    @property
    def write_delays(self) -> DelayHistogram:
        """Times from the arrival of data until they are written, of all recordings."""
        return self._session.write_delays

    def run(self, plan: RunPlan, /) -> Future[RunResult]:
        """Have a plan run next; a live run makes way, another run is waited for.

        Parameters
        ----------
        plan : RunPlan
            The run.

        Returns
        -------
        Future of RunResult
            Done when the run has ended.

        Raises
        ------
        CaptureError
            If the plan contradicts itself.
        """
        plan.check()
        future: Future[RunResult] = Future()
        self._session.requests.put((plan, future))
        return future

    def set_live(self, plan: RunPlan | None, /) -> None:
        """Choose what runs when nothing else is asked.

        Parameters
        ----------
        plan : RunPlan or None
            The live run, None to stay idle.
        """
        self._session.live = plan

    def set_controls(self, controls: CameraControls, settings: RunSettings, /) -> None:
        """Change what may be changed from the next run on; a live run begins again.

        Parameters
        ----------
        controls : CameraControls
            What the camera is to do.
        settings : RunSettings
            Sizes of blocks and queues at that frame rate.
        """
        self.settings = settings
        self._session.settings_wanted, self._session.controls = settings, controls

    @property
    def controls(self) -> CameraControls:
        """What the camera is to do from the next run on."""
        return self._session.controls

    def stop(self) -> None:
        """End the present run as soon as its stream is read; a live run begins again."""
        self._session.end_requested = True

    def close(self, *, timeout_s: float = 20.0) -> None:
        """End the run, finish the recording, and leave the LEDs off.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait, in seconds.
        """
        self._closing = True
        self.thread.end()
        self.thread.join(timeout_s)

    # -- the acquisition thread ---------------------------------------------------------------

    def _work(self) -> None:
        session = self._session
        scheduled = set_thread_priority(ThreadPriority.ACQUISITION)
        session.on_event("acquisition", {"scheduled": scheduled})
        state = State.SEARCHING
        session.failed = False
        # a run that has reached its end still ends as one that did
        while not self._closing or state is State.ENDING:
            self.thread.beat(PATIENCE_S.get(state, LONGER_PATIENCE_S))
            try:
                following = WORK[state](session)
            except DeviceError as error:
                following = lose_rig(session, error)
            except HueflightError as error:
                following = fail_run(session, str(error))
            state = follow(state, following)
            session.refresh()
            if session.rig is not None:
                self.thread.recovered()
        follow(state, State.CLOSED)
        self._close_session()

    def _give_up(self, reason: str, trace: str) -> None:
        """Called in the acquisition thread after a fault of the program."""
        give_up(self._session, reason)
        self._session.on_event("acquisition failed", {"reason": reason, "traceback": trace})
        if self._closing:
            self._close_session()

    def _close_session(self) -> None:
        session = self._session
        try:
            if session.run is not None:
                finish(session, "the program ended")
        except HueflightError as error:
            fail_run(session, str(error))
        if session.rig is not None:
            session.rig.close()
        while not session.requests.empty():
            _, future = session.requests.get()
            if future.set_running_or_notify_cancel():
                future.set_exception(CaptureError("the program ended before the run began"))
        session.publish(State.CLOSED, problem="closed")
