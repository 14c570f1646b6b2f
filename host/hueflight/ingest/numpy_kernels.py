# SPDX-License-Identifier: Apache-2.0
"""The NumPy backend: functions with the signatures of the compiled module."""

from hueflight.backend.ingest import ADD, MOST_FRAMES, SATURATE, STORE, SUBTRACT, TILE
from hueflight.ingest.numpy_count import count
from hueflight.ingest.numpy_gather import gather, group_counts
from hueflight.ingest.numpy_scan import STATE, scan
from hueflight.ingest.numpy_scene_change import significance

__all__ = [
    "ADD",
    "MOST_FRAMES",
    "SATURATE",
    "STATE",
    "STORE",
    "SUBTRACT",
    "TILE",
    "count",
    "gather",
    "group_counts",
    "scan",
    "significance",
]
