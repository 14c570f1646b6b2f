# SPDX-License-Identifier: Apache-2.0
"""What an acquisition shows: its status, and the newest histogram or sums."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from hueflight.acquisition.frame_accounting import RunTotals
from hueflight.acquisition.plan import Gap
from hueflight.devices.camera_controls import CameraTiming
from hueflight.devices.pulse_schedule import Capacity
from hueflight.devices.reduction import Reduction
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.stream import Block
from hueflight.ingest.sums_blocks import SumsBlock
from hueflight.model.instrument import Instrument
from hueflight_protocol import ReductionRoom


@dataclass(frozen=True)
class LiveBlock:
    """A histogram of some frames, for live pictures.

    Attributes
    ----------
    block : Block
        Counts, and the frames behind them.
    received_s : float
        Monotonic clock when the block's last byte had arrived.
    kind : str
        What the run is for.
    run : int
        Label of the run.
    instrument : Instrument
        The instrument with the schedule that the LEDs had.
    give_back : callable
        To be called when done, so that the memory can be used again.
    """

    block: Block
    received_s: float
    kind: str
    run: int
    instrument: Instrument
    give_back: Callable[[], None]

    @property
    def step(self) -> int:
        """The illuminator's step at the end of the block."""
        return max(self.block.counts)

    @property
    def histogram(self) -> Counts:
        """Counts of that step, shape (row, col, code)."""
        return self.block.counts[self.step]


@dataclass(frozen=True)
class LiveSums:
    """A picture of sums, for live pictures.

    Attributes
    ----------
    block : SumsBlock
        Packets of the picture, and the frames behind them.
    received_s : float
        Monotonic clock when the last byte had arrived.
    kind : str
        What the run is for.
    run : int
        Label of the run.
    instrument : Instrument
        The instrument with the schedule that the LEDs had.
    reduction : Reduction
        Tables and offsets that the sums were made with.
    clock_hz : int
        Ticks per second of the device clock, 0 if unknown.
    """

    block: SumsBlock
    received_s: float
    kind: str
    run: int
    instrument: Instrument
    reduction: Reduction
    clock_hz: int

    def give_back(self) -> None:
        """Do nothing: the memory of packets is not used again."""


@dataclass(frozen=True)
class Snapshot:
    """Status of an acquisition at one time.

    Attributes
    ----------
    state : str
        ``"disconnected"``, ``"idle"``, ``"running"``, or ``"failed"`` after a fault of the program.
    problem : str
        What is wrong, in words; empty if nothing is.
    rig : dict of str to str
        Serial number, place and firmware of the camera, and name of the illumination; empty
        while there is no rig.
    simulated : bool
        True if the photons are simulated.
    kind : str
        What the present run is for, ``"live"`` for the live run; empty if none is on.
    run_frames : int
        Number of frames delivered in the present run.
    run_limit : int
        Number of frames after which the present run ends, 0 for no limit.
    run_photons : int
        Number of photons detected in the present run.
    totals : RunTotals
        Frames since the acquisition began, the present run included.
    photons : int
        Number of photons since the acquisition began.
    received_bytes : int
        Number of bytes received since the acquisition began.
    last_data_s : float or None
        Monotonic clock of the last byte, None before the first.
    recording : str
        Path of the present recording, empty if there is none.
    recorded_frames, recorded_bytes, recorder_queue_bytes : int
        What is safe in the recording, and what waits for the disk.
    recording_failure : str
        Why the recording broke off, empty if it did not.
    recording_paused : bool
        True while frames are not written, for lack of room or after an error of the disk.
    stream : StreamStatistics
        Totals of the present connection.
    gaps : tuple of Gap
        The latest gaps.
    connections : int
        How many times a rig was opened.
    rate_hz : float or None
        Frames per second that the camera was set to, None before the first connection.
    timing : CameraTiming or None
        Limits of the camera's frame rate, None before the first connection.
    capacity : Capacity or None
        Limits of the illuminator's schedules, None without one whose schedule can be changed.
    link : str
        What the camera's stream goes over, one of `hueflight_protocol.links.LINKS`; empty if that
        is not known.
    reduction_room : ReductionRoom or None
        What the camera has room for to reduce codes to sums, None if it can't.
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
    recording_paused: bool = False
    stream: StreamStatistics = field(default_factory=StreamStatistics)
    gaps: tuple[Gap, ...] = ()
    connections: int = 0
    rate_hz: float | None = None
    timing: CameraTiming | None = None
    capacity: Capacity | None = None
    link: str = ""
    reduction_room: ReductionRoom | None = None
