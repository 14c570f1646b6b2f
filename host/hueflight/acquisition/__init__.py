# SPDX-License-Identifier: Apache-2.0
"""Acquisition: runs of the camera, with recordings, live histograms and complete frame accounting.

A thread of its own owns the rig; see `Acquisition` for what it offers.
"""

from hueflight.acquisition.frame_accounting import Losses, RunTotals
from hueflight.acquisition.plan import CaptureError, Gap, RunPlan, RunResult
from hueflight.acquisition.precision_stop import PrecisionStop
from hueflight.acquisition.run_settings import RunSettings
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.snapshot import LiveBlock, Snapshot
from hueflight.acquisition.summary import summarise, write_summary

__all__ = [
    "Acquisition",
    "CaptureError",
    "Gap",
    "LiveBlock",
    "Losses",
    "PrecisionStop",
    "RunPlan",
    "RunResult",
    "RunSettings",
    "RunTotals",
    "Snapshot",
    "summarise",
    "write_summary",
]
