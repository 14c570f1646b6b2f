# SPDX-License-Identifier: Apache-2.0
"""PLLs with the settings that builds have make their clocks; with other settings they do not."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.build import prepare
from hueflight_hdl.testbench.pin_events import PinBench

ICE40 = """
module top (input clock, output made, half, locked);
    SB_PLL40_2F_CORE #(
        .FEEDBACK_PATH("SIMPLE"), .PLLOUT_SELECT_PORTA("GENCLK"),
        .PLLOUT_SELECT_PORTB("GENCLK_HALF"),
        .DIVR({DIVR}), .DIVF({DIVF}), .DIVQ({DIVQ}), .FILTER_RANGE({FILTER_RANGE})
    ) pll (
        .REFERENCECLK(clock), .RESETB(1'b1), .BYPASS(1'b0),
        .PLLOUTGLOBALA(made), .PLLOUTGLOBALB(half), .LOCK(locked)
    );
endmodule
"""
HALF_PS = 41_667  # of 12 MHz


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """Settings of the PLL in the HX8K's design."""
    folder: Path = tmp_path_factory.mktemp("hx8k")
    prepare(find_target("illuminator", "hx8k"), folder)
    text = (folder / "top.il").read_text()
    return {
        name: int(re.search(rf"parameter \\{name} \d+'([01]+)", text)[1], 2)
        for name in ("DIVR", "DIVF", "DIVQ", "FILTER_RANGE")
    }


def run(settings: dict[str, int]) -> tuple[bool, float]:
    """Return whether the PLL locks, and the period that it makes, in ps."""
    bench = PinBench(
        ICE40.format(**settings),
        {"clock": 1},
        {"made": 1, "half": 1, "locked": 1},
        family="ice40",
    )
    changes = bench.run([(HALF_PS * n, n & 1) for n in range(1, 800)])
    bench.close()
    levels = [word & 1 for _, word in changes]
    pairs = zip(changes, levels[1:], levels, strict=False)
    rising = [time for (time, _), now, before in pairs if before < now][-200:]
    return bool(changes[-1][1] & 4), (rising[-1] - rising[0]) / (len(rising) - 1)


def test_the_settings_of_the_hx8k_make_its_clock(verilator, settings):
    locked, period = run(settings)
    assert locked
    assert period == pytest.approx(1e6 / 100.5, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [("DIVF", 63), ("DIVF", 31), ("DIVQ", 2), ("DIVR", 1), ("FILTER_RANGE", 2)],
)
def test_other_settings_lock_not_or_make_another_clock(verilator, settings, name, value):
    assert settings[name] != value
    locked, period = run({**settings, name: value})
    assert not locked or period != pytest.approx(1e6 / 100.5, rel=1e-3)
