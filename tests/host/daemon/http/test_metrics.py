# SPDX-License-Identifier: Apache-2.0
"""Metrics: their names and labels are those that alert rules and dashboard ask for."""

from __future__ import annotations

import itertools
import json
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient

from hueflight.acquisition.delay_histogram import BOUNDS_S, DelayHistogram

FOLDER = Path(__file__).resolve().parents[4] / "host/prometheus"
WAIT_S = 60.0
SELECTOR = re.compile(r"(hueflight_\w+)(?:\{([^}]*)\})?")


def exported(client: TestClient) -> dict[str, list[Any]]:
    """Samples by their names, read by Prometheus' own parser."""
    samples: dict[str, list[Any]] = {}
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for sample in family.samples:
            samples.setdefault(sample.name, []).append(sample)
    return samples


def dashboard() -> dict[str, Any]:
    return json.loads((FOLDER / "hueflight.dashboard.json").read_text())


def queries() -> Iterator[tuple[str, str]]:
    """Each query of the dashboard with the legend of its curves, and the alert rules."""
    for panel in dashboard()["panels"]:
        for target in panel["targets"]:
            yield target["expr"], target["legendFormat"]
    for expression in re.findall(r"expr: (.*)", (FOLDER / "hueflight.rules.yml").read_text()):
        yield expression, ""


def test_every_query_names_what_is_exported(client: TestClient) -> None:
    samples = exported(client)
    asked = [(name, legend) for query, legend in queries() for name, _ in SELECTOR.findall(query)]
    assert len(asked) >= 25
    for name, legend in asked:
        assert name in samples, name
        labels = set(samples[name][0].labels) | {"instance", "job"}  # the latter by Prometheus
        assert set(re.findall(r"{{(\w+)}}", legend)) <= labels, (name, legend)
    assert {"name", "instrument", "version"} <= set(samples["hueflight_info"][0].labels)


def test_the_dashboard_can_be_imported() -> None:
    """One identity for each panel, no panel over another, every query for the chosen daemons."""
    board = dashboard()
    names = {variable["name"] for variable in board["templating"]["list"]}
    assert names == {"datasource", "instance"}
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])
    places = [panel["gridPos"] for panel in board["panels"]]
    for a, b in itertools.combinations(places, 2):
        beside = a["x"] + a["w"] <= b["x"] or b["x"] + b["w"] <= a["x"]
        below = a["y"] + a["h"] <= b["y"] or b["y"] + b["h"] <= a["y"]
        assert beside or below, (a, b)
        assert a["x"] + a["w"] <= 24
    for panel in board["panels"]:
        for target in panel["targets"]:
            for _, selector in SELECTOR.findall(target["expr"]):
                assert 'instance=~"$instance"' in selector


def test_delays_are_counted_by_their_length() -> None:
    delays = DelayHistogram()
    delays.add(0.0005, 0.001, 0.0011, 0.3)
    delays.add(99.0)
    steps, sum_s = delays.cumulative()
    assert [bound for bound, _ in steps] == [*BOUNDS_S, float("inf")]
    assert dict(steps)[0.001] == 2  # up to and with the limit, as Prometheus counts
    assert (dict(steps)[0.002], dict(steps)[0.5], dict(steps)[10.0]) == (3, 4, 4)
    assert steps[-1][1] == 5
    assert abs(sum_s - 99.3026) < 1e-9


def test_a_recording_counts_how_long_its_data_waited(client: TestClient) -> None:
    assert exported(client)["hueflight_write_delay_seconds_count"][0].value == 0
    client.post("/api/recordings", json={"name": "one", "frames": 300})
    deadline = time.monotonic() + WAIT_S
    while not client.get("/api/status").json()["recording"]["last"]:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    samples = exported(client)
    count = samples["hueflight_write_delay_seconds_count"][0].value
    assert count > 0
    assert samples["hueflight_write_delay_seconds_bucket"][-1].value == count
    assert samples["hueflight_write_delay_seconds_sum"][0].value > 0
