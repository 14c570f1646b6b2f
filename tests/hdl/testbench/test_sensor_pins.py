# SPDX-License-Identifier: Apache-2.0
"""A sensor's lanes through the ECP5's I/O registers, with skews of parts of a bit and jitter."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from amaranth.build import Attrs, Pins, Resource
from amaranth.hdl import ClockDomain, ClockSignal, Elaboratable, Module, Value
from amaranth_boards.ecpix5 import ECPIX585Platform

from hueflight_hdl.boards.pins import drive_pin, input_of
from hueflight_hdl.boards.sensor_lanes import HOLD_NS, SETUP_NS, Ecp5LaneInputs
from hueflight_hdl.boards.target import Target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.camera.formatter.reference import frame_beats
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.ddr.link_format import LinkFormat
from hueflight_hdl.camera.sensor.ddr.receiver import DdrReceiver
from hueflight_hdl.testbench.camera import frame_marks
from hueflight_hdl.testbench.ddr_sensor import SensorPins, frame_words
from hueflight_hdl.testbench.pin_events import PinBench

FORM = FrameFormat(rows=4, cols=10, code_bits=9, lanes=2, run=64)
LINK = LinkFormat(form=FORM)
BIT_PS = 2500  # 400 Mbit/s: 100 MHz in the domain `sensor`
OSCILLATOR_PS = 10_000
WIDTH = FORM.lanes * FORM.code_bits
FREE = "E26 D25 F26 F25 C26 C25 A25 A24 D19 C21 B21 C22 D21 A21 A22 A23 C16 B17 C18 B19 A17 A18"
_ATTRS = Attrs(IO_TYPE="LVCMOS33")

pytestmark = pytest.mark.slow


class SensorTop(Elaboratable):
    """The lanes of a board with an ECP5, with the beats on pins."""

    def elaborate(self, platform):
        m = Module()
        oscillator = input_of(m, "oscillator", platform.request("clk100", 0, dir="-"))
        m.domains.sync = ClockDomain(reset_less=True)
        m.d.comb += ClockSignal("sync").eq(oscillator)
        inputs = Ecp5LaneInputs(oscillator)
        clock = input_of(m, "sensor_clock", platform.request("sensor_clock", 0, dir="-"))
        inputs.add_clock(m, platform, clock)
        m.submodules.receiver = receiver = DdrReceiver(LINK)
        lanes = platform.request("sensor_lanes", 0, dir="-")
        for lane in range(LINK.lanes):
            bits = inputs.add_lane(m, f"lane{lane}", lanes[lane])
            m.d.comb += receiver.samples[lane].eq(bits)
        beats = receiver.port.beats
        drive_pin(m, platform, "beat", Value.cast(beats.payload))
        drive_pin(m, platform, "valid", beats.valid)
        return m


def platform():
    made = ECPIX585Platform()
    free = FREE.split()
    made.add_resources(
        [
            Resource("sensor_clock", 0, Pins("V23", dir="i"), _ATTRS),
            Resource("sensor_lanes", 0, Pins("T25 U25 U24", dir="i"), _ATTRS),
            Resource("beat", 0, Pins(" ".join(free[: WIDTH + 3]), dir="o"), _ATTRS),
            Resource("valid", 0, Pins(free[-1], dir="o"), _ATTRS),
        ]
    )
    return made


@pytest.fixture(scope="module")
def bench(verilator: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[PinBench]:
    folder = tmp_path_factory.mktemp("sensor")
    target = Target("camera", "ecpix5-85f", platform, SensorTop, {}, "ecp5")
    write_project(target, folder, constraints=False)
    made = PinBench(
        (folder / "top.v").read_text(),
        {"clk100_0__io": 1, "sensor_clock_0__io": 1, "sensor_lanes_0__io": LINK.lanes},
        {"valid_0__io": 1, "beat_0__io": WIDTH + 3},
    )
    yield made
    made.close()


def events(pins: SensorPins, clocks: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Changes of all pins.

    The sensor's clock has its edges in the middle of the bits of a lane without skew. Edges of
    data are early or late by as much as setup and hold leave, in part as a constant skew, in part
    as jitter of each edge.
    """
    most = BIT_PS // 2 - round(1000 * max(SETUP_NS, HOLD_NS)) - 1
    bits = pins.take(clocks).reshape(clocks, LINK.lanes, LINK.gear)
    streams = bits.transpose(1, 0, 2).reshape(LINK.lanes, -1)
    count = streams.shape[1]
    start = 2_000_000  # the oscillator starts divider and registers
    changes = []
    for lane, stream in enumerate(streams):
        skew = int(rng.integers(-most // 2, most // 2 + 1))
        jitter = rng.integers(-(most // 2), most // 2 + 1, count)
        times = start + np.arange(count) * BIT_PS + skew + jitter
        changes += [
            (int(time), 2 + lane, int(bit)) for time, bit in zip(times, stream, strict=True)
        ]
    edges = start + np.arange(count) * BIT_PS + BIT_PS // 2
    changes += [(int(time), 1, number & 1 ^ 1) for number, time in enumerate(edges)]
    end = start + count * BIT_PS
    changes += [(time, 0, time // 5000 & 1) for time in range(5000, end, OSCILLATOR_PS // 2)]
    word, made = 0, []
    for time, pin, level in sorted(changes):
        word = word & ~(1 << pin) | level << pin
        made.append((time, word))
    return made


@pytest.mark.parametrize("seed", range(6))
def test_frames_are_exact_with_skews_and_jitter_up_to_setup_and_hold(bench: PinBench, seed: int):
    rng = np.random.default_rng(seed)
    pins = SensorPins(LINK, (rng.integers(0, 40) + rng.integers(0, 13, LINK.lanes)).tolist())
    pins.train(330)
    frames = [rng.integers(0, 512, (FORM.rows, FORM.cols)).astype(np.uint16) for _ in range(3)]
    for codes in frames:
        pins.send(frame_words(LINK, codes))
    changes = bench.run(events(pins, 1500, rng))
    beats = []
    ends = [time for time, _ in changes[1:]]
    for (time, word), end in zip(changes, ends, strict=False):
        if word & 1:  # valid: a beat in each clock of the oscillator
            beats += [word >> 1] * round((end - time) / OSCILLATOR_PS)
    expected = [
        sum(int(code) << FORM.code_bits * lane for lane, code in enumerate(beat)) | marks << WIDTH
        for codes in frames
        for beat, marks in zip(frame_beats(FORM, codes), frame_marks(FORM).tolist(), strict=True)
    ]
    assert beats == expected
