# SPDX-License-Identifier: Apache-2.0
"""Reports of place and route: clocks and cells, and the margin that decides."""

import json

import pytest

from hueflight_hdl.build.report import BuildError, BuildReport, ClockResult, read_cells, read_clocks
from hueflight_hdl.build.table import page

# shortened from what nextpnr 0.11 wrote for two boards
ICE40 = {
    "fmax": {
        "clk": {"achieved": 55.33, "constraint": 57.79},
        "illuminator.channel0_ddr.pulse_clk": {"achieved": 110.57, "constraint": 115.57},
    },
    "utilization": {
        "ICESTORM_LC": {"available": 7680, "used": 6574},
        "ICESTORM_RAM": {"available": 32, "used": 15},
    },
}
ECP5 = {
    "fmax": {
        "$glbnet$clocks.pulse_clk": {"achieved": 221.0, "constraint": 230.0},
        "$glbnet$clocks.clk": {"achieved": 95.5, "constraint": 57.5},
        "$glbnet$other.pulse_clk": {"achieved": 219.0, "constraint": 230.0},
    },
}


def written(tmp_path, content):
    path = tmp_path / "nextpnr.json"
    path.write_text(json.dumps(content))
    return path


def test_clocks_are_found_by_domain_and_the_slowest_counts(tmp_path):
    found = read_clocks(written(tmp_path, ICE40), {"pulse": 100.5, "sync": 50.25})
    assert found["pulse"].margin == pytest.approx(0.1002, abs=1e-4)
    assert found["sync"].reached_mhz == 55.33
    found = read_clocks(written(tmp_path, ECP5), {"pulse": 200.0, "sync": 50.0})
    assert found["pulse"].reached_mhz == 219.0
    assert found["sync"].reached_mhz == 95.5


def test_a_clock_that_is_not_there_is_no_clock_that_is_fast(tmp_path):
    with pytest.raises(BuildError, match="no clock 'usb_clk'"):
        read_clocks(written(tmp_path, ICE40), {"usb": 60.0})
    with pytest.raises(BuildError, match="cannot be read as a report"):
        read_clocks(tmp_path / "absent.json", {"sync": 50.0})


def test_cells(tmp_path):
    assert read_cells(written(tmp_path, ICE40), "ice40") == {
        "logic cell": (6574, 7680),
        "block RAM": (15, 32),
    }


def test_the_smallest_margin_decides(tmp_path):
    clocks = {"pulse": ClockResult(200.0, 219.0), "sync": ClockResult(50.0, 95.0)}
    report = BuildReport(
        "illuminator", "board", None, tmp_path / "top.bit", "00", {}, clocks, 1, {1: 0.095}, 0.10
    )
    assert report.margin == pytest.approx(0.095)
    assert not report.reached
    content = json.loads(report.to_json())
    assert content["reached"] is False
    assert content["bitstream"] == "top.bit"
    assert content["clocks"]["pulse"]["margin"] == 0.095


def test_the_page_says_who_falls_short():
    reports = [
        {
            "design": "illuminator",
            "board": board,
            "lanes": None,
            "used": {"LUT4": [100, 200]},
            "clocks": {"pulse": {"reached_mhz": 100 * (1 + m), "needed_mhz": 100, "margin": m}},
            "seed": 3,
            "tried": {"1": 0.02, "3": m},
            "reached": reached,
        }
        for board, m, reached in (("b", 0.05, False), ("a", 0.123, True))
    ]
    counts = [{"design": "camera", "board": "c", "lanes": 4, "cells": {"LUT": 7, "carry": 2}}]
    lines = page(reports, counts).splitlines()
    good = next(line for line in lines if "illuminator, a" in line)
    bad = next(line for line in lines if "illuminator, b" in line)
    assert lines.index(good) < lines.index(bad)
    assert "112.3 of 100 MHz (+12.3%) | yes | 3 (2)" in good
    assert "**no**" in bad
    assert "| camera, c, 4 lanes | 7 | 2 |" in lines
