"""Which frames were lost, and where: of every frame that the camera exposed it is said.

Of the frames of a run, delivered + dropped + aborted + lost on the way = exposed (rule F14 of the
protocol). What the camera dropped while the host asked for nothing is the host's loss.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from hueflight.ingest import IngestReport


@dataclass(frozen=True, slots=True)
class Losses:
    """Frames lost, by place.

    Attributes
    ----------
    sensor : the sensor sent too few or too many codes, and the camera gave the frame up.
    fpga : dropped or aborted by the camera for want of room, with the host asking for data.
    usb : sent, or due to be sent while the link was away, and never arrived intact.
    host : dropped by the camera while the host was too busy to ask for data.
    disk : delivered while recording, but not written.
    """

    sensor: int = 0
    fpga: int = 0
    usb: int = 0
    host: int = 0
    disk: int = 0

    def __add__(self, other: Losses) -> Losses:
        """Sum by place."""
        return Losses(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    @property
    def undelivered(self) -> int:
        """Frames that never reached the histograms; a disk loses what was delivered."""
        return self.sensor + self.fpga + self.usb + self.host

    def as_dict(self) -> dict[str, int]:
        """By name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True, slots=True)
class RunTotals:
    """What a run has brought so far.

    Attributes
    ----------
    exposed : frames that the camera took.
    delivered : frames counted into histograms.
    losses : the difference, by place.
    """

    exposed: int = 0
    delivered: int = 0
    losses: Losses = Losses()

    def __add__(self, other: RunTotals) -> RunTotals:
        """Sum of two runs."""
        return RunTotals(
            self.exposed + other.exposed,
            self.delivered + other.delivered,
            self.losses + other.losses,
        )


class FrameAccounting:
    """Keeps the books of one run, whose stream begins with it.

    Attributes
    ----------
    totals : brought up to date by `update`.
    disk : frames delivered and not written, set by whoever records.
    """

    def __init__(self) -> None:
        self.totals = RunTotals()
        self._sensor_faults = 0
        self._fpga_dropped = self._host_dropped = 0
        self._stalled_s = 0.0
        self.disk = 0

    def sensor_fault(self, count: int = 1) -> None:
        """The camera has told of frames that its sensor spoiled."""
        self._sensor_faults += count

    def update(self, report: IngestReport, exposed: int, *, stalled_s: float) -> RunTotals:
        """Bring the books up to date.

        Parameters
        ----------
        report : of the run's whole stream so far.
        exposed : frames of the run up to the last one that the report knows of.
        stalled_s : how long the host has asked for nothing, since the stream was opened.
        """
        dropped = report.dropped_before + report.dropped
        self._attribute(dropped, stalled_s)
        return self._close(report.frames, report.aborted, exposed)

    def settle(
        self, report: IngestReport, *, exposed: int, dropped: int, stalled_s: float, away: bool
    ) -> RunTotals:
        """Close the books with the camera's own counters, after the run's end.

        Parameters
        ----------
        exposed, dropped : what the camera counted in the whole run.
        away : the link was gone before the end; what was dropped since is lost to it.
        """
        if not away:
            self._attribute(dropped, stalled_s)
        return self._close(report.frames, report.aborted, exposed)

    def _attribute(self, dropped: int, stalled_s: float) -> None:
        fresh = max(0, dropped - self._fpga_dropped - self._host_dropped)
        if stalled_s > self._stalled_s:
            self._host_dropped += fresh
        else:
            self._fpga_dropped += fresh
        if fresh:  # a drop shows only in the next frame's header: blame the stall until then
            self._stalled_s = stalled_s

    def _close(self, delivered: int, aborted: int, exposed: int) -> RunTotals:
        sensor = min(aborted, self._sensor_faults)
        known = delivered + aborted + self._fpga_dropped + self._host_dropped
        self.totals = RunTotals(
            exposed=max(exposed, known),
            delivered=delivered,
            losses=Losses(
                sensor=sensor,
                fpga=self._fpga_dropped + aborted - sensor,
                usb=max(0, exposed - known),
                host=self._host_dropped,
                disk=self.disk,
            ),
        )
        return self.totals
