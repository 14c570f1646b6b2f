# SPDX-License-Identifier: Apache-2.0
"""Frame accounting: each lost frame is counted once, at one place."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hueflight.acquisition.frame_accounting import FrameAccounting, Losses, RunTotals
from hueflight.ingest import IngestReport

SMALL = st.integers(0, 1000)


@given(SMALL, SMALL, SMALL, SMALL, SMALL)
def test_exposed_is_delivered_plus_lost(
    delivered: int, dropped: int, before: int, aborted: int, missing: int
) -> None:
    accounting = FrameAccounting()
    exposed = delivered + dropped + before + aborted + missing
    report = IngestReport(frames=delivered, dropped=dropped, dropped_before=before, aborted=aborted)
    totals = accounting.update(report, exposed, stalled_s=0.0)
    assert totals.delivered + totals.losses.undelivered == totals.exposed == exposed
    assert totals.losses == Losses(fpga=dropped + before + aborted, usb=missing)


def test_drops_while_the_host_did_not_ask_are_the_hosts() -> None:
    accounting = FrameAccounting()
    accounting.update(IngestReport(frames=10, dropped=3), 13, stalled_s=0.0)
    # stalled: the drop shows only in a later frame
    accounting.update(IngestReport(frames=20, dropped=3), 23, stalled_s=0.5)
    totals = accounting.update(IngestReport(frames=30, dropped=8), 38, stalled_s=0.5)
    assert totals.losses == Losses(fpga=3, host=5)
    totals = accounting.update(IngestReport(frames=30, dropped=9), 39, stalled_s=0.5)
    assert totals.losses == Losses(fpga=4, host=5)


def test_spoiled_frames_are_the_sensors() -> None:
    accounting = FrameAccounting()
    accounting.sensor_fault(2)
    totals = accounting.update(IngestReport(frames=5, aborted=3), 8, stalled_s=0.0)
    assert totals.losses == Losses(sensor=2, fpga=1)


def test_what_a_camera_drops_without_a_link_is_the_links() -> None:
    accounting = FrameAccounting()
    report = IngestReport(frames=100)
    accounting.update(report, 100, stalled_s=0.0)
    accounting.reconcile(report, exposed=180, dropped=60, stalled_s=0.0, away=True)
    assert accounting.totals.losses == Losses(usb=80)


def test_sums() -> None:
    one = RunTotals(10, 8, Losses(fpga=1, usb=1, disk=3))
    assert one + one == RunTotals(20, 16, Losses(fpga=2, usb=2, disk=6))
    assert one.losses.undelivered == 2
