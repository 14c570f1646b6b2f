# SPDX-License-Identifier: Apache-2.0
"""Constraints keep their clocks through synthesis, or the build ends."""

import json

import pytest

from hueflight_hdl.build.clock_constraints import rename_clocks
from hueflight_hdl.build.report import BuildError


def netlist(**names):
    flip_flop = {"type": "TRELLIS_FF", "connections": {"CLK": [7], "Q": [9]}}
    return {
        "modules": {
            "top": {
                "ports": {"clk25_0__io": {"bits": [2]}},
                "cells": {"a": flip_flop, "b": flip_flop},
                "netnames": {
                    "other.pulse_clk": {"bits": [8]},  # clocks nothing
                    **{name: {"bits": [bit]} for name, bit in names.items()},
                },
            }
        }
    }


def prepared(tmp_path, constraints, **names):
    (tmp_path / "top.json").write_text(json.dumps(netlist(**names)))
    (tmp_path / "top.lpf").write_text(constraints)
    return tmp_path / "top.lpf"


def test_a_constraint_takes_the_name_that_is_left(tmp_path):
    written = 'BLOCK RESETPATHS;\nFREQUENCY NET "deep.in.pulse_clk" 230.0 HZ;\n'
    path = prepared(tmp_path, written, **{"clocks.pulse_clk": 7})
    assert rename_clocks(tmp_path, "top", "ecp5") == {"deep.in.pulse_clk": "clocks.pulse_clk"}
    assert path.read_text() == written.replace("deep.in", "clocks")
    assert rename_clocks(tmp_path, "top", "ecp5") == {}


def test_a_clock_without_a_name_ends_the_build(tmp_path):
    prepared(tmp_path, 'FREQUENCY NET "link.usb_clk" 60.0 HZ;\n', **{"clocks.pulse_clk": 7})
    with pytest.raises(BuildError, match=r"no net of the constrained clock link\.usb_clk is left"):
        rename_clocks(tmp_path, "top", "ecp5")
