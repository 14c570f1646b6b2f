# SPDX-License-Identifier: Apache-2.0
"""Exposures, triggers and frame syncs, to the clock."""

import numpy as np
import pytest
from amaranth.sim import Simulator

from hueflight_hdl.camera.exposure.control import ExposureControl

READOUT = 7
SETTINGS = {
    "period": 10,
    "periods": 3,
    "gap": 5,
    "frame_limit": 0,
    "trigger_width": 2,
    "sync_width": 4,
}
SEEN = ("trigger", "frame_sync", "expose", "read", "began", "ended", "running", "give_up")


def run(script, *, clocks=400, readout=READOUT, **settings):
    """Run a script of {clock: {signal: value}}; return what was seen, per clock."""
    dut = ExposureControl()
    seen = {name: [] for name in (*SEEN, "frame", "step", "timestamp", "now", "periods")}

    async def host(ctx):
        ctx.set(dut.settings, SETTINGS | settings)
        ctx.set(dut.ready, 1)
        reads = []
        for clock in range(clocks):
            for name in ("start", "stop", "abort"):
                ctx.set(getattr(dut, name), 0)
            for name, value in script.get(clock, {}).items():
                ctx.set(getattr(dut, name), value)
            over = any(clock == read + readout for read in reads)
            gives_up = ctx.get(dut.give_up) and reads and clock < reads[-1] + readout
            ctx.set(dut.read_done, bool(over or gives_up))
            if gives_up:
                reads.clear()
            for name, values in seen.items():
                values.append(ctx.get(getattr(dut, name)))
            if seen["read"][-1]:
                reads.append(clock)
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(host)
    simulator.run()
    return {name: np.array(values) for name, values in seen.items()}


OVERLAP = pytest.mark.parametrize("overlap", [0, 1], ids=["in turn", "overlapped"])


def edges(level):
    """First clocks in which a level is high, and the clocks for which it stays."""
    rise = np.flatnonzero(np.diff(np.concatenate([[0], level])) == 1)
    fall = np.flatnonzero(np.diff(np.concatenate([level, [0]])) == -1) + 1
    return rise, fall - rise


def test_triggers_begin_the_periods_of_an_exposure():
    seen = run({5: {"start": 1}})
    exposures, lengths = edges(seen["expose"])
    triggers, widths = edges(seen["trigger"])
    syncs, sync_widths = edges(seen["frame_sync"])
    assert len(exposures) > 5
    assert set(lengths[:-1]) == {30}
    assert set(widths[:-1]) == {2}
    assert set(sync_widths[:-1]) == {4}
    # outputs come from a register behind the counter: two clocks
    expected = np.concatenate([exposures + 10 * k + 2 for k in range(3)])
    np.testing.assert_array_equal(np.sort(expected)[: len(triggers) - 3], triggers[:-3])
    np.testing.assert_array_equal(syncs[:-1], exposures[: len(syncs) - 1] + 2)


def test_frames_are_evenly_spaced_and_numbered():
    seen = run({5: {"start": 1}})
    exposures, _ = edges(seen["expose"])
    reads = np.flatnonzero(seen["read"])
    assert set(np.diff(exposures)) == {30 + 1 + READOUT + 5 + 1}
    np.testing.assert_array_equal(reads, exposures[: len(reads)] + 30)
    np.testing.assert_array_equal(seen["frame"][reads], np.arange(len(reads)))
    assert told_right(seen)


def told_right(seen):
    """Whether timestamps and periods are those of the exposure that is read, for each readout."""
    exposures, _ = edges(seen["expose"])
    reads = np.flatnonzero(seen["read"])[:-1]
    after = reads + 1  # the earliest that codes can come
    # the timestamp is the device clock in the exposure's first clock
    begun = seen["now"][exposures[: len(reads)]]
    return (seen["timestamp"][after] == begun).all() and set(seen["periods"][after]) == {3}


@pytest.mark.parametrize(
    ("readout", "gap", "spacing"),
    [
        (7, 0, 30 + 3),  # the exposure takes longer
        (30, 0, 30 + 3),
        (32, 0, 30 + 3),  # just as long
        (50, 0, 50 + 1),  # the readout takes longer
        (7, 5, 30 + 2 + 5),
        (50, 12, 50 + 1),  # a pause that the readout hides
    ],
)
def test_readouts_overlap_exposures(readout, gap, spacing):
    seen = run({5: {"start": 1}}, readout=readout, overlap=1, gap=gap)
    exposures, lengths = edges(seen["expose"])
    reads = np.flatnonzero(seen["read"])
    assert len(reads) > 4
    assert set(lengths[:-1]) == {30}
    assert set(np.diff(reads[1:])) == {spacing}
    # a readout begins behind its exposure, never before the one before it is over
    assert (reads >= (exposures + 30)[: len(reads)]).all()
    assert (reads[:-1] < exposures[1 : len(reads)]).all()
    assert min(np.diff(reads)) > readout
    np.testing.assert_array_equal(seen["frame"][reads], np.arange(len(reads)))
    assert told_right(seen)


@OVERLAP
def test_limit(overlap):
    seen = run({5: {"start": 1}}, frame_limit=4, overlap=overlap)
    assert seen["read"].sum() == 4
    assert seen["ended"].sum() == 1
    assert seen["frame"][-1] == 4
    assert not seen["running"][-1]


@OVERLAP
def test_stop_ends_after_the_present_frame(overlap):
    seen = run({5: {"start": 1}, 120: {"stop": 1}}, overlap=overlap)
    assert seen["ended"].sum() == 1
    last_read = np.flatnonzero(seen["read"])[-1]
    assert last_read > 120
    assert np.flatnonzero(seen["ended"])[0] == last_read + READOUT + 1
    assert seen["frame"][-1] == seen["read"].sum()


@OVERLAP
@pytest.mark.parametrize("clock", range(30, 84, 3))
def test_abort_ends_at_once_in_every_state(clock, overlap):
    seen = run({5: {"start": 1}, clock: {"abort": 1}}, clocks=150, overlap=overlap)
    assert seen["ended"].sum() == 1
    assert np.flatnonzero(seen["ended"])[0] <= clock + 4
    assert not seen["expose"][clock + 4 :].any()


@OVERLAP
@pytest.mark.parametrize("clock", range(30, 84, 3))
def test_start_begins_anew_in_every_state(clock, overlap):
    seen = run({5: {"start": 1}, clock: {"start": 1}}, clocks=300, overlap=overlap)
    assert seen["began"].sum() == 2
    assert seen["ended"].sum() == 1
    second = np.flatnonzero(seen["began"])[1]
    reads = np.flatnonzero(seen["read"])
    reads = reads[reads > second]
    np.testing.assert_array_equal(seen["frame"][reads], np.arange(len(reads)))


def test_a_start_waits_until_the_last_capture_has_been_told_of():
    seen = run({0: {"ready": 0}, 5: {"start": 1}, 60: {"ready": 1}}, clocks=100)
    assert np.flatnonzero(seen["began"]).tolist() == [60]


@pytest.mark.parametrize("how", ["stop", "abort"])
@pytest.mark.parametrize("clock", [6, 30, 59, 60])
def test_a_start_that_waits_can_be_called_off(how, clock):
    script = {0: {"ready": 0}, 5: {"start": 1}, clock: {how: 1}}
    script[60] = script.get(60, {}) | {"ready": 1}
    seen = run(script, clocks=100)
    assert not seen["began"].any()


def test_triggers_between_exposures():
    seen = run({5: {"start": 1}}, trigger_always=1)
    triggers, _ = edges(seen["trigger"])
    assert set(np.diff(triggers)) == {10}
    exposures, lengths = edges(seen["expose"])
    assert set(lengths[:-1]) == {30}
    assert set(exposures % 10) == {exposures[0] % 10}
    assert set(triggers % 10) == {(exposures[0] + 2) % 10}


def test_inverted_trigger():
    high = run({5: {"start": 1}})["trigger"]
    low = run({5: {"start": 1}}, trigger_inverted=1)["trigger"]
    np.testing.assert_array_equal(high[1:], 1 - low[1:])


@OVERLAP
@pytest.mark.parametrize(
    ("settings", "length"),
    [({"period": 0}, 3), ({"period": 1}, 3), ({"periods": 0}, 0), ({"periods": 1, "gap": 0}, 10)],
)
def test_odd_settings_do_not_hang(settings, length, overlap):
    seen = run({5: {"start": 1}}, overlap=overlap, **settings)
    assert seen["read"].sum() > 5
    assert set(edges(seen["expose"])[1][:-1]) <= {length}


def test_step_is_the_marker_at_the_end_of_the_exposure():
    changes = {clock: {"marker_pins": 1000 + clock} for clock in range(0, 200, 5)}
    changes[5] = changes.get(5, {}) | {"start": 1}
    seen = run(changes)
    reads = np.flatnonzero(seen["read"])[:3]
    for read in reads:
        # three clocks of synchroniser, and one more in which it has to stand still
        assert seen["step"][read + 1] in {1000 + clock for clock in range(read - 10, read - 3)}


def test_the_marker_counts_only_once_all_its_wires_stand_still():
    """Wires that change a clock apart show a value in between, which is not the marker."""
    dut = ExposureControl()
    markers = []

    async def drive(ctx):
        for pins in [0x00] * 6 + [0x0F] + [0xFF] * 8 + [0x7F, 0x3C] + [0x18] * 8:
            ctx.set(dut.marker_pins, pins)
            markers.append(ctx.get(dut.marker))
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(drive)
    simulator.run()
    assert list(dict.fromkeys(markers)) == [0x00, 0xFF, 0x18]
