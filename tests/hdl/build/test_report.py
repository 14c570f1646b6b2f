# SPDX-License-Identifier: Apache-2.0
"""Reports of place and route: clocks and cells, and the margin that decides."""

import json

import pytest

from hueflight_hdl.build.report import (
    BuildError,
    BuildReport,
    ClockResult,
    read_cells,
    read_clocks,
    read_paths,
)
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


def segment(kind, delay, begins, ends):
    return {"type": kind, "delay": delay, "from": {"cell": begins}, "to": {"cell": ends}}


def test_the_slowest_path_of_each_clock_is_told(tmp_path):
    """As nextpnr writes them: to the setup of the last register, and across domains too."""
    slow = [
        segment("clk-to-q", 0.54, "from_reg", "from_reg"),
        segment("routing", 1.5, "from_reg", "lut"),
        segment("logic", 0.4, "lut", "lut"),
        segment("routing", 0.6, "lut", "to_reg"),
        segment("setup", 0.1, "to_reg", "to_reg"),
    ]
    quick = [segment("clk-to-q", 0.5, "a", "a"), segment("setup", 0.1, "b", "b")]
    clock, other = "posedge clocks.pulse_clk_$glb_clk", "posedge clk"
    content = [
        {"from": clock, "to": clock, "path": quick},
        {"from": clock, "to": clock, "path": slow},
        {"from": clock, "to": other, "path": [*slow, *slow]},
    ]
    path = written(tmp_path, {"critical_paths": content})
    found = read_paths(path, ["pulse", "sync"])
    assert list(found) == ["pulse"]
    assert (found["pulse"].begins, found["pulse"].ends) == ("from_reg", "to_reg")
    assert found["pulse"].logic_ns == pytest.approx(1.04)
    assert found["pulse"].routing_ns == pytest.approx(2.1)
    assert found["pulse"].levels == 1
    assert "3.14 ns, of it 2.10 ns in wires, 1 cells between" in found["pulse"].describe()


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
    assert "on pins" not in good


def test_the_page_says_which_camera_has_a_sensor_on_pins():
    clock = {"reached_mhz": 120.0, "needed_mhz": 100.0, "margin": 0.2}
    report = {
        "design": "camera",
        "board": "b",
        "lanes": 8,
        "used": {"LUT4": [1, 2]},
        "clocks": {"sync": clock, "sensor": clock},
        "seed": 1,
        "tried": {"1": 0.2},
        "reached": True,
    }
    assert "| camera, b, 8 lanes, sensor on pins | 1 LUT4s |" in page([report], [])
