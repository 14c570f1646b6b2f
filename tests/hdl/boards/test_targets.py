# SPDX-License-Identifier: Apache-2.0
"""Boards: pins that exist once, pins that must be told, and messages that say what there is."""

import re
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from hueflight_hdl.boards.target import Options, TargetError
from hueflight_hdl.boards.targets import boards_of, designs, find_target
from hueflight_hdl.build.build import prepare

# LUNA uses Amaranth's older records
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

XEM6310 = """
iostandard = "LVCMOS33"
trigger = "C11"
frame_sync = "A15"
missed = "C13"
marker = ["A13", "C15", "A11", "A7", "A6", "C7", "C9", "A9"]
"""


def test_designs_and_boards():
    assert designs() == ["camera", "illuminator"]
    ecp5 = {*(f"ulx3s-{size}" for size in ("12f", "25f", "45f", "85f")), "ecpix5-45f", "ecpix5-85f"}
    assert {*ecp5, "hx8k", "xem3010"} == set(boards_of("illuminator"))
    assert {*ecp5, "xem6310"} == set(boards_of("camera"))


@pytest.mark.parametrize(
    ("design", "board", "options", "said"),
    [
        ("lamp", "hx8k", Options(), "camera, illuminator"),
        ("camera", "hx8k", Options(), "ulx3s-85f, ulx3s-45f, .*, xem6310"),
        ("illuminator", "hx8k", Options(lanes=4), "only the camera has a sensor port with lanes"),
        ("illuminator", "hx8k", Options(pins=Path("a.toml")), "the pins of hx8k are fixed"),
        ("illuminator", "xem3010", Options(), r"is not guessed: give --pins .*clock_hz.*led_pulse"),
        ("camera", "xem6310", Options(), r"not guessed: give --pins .*marker \(8 pins\)"),
    ],
)
def test_refusals_list_what_can_be_built(design, board, options, said):
    with pytest.raises(TargetError, match=said):
        find_target(design, board, options)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("trigger =", "shutter ="), "unknown name shutter: the names are trigger"),
        (('"A9"]', "]"), r"marker = .* must be 8 pins of xem6310"),
        (('trigger = "C11"', 'trigger = "A15"'), "A15 is named more than once"),
        (("iostandard", "#"), "iostandard = None"),
        (("[", ""), "Invalid|Expected"),
    ],
)
def test_pin_files_are_checked(tmp_path, change, said):
    path = tmp_path / "pins.toml"
    path.write_text(XEM6310.replace(*change))
    with pytest.raises(TargetError, match=said):
        find_target("camera", "xem6310", Options(pins=path))


@pytest.mark.parametrize(
    ("design", "board", "constraints"),
    [
        ("illuminator", "ulx3s-85f", "lpf"),
        ("illuminator", "ecpix5-85f", "lpf"),
        ("illuminator", "hx8k", "pcf"),
    ],
)
def test_every_pin_is_placed_once(tmp_path, design, board, constraints):
    prepare(find_target(design, board), tmp_path)
    text = (tmp_path / f"top.{constraints}").read_text()
    pattern = r'SITE "(\w+)"' if constraints == "lpf" else r"set_io \S+ (\w+)"
    pins = re.findall(pattern, text)
    assert len(pins) == len(set(pins))
    # nine LEDs, trigger in and out, frame sync, eight markers, missed, serial line, clock, lamp
    assert len(pins) >= 9 + 2 + 1 + 8 + 1 + 2 + 1 + 1
    assert "missed" in text


def test_the_pll_of_the_hx8k_makes_the_clock_that_is_configured(tmp_path):
    """Lattice FPGA-TN-02052: simple feedback, f = f_in (DIVF + 1) / (2 ** DIVQ (DIVR + 1))."""
    target = find_target("illuminator", "hx8k")
    prepare(target, tmp_path)
    text = (tmp_path / "top.il").read_text()
    values = {
        name: int(re.search(rf"parameter \\{name} \d+'([01]+)", text)[1], 2)
        for name in ("DIVR", "DIVF", "DIVQ")
    }
    oscillator = target.platform().default_clk_frequency
    made = oscillator * (values["DIVF"] + 1) / (1 << values["DIVQ"]) / (values["DIVR"] + 1)
    assert made == pytest.approx(1e6 * target.clocks_mhz["pulse"])


SENSOR = """
sensor_clock = "P3"
sensor_data = ["N1", "N3", "M1", "M2"]
sensor_control = "L1"
sensor_expose = "L3"
sensor_read = "K1"
"""


def test_a_sensor_on_pins_of_the_ecpix5(tmp_path):
    target = find_target("camera", "ecpix5-85f", Options(settings={"sensor": 1, "lanes": 8}))
    assert target.clocks_mhz["sensor"] == 100
    prepare(target, tmp_path)
    pins = re.findall(r'SITE "(\w+)"', (tmp_path / "top.lpf").read_text())
    assert len(pins) == len(set(pins))
    text = (tmp_path / "top.il").read_text()
    assert text.count("cell \\IDDRX2F") == 9
    assert text.count("cell \\DELAYG") == 9
    assert "ECLK_CENTERED" in text


def test_a_sensor_on_pins_of_the_xem6310_has_its_timing_constrained(tmp_path):
    path = tmp_path / "pins.toml"
    path.write_text(XEM6310 + SENSOR)
    options = Options(pins=path, settings={"sensor": 1, "lanes": 4})
    prepare(find_target("camera", "xem6310", options), tmp_path)
    ucf = (tmp_path / "top.ucf").read_text()
    clock = re.search(r'OFFSET = IN 0.32 ns VALID 0.64 ns BEFORE "(\w+)" RISING;', ucf)[1]
    assert f'NET "{clock}" LOC=P3;' in ucf  # the constraint is on a pin that exists
    assert f'BEFORE "{clock}" FALLING;' in ucf
    path.write_text(XEM6310)
    with pytest.raises(TargetError, match="sensor_data"):
        find_target("camera", "xem6310", options)


@pytest.mark.parametrize("board", ["ulx3s-85f", "ulx3s-25f"])
def test_a_sensor_needs_pins(board):
    with pytest.raises(TargetError, match="no sensor"):
        find_target("camera", board, Options(settings={"sensor": 1}))


@pytest.mark.parametrize("settings", [{}, {"sums": 3}])
def test_memories_whose_collisions_do_not_matter_are_found(tmp_path, settings):
    options = Options(settings={"rows": 8, "cols": 8, "run": 8, "lanes": 4, **settings})
    prepare(find_target("camera", "ulx3s-85f", options), tmp_path)
    command = re.search("setparam -set COLLISION_X_MASK .*", (tmp_path / "top.ys").read_text())
    patterns = re.findall(r"(\S+)/t:\$memrd_v2", command[0])
    modules = re.split(r"^module \\", (tmp_path / "top.il").read_text(), flags=re.MULTILINE)
    reading = {text.split()[0] for text in modules if "cell $memrd_v2" in text}
    found = [{name for name in reading if fnmatchcase(name, pattern)} for pattern in patterns]
    assert all(found), "yosys only warns of a selection of nothing"
    core = {name for name in reading if ".reducer.core" in name and not name.endswith(".windows")}
    assert core <= set().union(*found)
    assert bool(core) == bool(settings)


@pytest.mark.slow
def test_the_same_source_makes_the_same_netlist(tmp_path):
    for name in ("one", "two"):
        prepare(find_target("camera", "ecpix5-85f"), tmp_path / name)
    for file in ("top.il", "top.lpf", "top.ys"):
        one, two = (tmp_path / name / file for name in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()
