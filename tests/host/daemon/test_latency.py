# SPDX-License-Identifier: Apache-2.0
"""Latency from last photon to display, and its parts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from hueflight.daemon.latency import LatencyMeter


def test_delays_and_their_parts() -> None:
    latencies = LatencyMeter()
    assert latencies.as_dict() is None
    for way in (0.01, 0.02, 0.03):
        picture: Any = SimpleNamespace(received_s=5.0, begun_s=5.1, ready_s=5.4)
        latencies.shown(picture, 5.4 + way)
    found = latencies.as_dict()
    assert found == {
        "p50": 0.42, "p95": 0.43, "p99": 0.43, "waiting": 0.1, "making": 0.3, "showing": 0.02
    }  # fmt: skip
    late: Any = SimpleNamespace(received_s=36.0, begun_s=36.0, ready_s=36.0)
    latencies.shown(late, 36.5)
    assert latencies.as_dict() == {
        "p50": 0.5, "p95": 0.5, "p99": 0.5, "waiting": 0, "making": 0, "showing": 0.5
    }  # fmt: skip
