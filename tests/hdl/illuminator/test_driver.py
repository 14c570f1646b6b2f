# SPDX-License-Identifier: Apache-2.0
"""The host's driver on the gateware's serial pins: what is asked for is what the LEDs do."""

from __future__ import annotations

import numpy as np
import pytest

from hueflight.devices import RequestError, WrongDeviceError
from hueflight.devices.illuminator import Illuminator
from hueflight.devices.pulse_schedule import ChannelPulse, PulseSchedule, ScheduleError
from hueflight.devices.sequencer_program import ProgramStep, alternate, each_alone
from hueflight.devices.transports.serial import SerialTransport
from hueflight_hdl.illuminator.pulse_generator.generator import PulseGenerator
from hueflight_hdl.testbench.illuminator import IlluminatorTestbench
from hueflight_hdl.testbench.ticks import ticks_to_words
from hueflight_protocol.illuminator_map import ARM_KEY, Advance, TriggerSource
from hueflight_protocol.typed_registers import illuminator as registers

from .conftest import SMALL

TICK_NS = 12.5  # 20 MHz, four lanes
THREE = PulseSchedule.even(3, spacing_ns=24 * TICK_NS, width_ns=8 * TICK_NS, period_ns=3200)


def edges(level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ticks where a level rises and where it falls."""
    change = np.diff(np.concatenate(([0], level.astype(int))))
    return np.flatnonzero(change > 0), np.flatnonzero(change < 0)


def test_identity_and_capacity(driver: Illuminator):
    assert driver.identity.board == "HILL"
    assert driver.identity.serial == "000000000000BEEF"
    assert driver.identity.clock_hz == 20_000_000
    capacity = driver.capacity
    assert (capacity.channels, capacity.pulses, capacity.steps, capacity.lanes) == (3, 2, 4, 4)
    assert capacity.tick_ns == TICK_NS
    assert {limit.on_ticks for limit in capacity.limits} == {80}


def test_leds_are_dark_until_armed(driver: Illuminator, bench: IlluminatorTestbench):
    driver.play(THREE)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=3200)
    bench.record()
    bench.advance(5000)
    assert driver.counters().served > 50
    assert not bench.levels().any()
    assert not bench.recorded()["armed"].any()
    driver.arm(watchdog_ms=50)
    bench.record()
    bench.advance(1000)
    assert bench.recorded()["armed"].all()
    assert bench.levels().any(axis=1).all()
    driver.disarm()
    bench.record()
    bench.advance(1000)
    assert not bench.levels().any()


def test_the_schedule_is_what_the_pins_do(driver: Illuminator, bench: IlluminatorTestbench):
    """An external trigger at a known tick; edges at its tick, the delay and the latency."""
    made = driver.play(THREE)
    assert made.delay_error_ns == made.width_error_ns == 0
    driver.set_trigger(TriggerSource.EXTERNAL)
    driver.arm(watchdog_ms=1000)
    driver.clear()
    ticks = np.zeros(4 * 4000, bool)
    starts = [400 + 259 * number for number in range(50)]
    for start in starts:
        ticks[start : start + 5] = True
    words = ticks_to_words(ticks, lanes=4)
    begin = bench.clock
    bench.trigger = lambda clock, count: np.concatenate((words, np.zeros(count, np.uint32)))[
        clock - begin : clock - begin + count
    ]
    bench.record()
    bench.advance(4000)
    bench.trigger = None
    for channel, level in enumerate(bench.levels()):
        rises, falls = edges(level)
        wanted = np.array(starts) + 24 * channel + 4 * bench.latency_clocks
        assert rises.tolist() == wanted.tolist()
        assert falls.tolist() == (wanted + 8).tolist()
    found = driver.phases()
    assert found.counts == tuple(sum(s % 4 == lane for s in starts) for lane in range(4))
    assert (found.smallest, found.largest, found.last) == (0, 3, starts[-1] % 4)
    counters = driver.counters()
    assert (counters.seen, counters.served, counters.ignored) == (50, 50, 0)
    driver.clear()
    assert driver.board.read(registers.Phase) == registers.Phase()


def test_the_state_tells_whether_a_train_runs(driver: Illuminator):
    driver.play(THREE)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=1600, restart=True)  # before it ends
    assert driver.state().busy
    driver.set_trigger(TriggerSource.SOFTWARE)
    assert not driver.state().busy


def test_ignored_triggers_and_restarts_are_counted(
    driver: Illuminator, bench: IlluminatorTestbench
):
    driver.play(THREE)
    driver.set_trigger(TriggerSource.EXTERNAL)
    # a trigger every 20 clocks; a train lasts 63
    pulse = np.array([15, 0], np.uint32).repeat([2, 18])
    bench.trigger = lambda clock, count: np.resize(np.roll(pulse, -(clock % 20)), count)
    bench.advance(4000)
    bench.trigger = None
    counters = driver.counters()
    assert counters.seen >= 200
    assert counters.served + counters.ignored == counters.seen
    assert counters.served == pytest.approx(counters.seen / 4, abs=2)
    assert driver.faults().trigger_ignored
    driver.set_trigger(TriggerSource.EXTERNAL, restart=True)
    driver.clear()
    bench.trigger = lambda clock, count: np.resize(np.roll(pulse, -(clock % 20)), count)
    bench.advance(4000)
    bench.trigger = None
    counters = driver.counters()
    assert counters.ignored == 0
    assert counters.restarts == counters.served - 1
    assert not driver.faults().trigger_ignored


def test_a_bank_in_use_can_not_be_written(driver: Illuminator, bench: IlluminatorTestbench):
    """Not while armed; the other one can, and a swap then frees the first."""
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=3200)
    driver.load(THREE, bank=0)
    driver.select(0)
    bench.advance(1000)
    driver.arm(watchdog_ms=1000)
    with pytest.raises(RequestError, match="REFUSED"):
        driver.load(THREE, bank=0)
    moved = PulseSchedule(tuple((ChannelPulse(100.0 + 500 * k, 100),) for k in range(3)), 3200)
    swaps = driver.counters().swaps
    driver.load(moved, bank=1)
    driver.select(1)
    with pytest.raises(RequestError, match="REFUSED"):
        driver.load(moved, bank=1)
    bench.advance(1000)
    state = driver.state()
    assert (state.bank, state.swap_pending) == (1, False)
    assert driver.counters().swaps == swaps + 1
    driver.load(THREE, bank=0)
    bench.record()
    bench.advance(500)
    rises = [edges(level)[0] for level in bench.levels()]
    assert (rises[1][1:4] - rises[0][1:4] == 40).all()
    driver.disarm()
    driver.load(THREE, bank=1)


def test_the_watchdog_disarms(driver: Illuminator, bench: IlluminatorTestbench):
    """Feeding keeps it armed; silence does not, to the millisecond."""
    driver.play(THREE)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=3200)
    clocks_per_ms = 20_000
    driver.arm(watchdog_ms=3)
    assert driver.board.read(registers.WatchdogLeftMs).value in (2, 3)
    driver.feed()
    for _ in range(4):
        bench.advance(2 * clocks_per_ms)
        assert driver.state().armed
        driver.feed()
    bench.record()
    bench.advance(5 * clocks_per_ms)
    armed = bench.recorded()["armed"]
    left = int(np.flatnonzero(armed == 0)[0])
    assert 2 * clocks_per_ms < left <= 3 * clocks_per_ms
    assert not bench.levels()[:, 4 * (left + 4) :].any()
    assert driver.faults().watchdog
    assert not driver.state().armed
    driver.feed()  # does not arm
    assert not driver.state().armed
    assert driver.board.read(registers.WatchdogLeftMs).value == 0


def test_a_failed_clock_disarms_and_is_reported(driver: Illuminator, bench: IlluminatorTestbench):
    driver.play(THREE)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=3200)
    driver.arm(watchdog_ms=1000)
    failures = driver.faults().clock_failures
    begin = bench.clock + 400
    end = begin + 64

    def fails(first: int, clocks: int) -> np.ndarray:
        clock = np.arange(first, first + clocks)
        return ((clock >= begin) & (clock < end)).astype(np.uint8)

    bench.clock_failed = fails
    bench.record()
    bench.advance(2000)
    bench.clock_failed = None
    levels = bench.levels()
    lanes = bench.config.pulse.lanes
    assert levels[:, : 400 * lanes].any(axis=1).all()
    assert not levels[:, 400 * lanes :].any()
    assert not driver.state().armed
    faults = driver.faults()
    assert faults.clock_failed
    assert not faults.watchdog
    assert faults.clock_failures == failures + 1
    driver.clear()
    faults = driver.faults()
    assert not faults.clock_failed
    assert faults.clock_failures == failures + 1
    driver.arm(watchdog_ms=1000)
    bench.record()
    bench.advance(1000)
    assert bench.levels().any(axis=1).all()


def test_a_watchdog_of_no_time_keeps_it_disarmed(driver: Illuminator):
    driver.board.write(registers.WatchdogMs(0))
    driver.board.write(registers.Arm(ARM_KEY))
    assert not driver.state().armed
    driver.arm(watchdog_ms=1000)
    assert driver.state().armed
    driver.board.write(registers.WatchdogMs(0))
    assert not driver.state().armed


def test_anything_but_the_key_disarms(driver: Illuminator):
    for word in (0, 1, ARM_KEY - 1, 0xFFFFFFFF):
        driver.arm(watchdog_ms=1000)
        assert driver.state().armed
        driver.board.write(registers.Arm(word))
        assert not driver.state().armed


def test_programs(driver: Illuminator, bench: IlluminatorTestbench):
    """Each LED alone, by trains; then both schedules in turn by frame syncs of the camera."""
    driver.disarm()
    driver.load(THREE, bank=0)
    moved = PulseSchedule(tuple((ChannelPulse(50.0 + 300 * k, 100),) for k in range(3)), 3200)
    driver.load(moved, bank=1)
    driver.select(0)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=3200)
    driver.arm(watchdog_ms=1000)
    bench.record()
    driver.run(each_alone(3, 40))
    bench.advance(64 * 150)
    levels = bench.levels()
    markers = bench.recorded()["marker"]
    assert not driver.state().sequencing
    assert markers.max() == 2
    alone = np.diff(levels[2].astype(int)).clip(0)
    clocks = np.flatnonzero(markers == 2)
    within = slice(4 * int(clocks[0] + 30), 4 * int(clocks[-1]))
    assert alone[within].sum() in range(38, 41)
    assert not levels[:2, within].any()

    frame = np.zeros(2000, np.uint32)
    frame[:4] = 1
    bench.frame_sync = lambda clock, count: np.resize(np.roll(frame, -(clock % 2000)), count)
    driver.run(alternate(), advance=Advance.FRAME_SYNC, loop=True)
    bench.advance(4000)
    bench.record()
    bench.advance(20_000)
    markers = bench.recorded()["marker"]
    lengths = np.diff(np.flatnonzero(np.diff(markers.astype(int))))
    assert set(np.unique(markers)) == {0, 1}
    assert (abs(lengths - 2000) <= 64).all()  # a frame, to the train
    state = driver.state()
    assert state.sequencing
    driver.stop(timeout_s=60)


def test_a_bank_that_a_program_will_use_can_not_be_written(
    driver: Illuminator, bench: IlluminatorTestbench
):
    """Not even while another bank is in use and selected."""
    driver.load(THREE, bank=0)
    driver.load(THREE, bank=1)
    driver.select(0)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=3200)
    driver.arm(watchdog_ms=1000)
    driver.run(alternate(), advance=Advance.FRAME_SYNC, loop=True)
    bench.advance(1000)
    state = driver.state()
    assert (state.sequencing, state.bank) == (True, 0)
    with pytest.raises(RequestError, match="REFUSED"):
        driver.load(THREE, bank=1)
    driver.disarm()


def test_steps_that_can_not_be(driver: Illuminator):
    with pytest.raises(ScheduleError, match="5 steps: the board takes 1 to 4"):
        driver.run([ProgramStep(1)] * 5)
    with pytest.raises(ScheduleError, match="step 0: channel = 3 is not from 0 to 2"):
        driver.run([ProgramStep(1, channels=frozenset({3}))])
    with pytest.raises(ScheduleError, match="step 1: marker = 256"):
        driver.run([ProgramStep(1), ProgramStep(1, marker=256)])


def test_a_software_trigger_starts_one_train(driver: Illuminator, bench: IlluminatorTestbench):
    driver.play(THREE)
    driver.set_trigger(TriggerSource.SOFTWARE)
    driver.arm(watchdog_ms=1000)
    driver.clear()
    bench.record()
    for _ in range(3):
        driver.trigger_now()
    bench.advance(300)
    assert driver.counters().served == 3
    assert [len(edges(level)[0]) for level in bench.levels()] == [3, 3, 3]


def test_the_trigger_out_follows(driver: Illuminator, bench: IlluminatorTestbench):
    """In its place relative to the LEDs, and not gated by arming."""
    driver.play(THREE)
    driver.set_trigger_out(10 * TICK_NS, 200 * TICK_NS)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=(256 + 3) * TICK_NS, output=True)
    bench.advance(1000)
    bench.record()
    bench.advance(2000)
    words = bench.recorded()["trigger_out"]
    level = (words[:, None] >> np.arange(4) & 1).reshape(-1).astype(bool)
    rises, falls = edges(level)
    assert set(np.diff(rises[1:])) == {259}  # the first may have begun before
    assert set(falls[1:] - rises[1 : len(falls)]) == {200}
    driver.arm(watchdog_ms=1000)
    bench.record()
    bench.advance(2000)
    words = bench.recorded()["trigger_out"]
    rises, _ = edges((words[:, None] >> np.arange(4) & 1).reshape(-1).astype(bool))
    first, _ = edges(bench.levels()[0])
    assert rises[1] - 10 in first.tolist()


def test_what_the_limiter_cuts_is_said(driver: Illuminator, bench: IlluminatorTestbench):
    """Registers written behind the driver's back, which would have refused."""
    greedy = PulseSchedule(((ChannelPulse(0, 90 * TICK_NS),),), 3200)
    with pytest.raises(ScheduleError, match="channel 0: on for 1125 ns, the LED bears 1000 ns"):
        driver.play(greedy)
    driver.load(THREE, bank=0)
    driver.select(0)
    driver.board.write(registers.Pulse(delay=0, width=90), 0, 0, 0)
    driver.board.write(registers.Pulse(delay=0, width=70), 0, 1, 0)
    driver.board.write(registers.Pulse(delay=72, width=70), 0, 1, 1)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=2048 * TICK_NS)
    driver.arm(watchdog_ms=1000)
    bench.advance(2000)
    driver.clear()
    bench.record()
    bench.advance(4000)
    faults = driver.faults()
    assert faults.on_limited == {0}
    assert faults.duty_limited == {1}
    cut, held, good = bench.levels()
    rises, falls = edges(cut)
    assert set(falls[1:] - rises[1 : len(falls)]) == {80}
    assert set(np.diff(rises[1:])) == {2048}
    # 70 ticks pass, then as many of the next as 80 ticks and an eighth of the time allow
    rises, falls = edges(held)
    widths = falls[2:8] - rises[2 : len(falls)][:6]
    # (80 + (72 + w) / 8 = 70 + w gives w = 21.7, less what is left of a clock at either end,
    # less three ticks' worth of an eighth at either end)
    short, whole = sorted(set(widths))
    assert whole == 70
    assert 21.7 - 4 - 0.75 < short <= 21.7
    assert driver.faults().on_limited == {0}
    assert len(edges(good)[0]) == len(edges(cut)[0])
    driver.play(THREE)
    bench.advance(2000)
    driver.clear()
    bench.advance(2000)
    assert not driver.faults().on_limited
    assert not driver.faults().duty_limited


def test_noise_on_the_line_changes_nothing(driver: Illuminator, bench: IlluminatorTestbench):
    """Random levels, then the driver goes on as if nothing had been."""
    driver.play(THREE)
    driver.set_trigger(TriggerSource.INTERNAL, period_ns=3200)
    driver.arm(watchdog_ms=1000)
    kept = (
        registers.WatchdogMs,
        registers.Trigger,
        registers.TriggerPeriod,
        registers.BankSelect,
        registers.Scratch,
        registers.Sequencer,
    )
    before = [driver.board.read(register) for register in kept]
    errors = driver.board.read(registers.RequestErrors)
    rng = np.random.default_rng(7)
    for density in (0.02, 0.1, 0.5):
        bench.write_levels((rng.random(30_000) > density).repeat(int(rng.integers(1, 9))))
        bench.write_levels(np.ones(400))
    assert [driver.board.read(register) for register in kept] == before
    after = driver.board.read(registers.RequestErrors)
    assert after.framing + after.crc > errors.framing + errors.crc
    assert driver.state().armed


def test_another_board_is_told_apart(bench: IlluminatorTestbench):
    class Stranger:
        name = "somewhere"

        def send(self, message: bytes, /) -> None:
            transport.send(message)

        def receive(self, timeout_s: float, /) -> bytes | None:
            from dataclasses import replace

            from hueflight_protocol import decode_response, encode_response

            message = transport.receive(timeout_s)
            assert message is not None
            response = decode_response(message)
            return encode_response(replace(response, payload=(1, *response.payload[1:])))

        def close(self) -> None: ...

    transport = SerialTransport(bench)
    with pytest.raises(WrongDeviceError, match="not 'HILL'"):
        Illuminator(Stranger(), timeout_s=60)


def test_the_filter_of_the_trigger(driver: Illuminator, bench: IlluminatorTestbench):
    """A glitch starts a train without the filter only; a true edge comes later, by whole clocks."""
    driver.play(THREE)
    driver.arm(watchdog_ms=1000)
    start = 4 * 40
    glitch = np.zeros(4 * 400, bool)
    glitch[start : start + 3] = True
    edge = np.zeros(4 * 400, bool)
    edge[start : start + 60] = True
    firsts = {}
    for filter_ns in (0.0, 3.5 * TICK_NS):
        driver.set_trigger(TriggerSource.EXTERNAL, filter_ns=filter_ns)
        for name, level in (("glitch", glitch), ("edge", edge)):
            words = np.concatenate((ticks_to_words(level, lanes=4), np.zeros(400, np.uint32)))
            begin = bench.clock
            bench.trigger = lambda clock, count, words=words, begin=begin: words[
                clock - begin : clock - begin + count
            ]
            bench.record()
            bench.advance(400)
            bench.trigger = None
            rises, _ = edges(bench.levels()[0])
            firsts[name, filter_ns] = rises.tolist()
    assert firsts["glitch", 3.5 * TICK_NS] == []
    (direct,) = firsts["edge", 0.0]
    assert firsts["glitch", 0.0] == [direct]
    assert firsts["edge", 3.5 * TICK_NS] == [direct + 4 * PulseGenerator.filter_clocks(SMALL.pulse)]
    assert driver.board.read(registers.TriggerFilter).width == 4  # rounded up
    driver.set_trigger(TriggerSource.EXTERNAL)
    assert driver.board.read(registers.TriggerFilter).width == 4
    driver.set_trigger(TriggerSource.EXTERNAL, filter_ns=0)
    for wrong in (-1.0, 8.1 * TICK_NS):
        with pytest.raises(ScheduleError, match=r"must be from 0 to 100 ns"):
            driver.set_trigger(TriggerSource.EXTERNAL, filter_ns=wrong)
