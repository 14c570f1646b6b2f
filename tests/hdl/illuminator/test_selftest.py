# SPDX-License-Identifier: Apache-2.0
"""The self-test of the bench on the gateware in simulation, through its serial pins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hueflight.devices import DeviceError
from hueflight.devices.illuminator import Illuminator
from hueflight.devices.illuminator_selftest import (
    TRAINS,
    run_illuminator_selftest,
)
from hueflight.devices.skew import PERIOD_TICKS
from hueflight.devices.transports.replay import RecordingTransport, ReplayTransport
from hueflight.devices.transports.serial import SerialTransport
from hueflight_hdl.testbench.illuminator import IlluminatorTestbench
from hueflight_hdl.testbench.ticks import words_to_ticks
from hueflight_protocol.typed_registers import illuminator as registers
from hueflight_protocol.typed_registers.illuminator import TriggerPeriod

from .conftest import SMALL, WAIT_S

WORDS = 20  # on a simulated line


def test_the_gateware_passes_and_each_led_fires_alone(
    driver: Illuminator, bench: IlluminatorTestbench
):
    bench.record()
    results = run_illuminator_selftest(driver, words=WORDS)
    bench.recording = False
    assert [result.name for result in results] == [
        "clock",
        "line",
        *(f"LED {channel}" for channel in range(3)),
        "watchdog",
    ]
    assert all(result.passed for result in results), results
    levels = bench.levels()
    lit = levels.any(axis=1)
    assert lit.all()
    assert not (levels.sum(axis=0) > 1).any()  # one LED at a time
    for channel in levels:
        starts = np.flatnonzero(np.diff(channel.astype(np.int8)) > 0)
        assert channel.sum() == len(starts)  # a tick is longer than 10 ns here
        assert np.diff(starts).min() >= TriggerPeriod.VALUE_MAX
    assert not driver.state().armed


def test_leds_stay_off_if_asked(driver: Illuminator, bench: IlluminatorTestbench):
    bench.record()
    results = run_illuminator_selftest(driver, words=WORDS, leds=False)
    bench.recording = False
    assert [result.name for result in results] == ["clock", "line"]
    assert not bench.levels().any()


WIRE_CLOCKS = 16


def lead_trigger(bench: IlluminatorTestbench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lead the trigger output to the trigger input, by a wire of `WIRE_CLOCKS`."""
    advance, outputs = bench.advance, bench._simulation.run
    on_wire = np.zeros(WIRE_CLOCKS, np.uint8)

    def run(records: np.ndarray) -> np.ndarray:
        seen = outputs(records)
        on_wire[:] = seen["trigger_out"]
        return seen

    def piecewise(clocks: int) -> bytes:
        return b"".join(advance(WIRE_CLOCKS) for _ in range(clocks // WIRE_CLOCKS))

    monkeypatch.setattr(bench._simulation, "run", run)
    monkeypatch.setattr(bench, "advance", piecewise)
    bench.trigger = lambda clock, clocks: on_wire


def test_a_trigger_goes_round_with_all_leds_off(
    driver: Illuminator, bench: IlluminatorTestbench, monkeypatch: pytest.MonkeyPatch
):
    lead_trigger(bench, monkeypatch)
    bench.record()
    driver.set_trigger_out(400, 100)
    before = driver.board.read(registers.TriggerOut)
    results = run_illuminator_selftest(driver, words=1, leds=False, loop=True)
    bench.recording = False
    assert driver.board.read(registers.TriggerOut) == before
    assert [result.name for result in results] == ["clock", "line", "trigger loop"]
    assert results[-1].passed, results[-1]
    assert not bench.levels().any()
    assert not driver.state().busy  # it has ended with the test
    # from one turn to the next: trigger-out, wire, and the board's own latency
    outputs = words_to_ticks(
        bench.recorded()["trigger_out"][:, None], lanes=SMALL.pulse.lanes, signals=1
    )[0]
    turns = np.diff(np.flatnonzero(np.diff(outputs.astype(np.int8)) > 0))
    lanes = SMALL.pulse.lanes
    expected = PERIOD_TICKS - 2 * lanes + lanes * (WIRE_CLOCKS + bench.latency_clocks)
    assert np.count_nonzero(turns == expected) >= TRAINS


@pytest.mark.parametrize("fault", ["no wire", "double edges"])
def test_a_trigger_that_is_lost_or_doubled_is_told(
    driver: Illuminator, bench: IlluminatorTestbench, monkeypatch: pytest.MonkeyPatch, fault: str
):
    if fault == "double edges":
        lead_trigger(bench, monkeypatch)
        led = bench.trigger
        assert led is not None
        once = iter(range(1 << 30))

        def doubled(clock: int, clocks: int) -> np.ndarray:
            word = led(clock, clocks).copy()
            if word.any() and next(once) >= 4:
                word[-1] = 0b1010  # rings at the end of a pulse
            return word

        bench.trigger = doubled
    results = run_illuminator_selftest(driver, words=1, leds=False, loop=True)
    assert not results[-1].passed
    assert ("ended" if fault == "no wire" else "triggers ignored") in results[-1].measured
    assert " 0 triggers ignored" in results[-1].measured or fault != "no wire"


def test_a_line_that_loses_bits_fails(driver: Illuminator, bench: IlluminatorTestbench):
    number = iter(range(1_000_000))
    written = bench.write

    def damaged(data: bytes) -> None:
        spoiled = bytes([data[0], data[1] ^ 1, *data[2:]]) if next(number) in (20, 26, 33) else data
        written(spoiled)

    impatient = Illuminator(SerialTransport(bench), timeout_s=0.5)
    bench.write = damaged
    try:
        results = run_illuminator_selftest(impatient, words=WORDS, leds=False)
    finally:
        bench.write = written
    assert not next(result for result in results if result.name == "line").passed


def test_a_failure_of_the_clock_is_told(driver: Illuminator, bench: IlluminatorTestbench):
    bench.clock_failed = lambda clock, count: np.arange(count) < 400
    bench.advance(1000)
    bench.clock_failed = None
    bench.advance(1000)
    results = run_illuminator_selftest(driver, words=1, leds=False)
    assert not results[0].passed
    assert results[0].measured == "1 failures"


def test_an_armed_board_is_left_alone(driver: Illuminator):
    driver.arm(watchdog_ms=1000)
    with pytest.raises(DeviceError, match="is armed"):
        run_illuminator_selftest(driver)
    assert driver.state().armed


def test_recorded_transactions_replay(bench: IlluminatorTestbench, tmp_path: Path):
    path = tmp_path / "selftest.jsonl"
    Illuminator(SerialTransport(bench), timeout_s=WAIT_S).disarm()
    line = RecordingTransport(SerialTransport(bench), path)
    recorded = run_illuminator_selftest(Illuminator(line, timeout_s=WAIT_S), words=5, leds=False)
    line.close()
    again = Illuminator(ReplayTransport(path))
    assert run_illuminator_selftest(again, words=5, leds=False) == recorded
    with pytest.raises(DeviceError, match="no message that was sent was recorded"):
        again.state()
    with pytest.raises(DeviceError, match="is sent, but"):
        run_illuminator_selftest(Illuminator(ReplayTransport(path)), words=6, leds=True)
    path.write_text("{")
    with pytest.raises(DeviceError, match="recorded transactions"):
        ReplayTransport(path)
