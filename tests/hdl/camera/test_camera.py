# SPDX-License-Identifier: Apache-2.0
"""The whole camera in compiled simulation: a small one under every kind of trouble."""

from itertools import islice

import numpy as np
import pytest

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.formatter.reference import filter_codes
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.reference import synthetic_frames
from hueflight_hdl.testbench.camera import SimulatedCamera, compile_camera
from hueflight_hdl.testbench.camera_capture import camera_packets
from hueflight_protocol import (
    Event,
    EventCode,
    Frame,
    FrameFlags,
    PacketParser,
    Status,
    TestPattern,
)

SMALL = CameraConfig(
    form=FrameFormat(rows=48, cols=20, code_bits=9, lanes=8, run=64, banks=8),
    buffer_words=64,
    admit_words=16,
    sensor=True,
    patience=60,
)


@pytest.fixture(scope="module")
def compiled(simulator):
    return compile_camera(SMALL)


@pytest.fixture(scope="module")
def small(compiled):
    def start(**options):
        camera = SimulatedCamera(SMALL, compiled=compiled, **options)
        running.append(camera)
        return camera

    running = []
    yield start
    for camera in running:
        camera.close()


def parse(data):
    parser = PacketParser()
    packets = [packet.content for packet in [*parser.feed(data), *parser.finish()]]
    assert parser.report.damaged == parser.report.missing == parser.report.skipped_bytes == 0
    return packets, parser.report


def frames_of(packets):
    return [packet for packet in packets if isinstance(packet, Frame)]


def synthetic(camera, *, frames, source=1, occupancy=20000, exposure=4):
    camera.write("synthetic", enable=1, source=source, occupancy=occupancy)
    camera.write("synthetic_seed", value=77)
    camera.write("exposure", value=exposure)
    camera.write("frame_limit", value=frames)


def test_identity_is_the_map_s(small):
    camera = small()
    assert camera.read("board")["value"] == int.from_bytes(b"HCAM", "little")
    assert camera.read("map")["value"] == camera.registers.fingerprint
    assert camera.read("geometry") == {"rows": 48, "cols": 20}
    assert camera.read("format") == {"code_bits": 9, "lanes": 8, "run": 64}


def test_capture_is_delivered_and_told_of(small):
    camera = small()
    synthetic(camera, frames=9)
    camera.write("status_interval", value=4)
    camera.write("capture", value=0xC0FFEE)
    camera.write("run", start=1)
    camera.run(clocks=6000)
    packets, report = parse(camera.packets())
    frames = frames_of(packets)
    expected = islice(synthetic_frames(SMALL.form, 1, seed=77, occupancy=20000), 9)
    for number, (frame, codes) in enumerate(zip(frames, expected, strict=True)):
        np.testing.assert_array_equal(frame.codes, codes)
        assert frame.header.frame == number
        assert frame.header.capture == 0xC0FFEE
        assert frame.header.periods == 4
        assert frame.header.flags == FrameFlags.TEST_PATTERN
    events = [packet for packet in packets if isinstance(packet, Event)]
    assert [event.code for event in events] == [EventCode.RUN_STARTED, EventCode.RUN_STOPPED]
    assert events[-1].value == 9
    # all packets have the time at which they were made, on one clock
    times = [packet.header.timestamp for packet in packets if not isinstance(packet, Frame)]
    assert times == sorted(times)
    assert 0 < times[0] < frames[1].header.timestamp
    assert frames[-1].header.timestamp < times[-1] < camera.read("timestamp")["value"]
    last = [packet for packet in packets if isinstance(packet, Status)][-1]
    assert (last.frames_sent, last.frames_dropped, last.frames_aborted) == (9, 0, 0)
    assert report.aborted == 0
    assert camera.read("hits")["value"] == sum(np.count_nonzero(f.codes) for f in frames)
    assert camera.read("periods")["value"] == 9 * 4
    assert camera.read("sequence")["value"] == len(packets)


def test_triggers_that_the_illuminator_missed_are_counted_and_told(small):
    camera = small()
    synthetic(camera, frames=4, exposure=20)

    def miss(times):
        for _ in range(times):
            records = camera.inputs(40)
            records["missed"][5:25] = 1  # an edge each, however long
            camera.run(records)

    miss(3)  # before the capture: not of it
    camera.write("run", start=1)
    miss(5)
    camera.run(clocks=2000)
    miss(2)
    camera.run(clocks=6000)
    miss(4)  # after it
    packets, _ = parse(camera.packets())
    told = [p for p in packets if isinstance(p, Event) and p.code == EventCode.TRIGGER_LOST]
    assert told
    assert sum(event.value for event in told) == told[-1].count == 7
    assert camera.read("triggers_lost")["value"] == 7
    assert camera.read("faults")["trigger_lost"] == 1


@pytest.mark.parametrize("overlap", [False, True])
def test_a_capture_as_a_stream(compiled, overlap):
    stream = camera_packets(
        SMALL, frames=30, occupancy=0.4, seed=9, exposure=6, overlap=overlap, compiled=compiled
    )
    packets, report = parse(b"".join(stream))
    frames = frames_of(packets)
    assert (len(frames), report.aborted, report.dropped) == (30, 0, 0)
    expected = islice(synthetic_frames(SMALL.form, 1, seed=9, occupancy=26214), 30)
    for number, (frame, codes) in enumerate(zip(frames, expected, strict=True)):
        assert frame.header.frame == number
        np.testing.assert_array_equal(frame.codes, codes)
    # exposures of 192 clocks, readouts of 120: three clocks from one exposure to the next, or
    # the readout and what it takes to begin and end it
    (spacing,) = set(np.diff([frame.header.timestamp for frame in frames]))
    assert spacing == 195 if overlap else 192 + 120 < spacing < 192 + 120 + 12
    assert isinstance(packets[-1], Event)
    assert packets[-1].code == EventCode.RUN_STOPPED


def test_filters_and_mask_from_registers(small):
    camera = small()
    form = SMALL.form
    mask = np.random.default_rng(1).random((form.rows, form.cols)) < 0.3
    bits = np.zeros(-(-form.pixels // 32) * 32, np.uint8)
    bits[: form.pixels] = mask.reshape(-1)
    words = np.packbits(bits, bitorder="little").view("<u4")
    camera.write_words("pixel_mask", words.tolist())
    camera.write("filters", mask=1, roi=1, gate=1)
    camera.write("roi_rows", first=5, last=40)
    camera.write("roi_cols", first=3, last=17)
    camera.write("gate", first=50, last=400)
    synthetic(camera, frames=3, occupancy=60000)
    camera.write("run", start=1)
    camera.run(clocks=2000)
    frames = frames_of(parse(camera.packets())[0])
    filters = {
        "mask": 1,
        "roi": 1,
        "gate": 1,
        "rows": {"first": 5, "last": 40},
        "cols": {"first": 3, "last": 17},
        "codes": {"first": 50, "last": 400},
    }
    expected = islice(synthetic_frames(form, 1, seed=77, occupancy=60000), 3)
    for frame, codes in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(frame.codes, filter_codes(codes, filters, mask)[0])
        assert frame.header.flags & (FrameFlags.MASKED | FrameFlags.ROI | FrameFlags.GATED) == 7


@pytest.mark.parametrize("pattern", [0, 1])
@pytest.mark.parametrize("words", [1, 2, 3, 256])
def test_test_packets(small, pattern, words):
    camera = small()
    camera.write("test_packet", words=words, pattern=pattern)
    camera.write("test_seed", value=0xFFFF_FFF0)
    camera.write("test_send", value=1)
    camera.run(clocks=1000)
    (packet,), _ = parse(camera.packets())
    assert isinstance(packet, TestPattern)
    assert (packet.pattern, packet.words.size, packet.words[0]) == (pattern, words, 0xFFFF_FFF0)
    assert packet.errors() == 0


def accounts(camera, packets, report):
    """Frames sent, dropped and aborted, by the camera's registers; the host must agree."""
    counted = {
        name: camera.read(name)["value"]
        for name in ("frame", "frames_sent", "frames_dropped", "frames_aborted")
    }
    assert counted["frames_sent"] == len(frames_of(packets)) == report.frames
    assert counted["frames_aborted"] == report.aborted
    assert counted["frame"] == sum(list(counted.values())[1:])
    for frame in frames_of(packets):
        assert frame.header.dropped <= counted["frames_dropped"]
    return counted


def test_stalls_lose_whole_frames_and_every_one_is_counted(small):
    rng = np.random.default_rng(11)
    stalled = [False]

    def taking(clocks):
        pieces = []
        while sum(map(len, pieces)) < clocks:
            stalled[0] = not stalled[0]
            length = int(rng.integers(1, 3000 if stalled[0] else 5000))
            pieces.append(np.full(length, not stalled[0]))
        return np.concatenate(pieces)[:clocks]

    camera = small(taking=taking)
    synthetic(camera, frames=2000, occupancy=30000, exposure=2)
    camera.write("run", start=1)
    for _ in range(12):
        camera.run(clocks=50_000)
    camera.taking = None
    camera.run(clocks=5000)
    assert not camera.read("state")["running"]
    packets, report = parse(camera.packets())
    counted = accounts(camera, packets, report)
    assert counted["frame"] == 2000
    assert counted["frames_dropped"] > 50
    assert counted["frames_aborted"] > 5
    expected = list(islice(synthetic_frames(SMALL.form, 1, seed=77, occupancy=30000), 2000))
    for frame in frames_of(packets):
        np.testing.assert_array_equal(frame.codes, expected[frame.header.frame])
    events = [p for p in packets if isinstance(p, Event)]
    assert [e.value for e in events if e.code == EventCode.RUN_STOPPED] == [2000]
    lost = [e.count for e in events if e.code == EventCode.OVERFLOW]
    assert lost == sorted(lost)
    assert lost[-1] == counted["frames_dropped"] + counted["frames_aborted"]


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_misbehaves_is_never_believed(small, seed):
    """Beats missing, doubled, with wrong marks, late or none: only right frames are delivered."""
    rng = np.random.default_rng(seed)
    camera = small()
    form = SMALL.form
    camera.write("synthetic", enable=0)
    # no read is asked for while a request is answered, or this test plays the sensor
    camera.write("exposure", value=20)
    camera.write("frame_limit", value=40)
    camera.write("run", start=1)
    right = {}
    for number in range(40):
        camera.run_to_read(step=1, limit=1000)
        codes = rng.integers(0, 512, (form.rows, form.cols), np.uint16)
        beats = list(range(form.beats))
        trouble = rng.integers(5)
        if trouble == 1:
            del beats[int(rng.integers(len(beats)))]
        elif trouble == 2:
            beats.insert(int(rng.integers(1, len(beats))), int(rng.integers(len(beats))))
        elif trouble == 3:
            del beats[int(rng.integers(1, len(beats))) :]
        elif trouble == 4:
            beats = []
        if beats == list(range(form.beats)):
            right[number] = codes
        if beats:
            camera.run(camera.readout(codes, beats=beats))
        camera.run(clocks=2 * SMALL.patience + form.beats)
    camera.run(clocks=1000)
    packets, report = parse(camera.packets())
    counted = accounts(camera, packets, report)
    assert counted["frame"] == 40
    delivered = frames_of(packets)
    assert [frame.header.frame for frame in delivered] == sorted(right)
    for frame in delivered:
        np.testing.assert_array_equal(frame.codes, right[frame.header.frame])
    assert camera.read("faults")["sensor"] == 1


def test_any_register_contents_then_a_clean_capture(small):
    """Random writes, starts and aborts; after a stop and a start packets are well-formed."""
    rng = np.random.default_rng(5)
    camera = small()
    writable = [r for r in camera.registers if r.access.writable and not r.count]
    for _ in range(150):
        register = writable[int(rng.integers(len(writable)))]
        camera.write_words(register.name, [int(rng.integers(1 << 32))])
        camera.run(clocks=int(rng.integers(1, 300)))
    camera.write("run", abort=1)
    camera.run(clocks=3000)
    camera.write_words("test_packet", [0])
    for name in ("filters", "roi_rows", "roi_cols", "gate", "period", "gap", "trigger"):
        camera.write(name)
    camera.write("status_interval", value=0)
    # what random writes had asked for (a test packet of up to a megabyte) is sent first
    for _ in range(8):
        camera.run(clocks=50_000)
    parse(camera.packets())
    synthetic(camera, frames=3)
    camera.write("run", start=1)
    camera.run(clocks=3000)
    frames = frames_of(parse(camera.packets())[0])
    expected = islice(synthetic_frames(SMALL.form, 1, seed=77, occupancy=20000), 3)
    for frame, codes in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(frame.codes, codes)


def test_a_fault_of_the_sensor_is_told_with_its_frame(small):
    """Also if its event has to wait until the link takes data again."""
    camera = small()
    codes = np.zeros((SMALL.form.rows, SMALL.form.cols), np.uint16)
    camera.write("synthetic", enable=0)
    camera.write("exposure", value=20)
    camera.write("frame_limit", value=7)
    camera.write("run", start=1)
    for number in range(7):
        camera.run_to_read(step=1, limit=1000)
        if number == 3:
            camera.taking = lambda clocks: np.zeros(clocks, bool)
        if number == 6:
            camera.taking = None
        camera.run(camera.readout(codes, beats=slice(0, 5 if number == 3 else None)))
        camera.run(clocks=2 * SMALL.patience)
    camera.run(clocks=1000)
    events = {p.code: p for p in parse(camera.packets())[0] if isinstance(p, Event)}
    fault = events[EventCode.SENSOR_FAULT]
    assert (fault.count, fault.value) == (1, 3)
    assert camera.read("faults")["sensor"] == 1
