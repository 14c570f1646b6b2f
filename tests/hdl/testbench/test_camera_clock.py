# SPDX-License-Identifier: Apache-2.0
"""A whole ULX3S camera that runs from an external clock, while it sends frames."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from hueflight_hdl.boards import ecp5_reference
from hueflight_hdl.boards.target import Options
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.reference import synthetic_frames
from hueflight_hdl.testbench.board import BoardRun, compile_board, run_board
from hueflight_protocol import Event, EventCode, Frame, PacketParser
from hueflight_protocol.camera_map import camera_map
from hueflight_protocol.control import Result
from support.board_session import ULX3S, US, Session

REFERENCE_HZ = 10_000_000
HALF_PS = 50_000
SETTLE_US, LOCK_US = 200, 100  # instead of the data sheet's milliseconds
PRESENT_US = 120  # two windows of 256 changes, each of two periods
SWITCH_US = 3 * SETTLE_US + 60  # answer, reset, reset again, lock
LINGER_US = 150  # the link waits for more words before it sends the last ones
SIZE = {"rows": 16, "cols": 20, "run": 64}
FORM = FrameFormat(**SIZE, code_bits=9, lanes=8)
MAP = camera_map(**SIZE, external_clock=True)
SEED, OCCUPANCY = 77, 30_000
EXPOSURE = 4  # periods of 32 clocks
FRAME_PS = 180 * 10_000  # about exposure and readout
EXTERNAL, PRESENT, LOST = 1, 2, 4
CLOCK_FAILED, REFERENCE_LOST = 1 << 5, 1 << 6
CHANGES = 24
"""Changes of the clock, at phases of exposure and readout drawn by a seeded generator."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def program(verilator: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The board, compiled once."""
    folder = tmp_path_factory.mktemp("board")
    settings = {"reference_hz": REFERENCE_HZ, "buffer_words": 64, "admit_words": 16, **SIZE}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ecp5_reference, "SETTLE_S", SETTLE_US * 1e-6)
        patch.setattr(ecp5_reference, "LOCK_S", LOCK_US * 1e-6)
        target = find_target("camera", ULX3S.name, Options(settings=settings))
        write_project(target, folder, constraints=False)
    return compile_board(folder / "top.v", oscillator_hz=ULX3S.oscillator_hz)


class CameraSession(Session):
    """Requests to the camera."""

    def __init__(self) -> None:
        super().__init__(ULX3S, registers=MAP)

    def put(self, name: str, **fields: int) -> None:
        self.write(name, MAP[name].encode(**fields))

    def prepare(self) -> None:
        """Codes of the synthetic sensor; a reference that is present."""
        self.put("synthetic", enable=1, source=1, occupancy=OCCUPANCY)
        self.put("synthetic_seed", value=SEED)
        self.put("exposure", value=EXPOSURE)
        self.set("reference", HALF_PS)
        self.wait(PRESENT_US * US)

    def choose(self, source: int) -> None:
        self.put("clock_source", external=0)
        if source:
            self.put("clock_source", external=1)


def packets_of(run: BoardRun) -> tuple[list[Frame], list[Event], PacketParser]:
    """What the host's parser makes of all that the link took; nothing may be damaged."""
    parser = PacketParser()
    data = np.array([word for _, word in run.words], "<u4").tobytes()
    packets = [packet.content for packet in [*parser.feed(data), *parser.finish()]]
    report = parser.report
    assert (report.damaged, report.missing, report.skipped_bytes) == (0, 0, 0)
    frames = [packet for packet in packets if isinstance(packet, Frame)]
    return frames, [packet for packet in packets if isinstance(packet, Event)], parser


def check_codes(frames: list[Frame]) -> None:
    """Each frame has the codes of its place in its capture."""
    last = max(frame.header.frame for frame in frames)
    expected = list(islice(synthetic_frames(FORM, 1, seed=SEED, occupancy=OCCUPANCY), last + 1))
    for frame in frames:
        np.testing.assert_array_equal(frame.codes, expected[frame.header.frame])


def test_no_packet_is_damaged_by_a_change_of_the_clock(program: Path):
    """There and back, in the middle of captures; each ends and is accounted for."""
    session = CameraSession()
    session.prepare()
    rng = np.random.default_rng(17)
    checks = []
    for change in range(CHANGES):
        session.put("capture", value=change)
        session.put("run", start=1)
        session.wait(int(rng.integers(FRAME_PS)))
        session.choose(1 - change % 2)
        session.wait((SWITCH_US + LINGER_US) * US)
        checks.append(
            [
                session.read(name)
                for name in ("state", "clock_state", "clock_failures", "frames_sent",
                             "frames_aborted", "frames_dropped", "frame")
            ]
        )  # fmt: skip
    faults = session.read("faults")
    run = run_board(program, session)

    responses = run.responses()
    assert [response.result for response in responses] == [Result.OK] * session.requests
    assert responses[faults].payload[0] & (CLOCK_FAILED | REFERENCE_LOST) == CLOCK_FAILED
    frames, events, parser = packets_of(run)
    check_codes(frames)
    ends = [event.value for event in events if event.code == EventCode.RUN_STOPPED]
    aborted = 0
    for change, (end, check) in enumerate(zip(ends, checks, strict=True)):
        values = [responses[place].payload[0] for place in check]
        state, clock, failures, sent, broken, dropped, number = values
        assert not state & 1, "the capture goes on"
        assert clock == PRESENT | (EXTERNAL if change % 2 == 0 else 0)
        assert failures == change + 1
        mine = [frame for frame in frames if frame.header.capture == change]
        assert [frame.header.frame for frame in mine] == list(range(len(mine)))
        assert len(mine) == sent > 10
        assert sent + broken + dropped == number == end
        aborted += broken
    assert aborted == parser.report.aborted >= 3


def test_no_packet_is_damaged_when_the_clock_is_lost(program: Path):
    """The camera goes on from its oscillator, after a pause, and says what happened."""
    session = CameraSession()
    session.prepare()
    rng = np.random.default_rng(23)
    checks = []
    for loss in range(CHANGES // 2):
        session.choose(1)
        session.wait(SWITCH_US * US)
        session.put("faults", clock_failed=1, reference_lost=1, aborted=1, dropped=1)
        session.put("capture", value=loss)
        session.put("run", start=1)
        session.wait(int(rng.integers(FRAME_PS)))
        session.set("reference", 0)
        session.wait((SWITCH_US + LINGER_US) * US)
        checks.append([session.read(name) for name in ("faults", "clock_state", "state")])
        session.set("reference", HALF_PS)
        session.wait(PRESENT_US * US)
    session.put("capture", value=99)
    session.put("frame_limit", value=5)
    session.put("run", start=1)
    session.wait(2 * LINGER_US * US)
    run = run_board(program, session)

    responses = run.responses()
    assert [response.result for response in responses] == [Result.OK] * session.requests
    for faults, clock, state in checks:
        assert responses[faults].payload[0] & CLOCK_FAILED
        assert responses[faults].payload[0] & REFERENCE_LOST
        assert responses[clock].payload[0] & (LOST | EXTERNAL) == LOST
        assert not responses[state].payload[0] & 1
    frames, _, _ = packets_of(run)
    check_codes(frames)
    last = [frame for frame in frames if frame.header.capture == 99]
    assert [frame.header.frame for frame in last] == list(range(5))


def test_the_time_follows_the_external_clock_from_the_edge_on(program: Path):
    """A reference 1 % slow: a time stamp counts its clocks since the edge, to a clock."""
    slow_half = HALF_PS * 101 // 100
    session = CameraSession()
    session.prepare()
    session.set("reference", slow_half)
    session.wait(PRESENT_US * US)
    session.choose(1)
    session.wait(SWITCH_US * US)
    session.put("time_sync", arm=1)
    armed = session.read("time_state")
    came = session.trigger()
    done = session.read("time_state")
    session.put("frame_limit", value=3)
    session.put("run", start=1)
    session.wait(LINGER_US * US)
    run = run_board(program, session)

    responses = run.responses()
    assert responses[armed].payload == (1,)
    assert responses[done].payload == (2,)
    frames, _, _ = packets_of(run)
    syncs = [time for time, level in run.led if level and time > came]
    assert len(frames) == len(syncs) == 3
    clock_ps = 2 * slow_half / 10
    for frame, sync in zip(frames, syncs, strict=True):
        # four clocks from the edge to the time, two from the time to the frame sync
        assert frame.header.timestamp == pytest.approx((sync - came) / clock_ps - 6, abs=1.5)
