# SPDX-License-Identifier: Apache-2.0
"""Requests over lines that lose, damage and delay messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hueflight.devices import Board, DeviceTimeoutError, RequestError, WrongDeviceError
from hueflight.emulation.simulated_transport import SimulatedTransport
from hueflight_protocol import RegisterFile, camera_map, encode_request, illuminator_map
from hueflight_protocol.camera_map import BOARD
from hueflight_protocol.control import read
from hueflight_protocol.typed_registers import camera


def board(handle: Callable[[bytes], bytes | None]) -> Board:
    return Board(SimulatedTransport(handle, "test line"), camera_map(), timeout_s=0.01)


def test_registers_by_type() -> None:
    registers = RegisterFile(camera_map())
    registers.set("frames_sent", value=0x1_2345_6789)
    made = board(registers.handle)
    assert made.read(camera.FramesSent).value == 0x1_2345_6789
    made.write(camera.Trigger(width=7, inverted=1))
    assert made.read(camera.Trigger) == camera.Trigger(width=7, inverted=1, always=0, sync_width=8)
    made.write_elements(camera.PixelMask, list(range(768)))
    assert [registers.get("pixel_mask", i) for i in (0, 64, 767)] == [0, 64, 767]


def test_identity() -> None:
    registers = RegisterFile(camera_map(clock_hz=80_000_000))
    registers.set("serial", value=0xABC)
    registers.set("versions", major=1, minor=2, patch=3)
    identity = board(registers.handle).identify(BOARD)
    assert (identity.serial, identity.firmware, identity.clock_hz, identity.place) == (
        "0000000000000ABC", "1.2.3", 80_000_000, "test line",
    )  # fmt: skip


def test_another_board_is_refused() -> None:
    other = RegisterFile(illuminator_map())
    with pytest.raises(WrongDeviceError, match=r"answers as board b'HILL', not 'HCAM'"):
        board(other.handle).identify(BOARD)


def test_another_protocol_version_is_refused() -> None:
    registers = RegisterFile(camera_map())
    registers.set("versions", protocol=9)
    with pytest.raises(WrongDeviceError, match="speaks control protocol 9, this host 1"):
        board(registers.handle).identify(BOARD)


def test_another_map_is_refused() -> None:
    registers = RegisterFile(camera_map(rows=64))
    with pytest.raises(WrongDeviceError, match="different versions"):
        board(registers.handle).check_map()


def test_refusals_say_what_and_where() -> None:
    made = board(RegisterFile(camera_map()).handle)
    with pytest.raises(RequestError, match="READ_ONLY to WRITE of register 'frames_sent'"):
        made.write(camera.FramesSent(1))


def test_silence_names_the_request() -> None:
    made = board(lambda message: None)
    with pytest.raises(DeviceTimeoutError, match="did not answer READ of register 'frame'"):
        made.read(camera.Frame)


@given(st.lists(st.sampled_from(["lose", "damage", "answer"]), max_size=2), st.booleans())
@settings(max_examples=50)
def test_reads_survive_two_bad_answers(fates: list[str], before: bool) -> None:
    registers = RegisterFile(camera_map())
    registers.set("marker", value=77)
    fate = deque(fates)

    def handle(message: bytes) -> bytes | None:
        what = fate.popleft() if fate else "answer"
        if what == "lose" and before:
            return None
        answer = registers.handle(message)
        assert answer is not None
        if what == "lose":
            return None
        return answer if what == "answer" else answer[:-1] + bytes([answer[-1] ^ 1])

    assert board(handle).read(camera.Marker).value == 77


def test_a_pulse_is_never_sent_twice() -> None:
    """A lost answer must not start a second run."""
    seen: list[int] = []
    registers = RegisterFile(camera_map(), on_write=lambda r, i, word: seen.append(word))

    def deaf(message: bytes) -> None:
        registers.handle(message)

    with pytest.raises(DeviceTimeoutError, match="asked 1 times"):
        board(deaf).write(camera.Run(start=1))
    assert seen == [1]


def test_a_late_answer_is_not_taken_for_another() -> None:
    """The answer to a request that was given up comes before that to the next one."""
    registers = RegisterFile(camera_map())
    registers.set("marker", value=5)
    late: list[bytes] = []
    transport = SimulatedTransport(registers.handle, "test line")
    original = transport.receive

    def receive(timeout_s: float) -> bytes | None:
        return late.pop() if late else original(timeout_s)

    transport.receive = receive  # type: ignore[method-assign]
    made = Board(transport, camera_map(), timeout_s=0.05)
    made.read(camera.Frame)
    older = read(0x7FFF, made.registers["requests"].address)
    stale = registers.handle(encode_request(older))
    assert stale is not None
    late.append(stale)
    assert made.read(camera.Marker).value == 5
