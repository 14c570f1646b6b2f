# SPDX-License-Identifier: Apache-2.0
"""Drawn and dumped trains show what the pins do; jitter is what sampling theory says."""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from vcd.reader import TokenKind, tokenize

from hueflight_hdl.illuminator.gearing.ecp5 import Ecp5Gearing
from hueflight_hdl.illuminator.pulse_generator.reference import Pulse, Schedule
from hueflight_hdl.testbench import illuminator_waveform
from hueflight_hdl.testbench.cxxrtl import SimulationError
from hueflight_hdl.testbench.illuminator_waveform import (
    Waveform,
    draw,
    dump_train,
    record_train,
    write_save_file,
    write_vcd,
)
from hueflight_hdl.testbench.jitter import jitter_table, trigger_jitter
from hueflight_hdl.testbench.signal_dump import dump_signals, find_signals
from support.illuminator_stimuli import small_illuminator

DOCS = Path(__file__).parents[3] / "docs"


def read_vcd(path: Path) -> dict[str, list[tuple[int, str]]]:
    """Changes of each signal, in picoseconds."""
    names: dict[str, str] = {}
    changes: dict[str, list[tuple[int, str]]] = {}
    now = 0
    with path.open("rb") as file:
        for token in tokenize(file):
            if token.kind is TokenKind.VAR:
                names[token.data.id_code] = token.data.reference
                changes[token.data.reference] = []
            elif token.kind is TokenKind.CHANGE_TIME:
                now = token.data
            elif token.kind is TokenKind.CHANGE_SCALAR:
                changes[names[token.data.id_code]].append((now, token.data.value))
    return changes


@pytest.fixture(scope="module")
def small(simulator: None) -> Waveform:
    pulses = [[Pulse(24 * channel, 8)] + [Pulse(0, 0)] * 3 for channel in range(3)]
    return record_train(small_illuminator(4), Ecp5Gearing(), Schedule(256, 7, pulses), phase=3)


def test_the_save_file_shows_the_signals_of_the_dump(small: Waveform, tmp_path: Path):
    dump, save = tmp_path / "train.vcd", tmp_path / "train.gtkw"
    write_vcd(small, dump)
    write_save_file(small, dump, save)
    lines = save.read_text().splitlines()
    assert '[dumpfile] "train.vcd"' in lines
    shown = [line.removeprefix("illuminator.") for line in lines if line.startswith("illuminator.")]
    assert shown == list(read_vcd(dump)) == ["trigger", "armed", "led0", "led1", "led2"]


def test_the_dump_has_every_edge(small: Waveform, tmp_path: Path):
    write_vcd(small, tmp_path / "train.vcd")
    found = read_vcd(tmp_path / "train.vcd")
    tick_ps = 12_500  # 20 MHz, four lanes
    (trigger,) = [at for at, level in found["trigger"] if at and level == "1"]
    rises = [[at for at, level in found[f"led{k}"] if at and level == "1"] for k in range(3)]
    falls = [[at for at, level in found[f"led{k}"] if at and level == "0"] for k in range(3)]
    first = rises[0][0]
    assert rises == [[first + 24 * k * tick_ps] for k in range(3)]
    assert falls == [[first + (24 * k + 8) * tick_ps] for k in range(3)]
    # as late as gearing and pipeline say, to the tick
    assert (first - trigger) % (4 * tick_ps) == 0


def rises_of_the_trigger(dump: Path) -> list[int]:
    """Times at which the first signal of this name leaves 0."""
    text = dump.read_text()
    (code,) = re.findall(r"^\$var wire 4 (\S+) trigger \$end$", text, re.M)[:1]
    now, found = 0, []
    for line in text.splitlines():
        if line.startswith("#"):
            now = int(line[1:])
        elif re.match(rf"b0*1[01]* {re.escape(code)}$", line):
            found.append(now)
    return found


def test_the_dump_of_all_signals_has_those_within(simulator: None, tmp_path: Path):
    """Amaranth's simulator has the outputs of the compiled design; a train's pulses are within."""
    pulses = [[Pulse(24 * channel, 8)] + [Pulse(0, 0)] * 3 for channel in range(3)]
    dump, save = dump_train(tmp_path, small_illuminator(4), Ecp5Gearing(), Schedule(256, 7, pulses))
    lines = save.read_text().splitlines()
    shown = [line for line in lines if line.startswith("bench.top.")]
    assert {"bench.top.trigger", "bench.top.armed"} <= set(shown)
    inner = [name for name in shown if name.startswith("bench.top.core.generator.sequencer.")]
    assert len(inner) > 10
    assert set(shown) <= set(find_signals(dump, sorted({n.rpartition(".")[0] for n in shown})))
    start = next(
        int(line.split()[1]) for line in save.read_text().splitlines() if "timestart" in line
    )
    rises = rises_of_the_trigger(dump)
    assert rises
    assert 0 < start <= min(rises)  # the train is what the save file shows


def test_simulators_that_differ_are_an_error(
    simulator: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def flipped(*arguments, **options):
        levels = dump_signals(*arguments, **options)
        levels["armed"][100] ^= 1
        return levels

    monkeypatch.setattr(illuminator_waveform, "dump_signals", flipped)
    pulses = [[Pulse(0, 8)] + [Pulse(0, 0)] * 3] * 3
    with pytest.raises(SimulationError, match="the two simulators differ"):
        dump_train(tmp_path, small_illuminator(4), Ecp5Gearing(), Schedule(256, 7, pulses))


def test_the_drawing_says_when_each_led_fires(small: Waveform, tmp_path: Path):
    draw(small, tmp_path / "train.svg")
    root = ElementTree.parse(tmp_path / "train.svg").getroot()
    said = [text.text for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert [s for s in said if s and "+" in s] == [
        "0 + 100 ns",
        "300 + 100 ns",
        "600 + 100 ns",
    ]
    assert {"trigger", "LED 0", "LED 1", "LED 2"} <= set(said)


@pytest.mark.slow
def test_the_drawing_of_the_papers_train_is_in_the_docs(simulator: None, tmp_path: Path):
    """Table 1: 10 ns pulses every 30 ns."""
    draw(record_train(phase=2), tmp_path / "train.svg")
    drawn = (tmp_path / "train.svg").read_text()
    assert all(f">{30 * k} + 10 ns<" in drawn for k in range(9))
    assert drawn == (DOCS / "images" / "illuminator-train.svg").read_text()


def test_jitter_is_that_of_one_tick(simulator: None):
    """A uniform phase: peak to peak one tick, rms tick / √12 (2 % is six standard errors)."""
    found = trigger_jitter(lanes=4, tick_ns=1.25, synchronous=False, triggers=20_000)
    assert 1.24 < found.peak_to_peak_ns <= 1.25
    assert found.rms_ns == pytest.approx(1.25 / math.sqrt(12), rel=0.02)
    assert trigger_jitter(lanes=4, tick_ns=1.25, synchronous=True).peak_to_peak_ns < 1e-6


@pytest.mark.slow
def test_the_table_in_the_docs_is_what_the_simulation_gives(simulator: None):
    text = (DOCS / "illuminator.md").read_text()
    for line in jitter_table():
        assert line in text
