# SPDX-License-Identifier: Apache-2.0
"""Boards from files outside the package: read, refused, elaborated, synthesised, routed."""

import json
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from hueflight_hdl.boards import targets
from hueflight_hdl.boards.board_file import read_board_file
from hueflight_hdl.boards.ice40 import find_pll
from hueflight_hdl.boards.target import Options, TargetError
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.boards.xc7 import find_multiplier
from hueflight_hdl.build.build import build, prepare
from hueflight_hdl.build.project import estimate, write_project

EXAMPLES = Path(__file__).parent / "examples"
PIN = {
    "lpf": r'SITE "(\w+)"',
    "pcf": r"set_io \S+ (\w+)",
    "xdc": r"set_property LOC (\w+)",
}

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


@pytest.mark.parametrize(
    ("name", "leds", "constraints"),
    [("blackice", 4, "pcf"), ("upduino", 4, "pcf"), ("icesugar-pro-32", 32, "lpf")],
)
def test_every_pin_of_a_board_file_is_placed_once(tmp_path, name, leds, constraints):
    board = read_board_file(EXAMPLES / f"{name}.toml")
    target = find_target("illuminator", str(EXAMPLES / f"{name}.toml"))
    prepare(target, tmp_path)
    found = re.findall(PIN[constraints], (tmp_path / f"top.{constraints}").read_text())
    wanted = [board.clock_pin, *(pin for group in board.pins.values() for pin in group)]
    assert sorted(found) == sorted(wanted)
    assert target.board == name
    assert target.settings["channels"] == leds == len(board.pins["led_pulse"])


def test_a_vivado_project(simulator, tmp_path):
    """Four ticks a clock through serialisers, released pins, and no bitstream if timing fails."""
    target = find_target("illuminator", str(EXAMPLES / "arty-a7.toml"))
    names = {path.name for path in write_project(target, tmp_path)}
    assert {"top.v", "top.xdc", "top.tcl", "design.toml"} <= names
    verilog = (tmp_path / "top.v").read_text()
    assert len(re.findall(r"^ *OSERDESE2 #", verilog, re.M)) == 9 + 1  # LEDs and trigger out
    assert len(re.findall(r"^ *ISERDESE2 #", verilog, re.M)) == 1
    assert len(re.findall(r"^ *BUFGCE ", verilog, re.M)) == 3
    (multiplier,) = re.findall(r"\.CLKFBOUT_MULT\(32'd(\d+)\)", verilog)
    divisions = re.findall(r"\.CLKOUT\d_DIVIDE\(32'd(\d+)\)", verilog)
    # Xilinx UG472: f = f_in · multiplier / division, with 800 to 1600 MHz between
    made = [100 * int(multiplier) / int(division) for division in divisions]
    assert made == [400, 200, 50]
    xdc = (tmp_path / "top.xdc").read_text()
    assert "create_clock -name clock_0__io -period 10.0" in xdc
    script = (tmp_path / "top.tcl").read_text()
    assert script.index("timing is not met") < script.index("write_bitstream")


@pytest.mark.slow
def test_a_vivado_project_is_synthesised(builder, tmp_path):
    target = find_target("illuminator", str(EXAMPLES / "arty-a7.toml"))
    write_project(target, tmp_path)
    counted = estimate(target, tmp_path)
    assert 3000 < counted["LUT"] < 20800  # of an Artix-7 35T
    cells = json.loads((tmp_path / "cells.json").read_text())["design"]["num_cells_by_type"]
    assert cells["OSERDESE2"] == 10
    assert cells["OBUFT"] >= 9


@pytest.mark.slow
def test_four_leds_fit_an_up5k_with_margin(builder, tmp_path):
    """Placed and routed: the smallest device, with every clock 10% faster than it must be."""
    report = build(find_target("illuminator", str(EXAMPLES / "upduino.toml")), tmp_path)
    assert report.reached
    assert report.required == 0.1
    used, available = report.used["logic cell"]
    assert available == 5280  # Lattice FPGA-DS-02008: iCE40UP5K
    assert used <= available
    assert (tmp_path / "top.bin").stat().st_size > 100_000


def test_a_small_program_is_kept_in_block_memory(tmp_path):
    """Not in registers, of which four steps would take a fifth of an UP5K."""
    small = Options(settings={"steps": 4})
    prepare(find_target("illuminator", str(EXAMPLES / "upduino.toml"), small), tmp_path)
    styled = re.findall(r'attribute \\ram_style "(\w+)"', (tmp_path / "top.il").read_text())
    assert styled == ["block"] * 4  # words of a step


def test_a_python_file_and_an_entry_point(monkeypatch):
    path = EXAMPLES / "own_board.py"
    options = Options(settings={"channels": 3})
    assert find_target("illuminator", str(path), options).settings["channels"] == 3
    with pytest.raises(TargetError, match="the camera does not fit this board"):
        find_target("camera", str(path))

    def make(design: str, options: Options):
        return find_target(design, str(path), options)

    class Point(EntryPoint):
        def load(self):
            return make

    point = Point("own", "nowhere:make", targets.ENTRY_POINTS)
    monkeypatch.setattr(targets, "entry_points", lambda group: [point])
    assert find_target("illuminator", "own").board == "blackice"
    with pytest.raises(TargetError, match=r"xem3010, own, or give the path of a board file"):
        find_target("illuminator", "other")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('family = "ice40"', 'family = "nexus"'), "'nexus': must be one of ecp5, ice40, xc7"),
        (("[clock]", "[clocks]"), "unknown name clocks: the names are name, family"),
        (("[clock]", 'speed = "6"\n[clock]'), "speed: the device of an ice40 board has it"),
        (("hz = 100e6", "hz = -1"), r"clock\.hz = -1: must be a frequency"),
        (('rx = "88"', 'rx = "85"'), "85 is used more than once"),
        (('trigger = "18"', ""), r"pins\.trigger = None: must be a pin"),
        (('"26", "25"]', '"26"]'), r"pins\.marker = .* must be a list of 8 pins"),
        (("led_pulse =", "leds ="), r"unknown name pins\.leds"),
        (("pulses = 1", "pulses = 9"), "settings: pulses = 9: must be from 1 to 4"),
        (
            ("pulses = 1", "pulse = 1"),
            "settings: the illuminator has no setting pulse: choose from",
        ),
        (("default = {", "defaults = {"), r"unknown name attributes\.defaults"),
        (("[settings]", "[[settings]]"), r"settings = \[.*: must be a table"),
        (("[attributes]", "[[attributes]]"), r"attributes = \[.*: must be a table"),
        (('name = "blackice"', ""), "name = None: must be a text"),
        (("[pins]", "[pins"), "Expected|Invalid"),
        (("hz = 100e6", 'hz = 100e6\nedge = "left"'), r"clock\.edge = 'left': .* on an ecp5 board"),
    ],
)
def test_board_files_are_checked(tmp_path, change, said):
    text = (EXAMPLES / "blackice.toml").read_text()
    assert text.count(change[0]) == 1
    path = tmp_path / "board.toml"
    path.write_text(text.replace(*change))
    with pytest.raises(TargetError, match=said):
        find_target("illuminator", str(path))


def test_an_external_clock_needs_its_pin_and_the_edge_of_the_leds(tmp_path):
    text = (EXAMPLES / "icesugar-pro-32.toml").read_text()
    text = text.replace('rx = "A9"', 'rx = "A9"\nreference = "K4"\nclock_out = "J4"')
    with_edge = text.replace("pulse_hz = 150e6", 'pulse_hz = 150e6\nedge = "left"')
    path = tmp_path / "board.toml"
    chosen = Options(settings={"reference_hz": 10_000_000, "channels": 2})
    for content, said in (
        (with_edge.replace('reference = "K4"', ""), "cannot run from an external clock"),
        (text, "a pin named reference, and an edge for its clock"),
        (with_edge.replace('"left"', '"top"'), r"clock\.edge = 'top': must be left or right"),
    ):
        path.write_text(content)
        with pytest.raises(TargetError, match=said):
            find_target("illuminator", str(path), chosen)
    path.write_text(with_edge)
    prepare(find_target("illuminator", str(path), chosen), tmp_path / "made")
    places = re.findall(r'SITE "(\w+)"', (tmp_path / "made/top.lpf").read_text())
    assert {"K4", "J4"} <= set(places)
    source = (tmp_path / "made/top.il").read_text()
    assert re.findall(r'attribute \\BEL "(\S+)"', source) == ["X2/Y49/EHXPLL_LL"]


def test_what_a_file_cannot_be(tmp_path):
    with pytest.raises(TargetError, match="there is no such board file"):
        find_target("illuminator", str(tmp_path / "absent.toml"))
    with pytest.raises(TargetError, match="the camera needs a Python file with a function"):
        find_target("camera", str(EXAMPLES / "blackice.toml"))
    with pytest.raises(TargetError, match="only the camera has a sensor port with lanes"):
        find_target("illuminator", str(EXAMPLES / "blackice.toml"), Options(lanes=4))
    with pytest.raises(TargetError, match=r"the pins of \S+blackice\.toml are fixed"):
        find_target("illuminator", str(EXAMPLES / "blackice.toml"), Options(pins=tmp_path))
    (tmp_path / "empty.py").write_text("")
    with pytest.raises(TargetError, match="has no function target"):
        find_target("illuminator", str(tmp_path / "empty.py"))


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("blackice", ("100e6", "5e6"), "the PLL takes 10 to 133 MHz"),
        ("blackice", ("75e6", "5e6"), r"the PLL makes 8\.3 to 533 MHz"),
        ("icesugar-pro-32", ("150e6", "155e6"), r"half a multiple of the clock .* 150, 162\.5"),
        ("icesugar-pro-32", ("150e6", "250e6"), "must be from 1e.08 to 2e.08"),
        ("arty-a7", ("hz = 100e6", "hz = 33e6"), "an oscillator of 800 to 1600 MHz"),
    ],
)
def test_clocks_that_cannot_be_made(tmp_path, file, change, said):
    path = tmp_path / "board.toml"
    path.write_text((EXAMPLES / f"{file}.toml").read_text().replace(*change))
    with pytest.raises(TargetError, match=said):
        find_target("illuminator", str(path))


def test_plls_of_known_boards():
    assert find_pll(12e6, 100.5e6).hz == 100.5e6
    assert find_pll(12e6, 100e6).hz == pytest.approx(100e6, rel=0.01)
    assert find_multiplier(100e6, 200e6) in (8, 12, 16)
    assert find_multiplier(25e6, 200e6) in (32, 48, 64)
