# SPDX-License-Identifier: Apache-2.0
"""Counters and gauges for Prometheus, taken from the same status that the page shows."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString

from hueflight.acquisition.delay_histogram import DelayHistogram
from hueflight.daemon.service import Service


def thread_cpu_s() -> dict[str, float]:
    """Return CPU seconds by thread name; numbered names count together."""
    found: dict[str, float] = {}
    for thread in threading.enumerate():
        if thread.ident is None:
            continue
        try:
            clock = time.pthread_getcpuclockid(thread.ident)
            seconds = time.clock_gettime(clock)
        except (OSError, AttributeError):
            continue  # it has just ended, or the system has no such clocks
        name = thread.name.split("-")[0] if thread.name.startswith("Thread-") else thread.name
        found[name] = found.get(name, 0.0) + seconds
    return found


class _Status(Collector):
    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> Iterator[Metric]:
        status = self._service.status()
        facts = {
            "name": status["name"],
            "instrument": status["instrument"],
            "version": version("hueflight"),
        }
        yield InfoMetricFamily("hueflight", "The daemon and its instrument", value=facts)
        yield from _counters(status)
        yield from _gauges(status)
        yield GaugeMetricFamily(
            "hueflight_disk_free_bytes",
            "Space that is free under the data folder",
            value=float(self._service.disk.free_bytes),
        )
        yield _delays(
            "picture_delay",
            "Time from a picture's last photon until a browser shows it",
            self._service.latencies.delays,
        )
        yield _delays(
            "write_delay",
            "Time from the arrival of data until they are written to the recording",
            self._service.acquisition.write_delays,
        )
        cpu = CounterMetricFamily(
            "hueflight_thread_cpu_seconds", "CPU time by thread", labels=["thread"]
        )
        for name, seconds in thread_cpu_s().items():
            cpu.add_metric([name], seconds)
        yield cpu


def _delays(name: str, text: str, delays: DelayHistogram) -> HistogramMetricFamily:
    steps, sum_s = delays.cumulative()
    return HistogramMetricFamily(
        f"hueflight_{name}_seconds",
        text,
        buckets=[(floatToGoString(bound), count) for bound, count in steps],
        sum_value=sum_s,
    )


def _counters(status: dict[str, Any]) -> Iterator[Metric]:
    totals, link = status["totals"], status["link"]
    for name, text, value in (
        ("frames_exposed", "Frames that the camera exposed", totals["exposed"]),
        ("frames_delivered", "Frames counted into histograms", totals["delivered"]),
        ("photons", "Photons in the frames delivered", totals["photons"]),
        ("received_bytes", "Bytes received from the camera", totals["bytes"]),
        ("pictures", "Pictures reconstructed", status["picture"]["number"]),
        (
            "pictures_skipped",
            "Histograms outdated before they were reconstructed",
            status["picture"]["skipped"],
        ),
        ("connections", "Times the camera was opened", link["connections"]),
        ("link_errors", "Stalls, overflows and failed transfers", link["errors"]),
        ("host_stalls", "Times the host was too busy to ask the camera for data", link["stalls"]),
    ):
        yield CounterMetricFamily(f"hueflight_{name}", text, value=value)
    lost = CounterMetricFamily(
        "hueflight_frames_lost", "Frames lost, by the place of the loss", labels=["place"]
    )
    for place, frames in status["lost"].items():
        lost.add_metric([place], frames)
    yield lost
    failures = CounterMetricFamily(
        "hueflight_part_failures",
        "Failures of a part of the daemon, after each of which it begins anew",
        labels=["part"],
    )
    for name, part in status["parts"].items():
        failures.add_metric([name], part["failures"])
    yield failures


def _gauges(status: dict[str, Any]) -> Iterator[Metric]:
    working = GaugeMetricFamily(
        "hueflight_part_working", "1 while a part of the daemon works", labels=["part"]
    )
    for name, part in status["parts"].items():
        working.add_metric([name], float(part["state"] == "working"))
    yield working
    age = status["picture"]["age_s"]
    latency = status["latency_s"] or {}
    connected = status["state"] in ("idle", "running")
    for name, text, value in (
        ("running", "1 during a run", status["state"] == "running"),
        ("camera_connected", "1 while the camera is connected", connected),
        ("simulated", "1 if the photons are simulated", status["simulated"]),
        ("recording", "1 during a recording", bool(status["recording"]["name"])),
        (
            "recording_failed",
            "1 if the recording was interrupted by a failure",
            bool(status["recording"]["failure"]),
        ),
        ("recorder_queue_bytes", "Bytes waiting for the disk", status["recording"]["queue_bytes"]),
        ("link_queue_bytes", "Bytes waiting to be counted", status["link"]["queue_bytes"]),
        ("picture_age_seconds", "Age of the latest picture", float("nan") if age is None else age),
        ("viewers", "Viewers of the live picture", status["viewers"]),
        (
            "latency_p50_seconds",
            "Time from last photon to display, median",
            latency.get("p50", float("nan")),
        ),
        (
            "latency_p99_seconds",
            "Time from last photon to display, 99th percentile",
            latency.get("p99", float("nan")),
        ),
    ):
        yield GaugeMetricFamily(f"hueflight_{name}", text, value=float(value))


def make_registry(service: Service) -> CollectorRegistry:
    """Return a registry of the metrics of one daemon."""
    registry = CollectorRegistry()
    registry.register(_Status(service))
    return registry


def render(registry: CollectorRegistry) -> bytes:
    """Return the metrics in the text format of Prometheus."""
    return generate_latest(registry)
