# SPDX-License-Identifier: Apache-2.0
"""Frame accounting: what became of every frame that the camera exposed.

In a run, frames delivered + dropped + aborted + lost in transit = frames exposed (rule F14 of the
protocol). What the camera dropped while the host asked for no data is a loss of the host.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from hueflight.ingest import IngestReport


@dataclass(frozen=True, slots=True)
class Losses:
    """Frames lost, by place.

    Attributes
    ----------
    sensor : int
        Frames that the camera gave up because the sensor sent too few or too many codes.
    fpga : int
        Frames that the camera dropped or aborted for want of memory while the host asked for
        data.
    usb : int
        Frames sent, or due to be sent while the link was away, that never arrived intact.
    host : int
        Frames that the camera dropped while the host was too busy to ask for data.
    disk : int
        Frames delivered while recording, but not written.
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
        """Number of frames that never reached the histograms; a disk loses delivered ones."""
        return self.sensor + self.fpga + self.usb + self.host

    def as_dict(self) -> dict[str, int]:
        """Return the losses by place.

        Returns
        -------
        dict of str to int
            Number of frames by the name of the place.
        """
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True, slots=True)
class RunTotals:
    """Frames of a run so far.

    Attributes
    ----------
    exposed : int
        Frames that the camera took.
    delivered : int
        Frames counted into histograms.
    losses : Losses
        The others, by place.
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
    """Accounts for the frames of one run, whose stream begins with it.

    Attributes
    ----------
    totals : RunTotals
        Totals when they were last updated.
    disk : int
        Frames delivered and not written, set by whoever records.
    """

    def __init__(self) -> None:
        self.totals = RunTotals()
        self._sensor_faults = 0
        self._fpga_dropped = self._host_dropped = 0
        self._stalled_s = 0.0
        self.disk = 0

    def sensor_fault(self, count: int = 1) -> None:
        """Note frames that the sensor spoiled, as an event of the camera reports them.

        Parameters
        ----------
        count : int
            Number of frames.
        """
        self._sensor_faults += count

    def update(self, report: IngestReport, exposed: int, *, stalled_s: float) -> RunTotals:
        """Bring the totals up to date while the run is on.

        Parameters
        ----------
        report : IngestReport
            Report of the run's whole stream so far.
        exposed : int
            Number of frames of the run up to the last one that the report knows of.
        stalled_s : float
            Time for which the host has asked for no data since the stream was opened, in seconds.

        Returns
        -------
        RunTotals
            The totals.
        """
        dropped = report.dropped_before + report.dropped
        self._attribute(dropped, stalled_s)
        return self._make_totals(report.frames, report.aborted, exposed)

    def reconcile(
        self, report: IngestReport, *, exposed: int, dropped: int, stalled_s: float, away: bool
    ) -> RunTotals:
        """Bring the totals up to date with the camera's own counters, after the run's end.

        Parameters
        ----------
        report : IngestReport
            Report of the run's whole stream.
        exposed, dropped : int
            What the camera counted in the whole run.
        stalled_s : float
            Time for which the host has asked for no data since the stream was opened, in seconds.
        away : bool
            True if the link was gone before the end; frames dropped since are lost to it.

        Returns
        -------
        RunTotals
            The totals.
        """
        if not away:
            self._attribute(dropped, stalled_s)
        return self._make_totals(report.frames, report.aborted, exposed)

    def _attribute(self, dropped: int, stalled_s: float) -> None:
        fresh = max(0, dropped - self._fpga_dropped - self._host_dropped)
        if stalled_s > self._stalled_s:
            self._host_dropped += fresh
        else:
            self._fpga_dropped += fresh
        if fresh:  # a drop shows only in the next frame's header: blame the stall until then
            self._stalled_s = stalled_s

    def _make_totals(self, delivered: int, aborted: int, exposed: int) -> RunTotals:
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
