# SPDX-License-Identifier: Apache-2.0
"""Boards: pins that exist once, pins that must be told, and messages that say what there is."""

import re

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


@pytest.mark.slow
def test_the_same_source_makes_the_same_netlist(tmp_path):
    for name in ("one", "two"):
        prepare(find_target("camera", "ecpix5-85f"), tmp_path / name)
    for file in ("top.il", "top.lpf", "top.ys"):
        one, two = (tmp_path / name / file for name in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()
