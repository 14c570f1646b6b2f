"""What acquisition shows to whoever looks: how things stand, and the newest histogram."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from hueflight.acquisition.frame_accounting import RunTotals
from hueflight.acquisition.plan import Gap
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.ingest.stream import Block


@dataclass(frozen=True)
class LiveBlock:
    """A histogram for whoever wants to look.

    Attributes
    ----------
    block : counts and what stands behind them.
    received_s : monotonic clock when the block's last byte had arrived.
    kind, run : of the run, and its label.
    give_back : call when done, so that the memory serves again.
    """

    block: Block
    received_s: float
    kind: str
    run: int
    give_back: Callable[[], None]


@dataclass(frozen=True)
class Snapshot:
    """How things stand; a new one after every piece of the stream.

    Attributes
    ----------
    state : ``"disconnected"``, ``"idle"`` or ``"running"``.
    problem : what is wrong, in words; empty if nothing is.
    rig : serial number, place and firmware of the camera, empty while there is none.
    kind : of the run that is on.
    run_frames : delivered in it.
    run_limit : frames it will have, 0 if open.
    run_photons : in it.
    totals : since the start of the program, the present run included.
    photons : likewise.
    received_bytes : likewise.
    last_data_s : monotonic clock of the last byte, None before the first.
    recording : path of the recording, empty if none.
    recorded_frames, recorded_bytes, recorder_queue_bytes : of it.
    recording_failure : why it broke off.
    stream : of the present connection.
    gaps : the latest ones.
    connections : how often a rig was opened.
    """

    state: str = "disconnected"
    problem: str = ""
    rig: dict[str, str] = field(default_factory=dict)
    simulated: bool = False
    kind: str = ""
    run_frames: int = 0
    run_limit: int = 0
    run_photons: int = 0
    totals: RunTotals = field(default_factory=RunTotals)
    photons: int = 0
    received_bytes: int = 0
    last_data_s: float | None = None
    recording: str = ""
    recorded_frames: int = 0
    recorded_bytes: int = 0
    recorder_queue_bytes: int = 0
    recording_failure: str = ""
    stream: StreamStatistics = field(default_factory=StreamStatistics)
    gaps: tuple[Gap, ...] = ()
    connections: int = 0
