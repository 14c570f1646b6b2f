# SPDX-License-Identifier: Apache-2.0
"""Sizes and limits from the command line and from design files."""

import tomllib

import pytest

from hueflight_hdl.boards.ecp5_camera import camera_config
from hueflight_hdl.boards.ecp5_illuminator import ecp5_config
from hueflight_hdl.boards.settings import (
    BY_DESIGN,
    choose_illuminator,
    parse_settings,
    read_design_file,
)
from hueflight_hdl.boards.target import Options, TargetError
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.build import prepare
from hueflight_hdl.cli.options import read_options

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

CHOSEN = {
    "illuminator": {
        "channels": 4,
        "pulses": 2,
        "steps": 8,
        "max_on_ticks": 40,
        "duty_divisor": 16,
        "burst_ticks": 60,
        "baud": 115200,
        "serial": 0xBEEF,
        "reference_hz": 10_000_000,
        "fine_delay": 1,
    },
    "camera": {
        "rows": 64,
        "cols": 32,
        "code_bits": 12,
        "lanes": 4,
        "run": 256,
        "geometry": 7,
        "sensor": 1,
        "overlap": 0,
        "banks": 4,
        "buffer_words": 1024,
        "admit_words": 128,
        "sums": 11,
        "entry_bits": 4,
        "sum_bits": 12,
        "narrow_sums": 5,
        "serial": 5,
        "reference_hz": 25_000_000,
    },
}


@pytest.mark.parametrize("design", CHOSEN)
def test_every_setting_can_be_chosen(design):
    chosen = CHOSEN[design]
    assert set(chosen) == {setting.name for setting in BY_DESIGN[design]}
    options = Options(settings=chosen)
    assert find_target(design, "ecpix5-85f", options).settings == chosen
    if design == "illuminator":
        config = choose_illuminator(
            ecp5_config(), options, board="ulx3s-85f", leds=9, external_clock=True, fine_delay=True
        )
        registers = config.registers()
        capacity = {name: place.field.reset for name, place in registers["capacity"].fields.items()}
        assert capacity == {"channels": 4, "pulses": 2, "steps": 8, "lanes": 4}
        assert config.pulse.limit(3).max_on_ticks == 40
        assert (config.baud, config.serial) == (115200, 0xBEEF)
        assert config.reference_hz == 10_000_000
        assert registers["fine_step"].decode(registers["fine_step"].reset)["steps"] == 128
    else:
        config = camera_config(options)
        assert (config.form.rows, config.form.cols, config.form.lanes) == (64, 32, 4)
        assert config.scene is not None
        assert config.reduction is not None
        assert config.reduction.widths == (12,) * 6 + (11,) * 5
        assert config.registers()["reference_hz"].reset == 25_000_000


def test_a_design_file_is_written_and_read_again(tmp_path):
    options = Options(settings={"channels": 4, "serial": 12})
    prepare(find_target("illuminator", "hx8k", options), tmp_path)
    again = read_options(design_file=tmp_path / "design.toml", words=["serial=0x10"])
    target = find_target("illuminator", "hx8k", again)
    written = tomllib.loads((tmp_path / "design.toml").read_text())
    assert target.settings == {**written, "serial": 16}
    assert written["channels"] == 4
    assert written["pulses"] == 2  # the board's own


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["channels=33"], "channels = 33: must be from 1 to 32"),
        (["channels=12"], r"channels = 12: ulx3s-85f has 9 pins for LEDs \(led_pulse\)"),
        (["colours=4"], "no setting colours: choose from channels, pulses, steps"),
        (["pulses=two"], "pulses = 'two': must be a whole number"),
        (["pulses"], "--set pulses: must be NAME=VALUE"),
        (["pulses=1", "pulses=2"], "pulses is set twice"),
        (["max_on_ticks=2"], "is less than one clock"),
        (["baud=12000000"], "at most 6250000 baud"),
    ],
)
def test_refusals_say_what_fits(words, said):
    with pytest.raises(Exception, match=said) as caught:
        find_target("illuminator", "ulx3s-85f", read_options(words=words))
    assert type(caught.value).__name__ in ("TargetError", "ConfigError", "UartError")


def test_bits_of_sums_need_sums():
    for settings in ({"sum_bits": 9}, {"sums": 0, "entry_bits": 3}):
        with pytest.raises(TargetError, match="sums must be 1 or more"):
            find_target("camera", "ulx3s-85f", Options(settings=settings))


def test_lanes_are_not_set_twice(tmp_path):
    with pytest.raises(TargetError, match="--lanes 4: the settings say 2"):
        find_target("camera", "ulx3s-85f", Options(lanes=4, settings={"lanes": 2}))
    with pytest.raises(TargetError, match=r"absent\.toml"):
        read_design_file(tmp_path / "absent.toml")
    assert parse_settings([" steps = 4 "]) == {"steps": "4"}


@pytest.mark.parametrize("size", ["12f", "25f", "45f"])
def test_smaller_devices_of_a_board(size):
    target = find_target("illuminator", f"ulx3s-{size}")
    assert target.board == f"ulx3s-{size}"
    assert target.platform().device == f"LFE5U-{size.upper()}"
