# SPDX-License-Identifier: Apache-2.0
"""The whole camera with a reduction, compiled: sums alone and beside codes, under any trouble."""

from dataclasses import dataclass, field
from itertools import islice

import numpy as np
import pytest

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.formatter.reference import filter_codes
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.reference import synthetic_frames
from hueflight_hdl.testbench.camera import SimulatedCamera, compile_camera
from hueflight_hdl.testbench.camera_sums import choose_sums, load_offsets, load_tables
from hueflight_hdl.testbench.cxxrtl import SimulationError
from hueflight_protocol import (
    Event,
    EventCode,
    Frame,
    FrameFlags,
    PacketParser,
    ReductionMode,
    ReductionRoom,
    Sums,
)
from hueflight_protocol.camera_map import SyntheticSource
from hueflight_protocol.control import Result
from hueflight_protocol.reduction import ReductionTables
from support.sums_reference import SumsReference, draw_offsets, draw_tables

ROOM = ReductionRoom(sums=4, entry_bits=6, sum_bits=11, group=8)
SMALL = CameraConfig(
    form=FrameFormat(rows=24, cols=16, code_bits=6, lanes=8, run=64, banks=8),
    buffer_words=64,
    admit_words=16,
    sensor=True,
    patience=60,
    reduction=ROOM,
    sums_words=64,
)
FORM = SMALL.form
EXPOSURE = 3  # periods


@pytest.fixture(scope="module")
def compiled(simulator):
    return compile_camera(SMALL)


@pytest.fixture
def camera(compiled):
    running = SimulatedCamera(SMALL, compiled=compiled)
    yield running
    running.close()


@dataclass
class Capture:
    """What a camera is told, and the frames that it has to make sums of."""

    rng: np.random.Generator
    frames: int = 60
    per_picture: int = 7
    sums: int = 3
    with_codes: bool = False
    moved: bool = True
    filters: dict = field(default_factory=dict)
    mask: np.ndarray | None = None
    occupancy: int = 40_000
    overlap: bool = False
    label: int = 0
    seed: int = 77
    tables: ReductionTables = field(init=False)
    offsets: np.ndarray = field(init=False)

    def __post_init__(self):
        self.tables = draw_tables(
            self.rng, code_bits=FORM.code_bits, sums=self.sums,
            entry_bits=ROOM.entry_bits, sum_bits=ROOM.sum_bits,
        )  # fmt: skip
        offsets = draw_offsets(self.rng, self.tables, FORM.pixels)
        self.offsets = offsets if self.moved else np.zeros_like(offsets)

    def load(self, camera):
        load_tables(camera, self.tables)
        load_offsets(camera, self.offsets)
        choose_sums(camera, self.tables, frames=self.per_picture, with_codes=self.with_codes)

    def start(self, camera, *, exposure=EXPOSURE, synthetic=True):
        """Set all registers and start the capture."""
        if self.mask is not None:
            bits = np.packbits(self.mask.reshape(-1), bitorder="little")
            camera.write_words("pixel_mask", bits.view("<u4").tolist())
        camera.write("filters", **{name: self.filters.get(name, 0) for name in ("mask", "roi")},
                     gate=self.filters.get("gate", 0))  # fmt: skip
        if self.filters:
            camera.write("roi_rows", **self.filters["rows"])
            camera.write("roi_cols", **self.filters["cols"])
            camera.write("gate", **self.filters["codes"])
        camera.write(
            "synthetic", enable=synthetic, source=SyntheticSource.RANDOM, occupancy=self.occupancy
        )
        camera.write("synthetic_seed", value=self.seed)
        camera.write("exposure", value=exposure)
        camera.write("readout", overlap=self.overlap)
        camera.write("frame_limit", value=self.frames)
        camera.write("capture", value=self.label)
        camera.write("run", start=1)

    def codes(self):
        """Frames of the synthetic sensor after the filters, with the flags that say so."""
        source = synthetic_frames(
            FORM, SyntheticSource.RANDOM, seed=self.seed, occupancy=self.occupancy
        )
        filtered = [
            filter_codes(codes, self.filters, self.mask) for codes in islice(source, self.frames)
        ]
        return [codes for codes, _ in filtered], filtered[0][1] | FrameFlags.TEST_PATTERN

    def reference(self, frames, **lost):
        flat = [codes.reshape(-1) for codes in frames]
        return SumsReference(self.tables, self.offsets, flat, (FORM.rows, FORM.cols), **lost)


def finish(camera):
    """Run until the capture is over and all was sent; return its packets."""
    for _ in range(1000):
        camera.run(clocks=500)
        state = camera.read("state")
        if not (state["running"] or state["sending"]):
            break
    else:
        raise AssertionError("the capture does not end")
    camera.taking = None
    camera.run(clocks=2000)
    return parse(camera.packets())


def parse(data):
    parser = PacketParser()
    packets = [*parser.feed(data), *parser.finish()]
    report = parser.report
    assert report.damaged == report.missing == report.skipped_bytes == 0
    return packets


def contents(packets, kind):
    return [packet.content for packet in packets if isinstance(packet.content, kind)]


def check(capture, camera, packets, *, least_pictures=2):
    """Compare all that came of a capture of the synthetic sensor with what must come."""
    codes, flags = capture.codes()
    reference = capture.reference(codes)
    parts = reference.check_packets(packets)
    reference.check_end()
    assert reference.held == capture.frames
    assert reference.pictures >= least_pictures
    for part in parts:
        assert (part.flags, part.periods) == (flags, EXPOSURE) or not part.frames
        assert part.header.capture == capture.label
        assert part.header.timestamp < camera.clocks
    assert not any(part.missed for part in parts)

    frames = contents(packets, Frame)
    for frame in frames:
        np.testing.assert_array_equal(frame.codes, codes[frame.header.frame])
    counted = {
        name: camera.read(name)["value"]
        for name in ("frame", "frames_sent", "frames_dropped", "frames_aborted")
    }
    sent = len(frames) if capture.with_codes else capture.frames
    assert (counted["frame"], counted["frames_sent"]) == (capture.frames, sent)
    assert sum(list(counted.values())[1:]) == capture.frames
    # sums of the last picture come before the event that ends the capture
    events = contents(packets, Event)
    assert [e.value for e in events if e.code == EventCode.RUN_STOPPED] == [capture.frames]
    assert isinstance(packets[-1].content, Event)
    return counted


def stalling(rng, longest):
    """A link that takes words and stalls in turn."""
    stalled = [False]

    def taking(clocks):
        pieces = []
        while sum(map(len, pieces)) < clocks:
            stalled[0] = not stalled[0]
            pieces.append(np.full(int(rng.integers(1, longest)), not stalled[0]))
        return np.concatenate(pieces)[:clocks]

    return taking


def window(rng, count):
    first, last = np.sort(rng.integers(0, count, 2)).tolist()
    return {"first": first, "last": last}


def draw(rng, **options):
    """A capture with settings at random."""
    filters, mask = {}, None
    if rng.random() < 0.7:
        codes = {"first": int(rng.integers(1, 20)), "last": int(rng.integers(40, 80))}
        filters = {"rows": window(rng, FORM.rows), "cols": window(rng, FORM.cols), "codes": codes}
        filters |= {name: int(rng.integers(2)) for name in ("mask", "roi", "gate")}
        mask = rng.random((FORM.rows, FORM.cols)) < 0.3
    chosen = {
        "frames": int(rng.integers(20, 150)),
        "per_picture": int(rng.choice([0, 1, 2, 15, 1000])),
        "sums": int(rng.integers(1, ROOM.sums + 1)),
        "with_codes": bool(rng.integers(2)),
        "moved": rng.random() < 0.8,
        "overlap": bool(rng.integers(2)),
        "occupancy": int(rng.choice([0, 3000, 20_000, 65_535])),
        "label": int(rng.integers(1 << 32)),
        "seed": int(rng.integers(1, 1 << 32)),
    }
    return Capture(rng, filters=filters, mask=mask, **chosen | options)


@pytest.mark.parametrize("with_codes", [False, True])
def test_sums_are_those_of_the_definition(camera, with_codes):
    capture = Capture(np.random.default_rng(1), frames=90, with_codes=with_codes, label=0xC0FFEE)
    capture.load(camera)
    capture.start(camera)
    packets = finish(camera)
    counted = check(capture, camera, packets)
    frames = contents(packets, Frame)
    assert len(frames) == (90 if with_codes else 0)
    assert counted["frames_dropped"] == counted["frames_aborted"] == 0
    hits = sum(np.count_nonzero(frame.codes) for frame in frames)
    assert camera.read("hits")["value"] == hits


@pytest.mark.parametrize("seed", range(4))
def test_captures_with_different_settings_one_after_another(camera, seed):
    rng = np.random.default_rng(100 + seed)
    for _ in range(4):
        capture = draw(rng)
        capture.load(camera)
        camera.taking = (
            stalling(rng, int(rng.choice([3, 100, 3000]))) if rng.random() < 0.6 else None
        )
        capture.start(camera)
        check(capture, camera, finish(camera), least_pictures=1)


@pytest.mark.parametrize("with_codes", [False, True])
def test_a_stalled_link_costs_frames_of_codes_but_none_of_sums(camera, with_codes):
    rng = np.random.default_rng(2)
    capture = Capture(rng, frames=1200, with_codes=with_codes, overlap=True, per_picture=3)
    capture.load(camera)
    camera.taking = stalling(rng, 8000)
    capture.start(camera)
    counted = check(capture, camera, finish(camera))
    assert camera.read("stall_clocks")["value"] > 10_000
    if with_codes:
        assert counted["frames_dropped"] > 50
    else:
        assert counted["frames_dropped"] == counted["frames_aborted"] == 0


@pytest.mark.parametrize("with_codes", [False, True])
@pytest.mark.parametrize("seed", range(2))
def test_a_sensor_that_misbehaves_is_never_believed(camera, seed, with_codes):
    """Beats late, missing, doubled or none: sums hold right frames alone and tell of others."""
    rng = np.random.default_rng(seed)
    capture = Capture(rng, frames=60, per_picture=4, with_codes=with_codes)
    capture.load(camera)
    # no readout is asked for while a request is answered, or this test plays the sensor
    capture.start(camera, exposure=100, synthetic=False)
    given, dropped, cut = [], set(), set()
    for number in range(capture.frames):
        camera.run_to_read(step=20, limit=5000)
        codes = rng.integers(0, 1 << FORM.code_bits, (FORM.rows, FORM.cols), np.uint16)
        beats = list(range(FORM.beats))
        trouble = int(rng.integers(12)) if number < capture.frames - 1 else None
        if trouble == 1:
            del beats[int(rng.integers(1, FORM.beats))]
            cut.add(number)
        elif trouble == 2:
            beats.insert(int(rng.integers(1, FORM.beats)), int(rng.integers(1, FORM.beats)))
            cut.add(number)
        elif trouble == 3:
            del beats[int(rng.integers(1, FORM.beats)) :]
            cut.add(number)
        elif trouble == 4:
            beats = []
            dropped.add(number)
        elif trouble == 5:
            del beats[0]
            dropped.add(number)
        if beats:
            inputs = camera.readout(codes, beats=beats)
            spread = camera.inputs(3 * len(inputs))
            spread[np.sort(rng.permutation(len(spread))[: len(inputs)])] = inputs
            camera.run(spread)
        camera.run(clocks=int(rng.choice([1, 2500])))
        given.append(codes)
    packets = finish(camera)
    reference = capture.reference(given, dropped=frozenset(dropped), cut=frozenset(cut))
    parts = reference.check_packets(packets)
    reference.check_end()
    assert reference.pictures >= 3
    assert any(part.missed for part in parts)
    # what the packets say adds up, and so do the counters
    whole = {part.picture: part.frames + part.missed for part in parts if part.first_pixel == 0}
    assert sum(whole.values()) == camera.read("frame")["value"] == capture.frames
    counted = [camera.read(f"frames_{name}")["value"] for name in ("sent", "dropped", "aborted")]
    assert counted == [capture.frames - len(dropped | cut), len(dropped), len(cut)]
    for frame in contents(packets, Frame):
        assert frame.header.frame not in dropped | cut
        np.testing.assert_array_equal(frame.codes, given[frame.header.frame])
    assert len(contents(packets, Frame)) == (counted[0] if with_codes else 0)
    assert camera.read("faults")["sensor"] == 1


@pytest.mark.parametrize("seed", range(3))
def test_a_capture_that_is_aborted_tells_of_all_its_frames(camera, seed):
    rng = np.random.default_rng(200 + seed)
    for _ in range(5):
        capture = draw(rng, frames=0, with_codes=False, overlap=True)
        capture.load(camera)
        capture.start(camera)
        camera.run(clocks=int(rng.integers(1, 20_000)))
        camera.write("run", abort=1)
        packets = finish(camera)
        (came,) = (e.value for e in contents(packets, Event) if e.code == EventCode.RUN_STOPPED)
        told: dict[int, int] = {}
        for part in contents(packets, Sums):
            first = part.first_pixel
            told[first] = told.get(first, 0) + part.frames + part.missed
        assert set(told.values()) <= {came}
        assert bool(told) == bool(came)


def test_tables_and_offsets_cannot_be_written_during_a_capture(camera):
    capture = Capture(np.random.default_rng(3), frames=400, label=3)
    capture.load(camera)
    capture.start(camera)
    camera.write_words("reduction_entries", [0xFFFF_FFFF, 0xFFFF_FFFF])
    camera.write_words("reduction_offsets", [0x7F7F_7F7F] * 2)
    for name in ("reduction_store", "reduction_move"):
        for element in (0, 5, 9):
            with pytest.raises(SimulationError, match=f"result={int(Result.REFUSED)}"):
                camera.write(name, value=element)
    # what is taken over when a capture begins is of no effect on it either
    camera.write("reduction", mode=ReductionMode.BOTH, sums=1)
    camera.write("reduction_frames", value=1)
    camera.write_words("reduction_width", [3] * ROOM.sums)
    camera.write("reduction_codes", first=2, last=3)
    camera.write("reduction_tables", value=5)
    camera.write("reduction_moved", value=5)
    assert camera.read("state")["running"]
    check(capture, camera, finish(camera))

    again = Capture(np.random.default_rng(4), frames=50, sums=1)
    again.load(camera)
    again.start(camera)
    check(again, camera, finish(camera))


IMPOSSIBLE = {
    "no mode": ("reduction", {"mode": 3, "sums": 3}),
    "codes": ("reduction", {"mode": ReductionMode.CODES, "sums": 3}),
    "no sums": ("reduction", {"mode": ReductionMode.SUMS, "sums": 0}),
    "more sums than there is room for": ("reduction", {"mode": ReductionMode.SUMS, "sums": 5}),
    "a width of 0": ("reduction_width", [11, 0, 11]),
    "too wide": ("reduction_width", [11, 11, 12]),
    "an empty range": ("reduction_codes", {"first": 9, "last": 8}),
    "a range past the last code": ("reduction_codes", {"first": 1, "last": 64}),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_what_cannot_be_followed_sends_codes(camera, name):
    capture = Capture(np.random.default_rng(5), frames=12)
    capture.load(camera)
    register, written = IMPOSSIBLE[name]
    if isinstance(written, dict):
        camera.write(register, **written)
    else:
        camera.write_words(register, written)
    capture.start(camera)
    packets = finish(camera)
    codes, _ = capture.codes()
    assert not contents(packets, Sums)
    for frame, expected in zip(contents(packets, Frame), codes, strict=True):
        np.testing.assert_array_equal(frame.codes, expected)
    # and does no lasting harm
    capture.load(camera)
    capture.start(camera)
    check(capture, camera, finish(camera))


@pytest.mark.parametrize("seed", range(3))
def test_any_register_contents_then_a_clean_capture(camera, seed):
    """Random writes, starts and aborts; sums of a capture after them are right."""
    rng = np.random.default_rng(50 + seed)
    writable = [register for register in camera.registers if register.access.writable]
    reducing = [register for register in writable if register.name.startswith("reduction")]
    for _ in range(250):
        some = reducing if rng.random() < 0.6 else writable
        register = some[int(rng.integers(len(some)))]
        words = [int(rng.integers(1 << int(rng.choice([1, 4, 32]))))]
        try:
            camera.write_words(register.name, words)
        except SimulationError as error:
            assert f"result={int(Result.REFUSED)}" in str(error)  # noqa: PT017
        if rng.random() < 0.1:
            camera.write("run", start=1)
        if rng.random() < 0.05:
            camera.write("run", abort=1)
        camera.run(clocks=int(rng.integers(1, 300)))
    camera.write("run", abort=1)
    camera.run(clocks=3000)
    camera.write_words("test_packet", [0])
    for name in ("filters", "period", "gap", "trigger", "readout"):
        camera.write(name)
    camera.write("status_interval", value=0)
    # what random writes had asked for (a test packet of up to a megabyte) is sent first
    for _ in range(8):
        camera.run(clocks=50_000)
    parse(camera.packets())
    for with_codes in (False, True):
        capture = Capture(rng, frames=50, with_codes=with_codes, label=9)
        capture.load(camera)
        capture.start(camera)
        check(capture, camera, finish(camera))
