# SPDX-License-Identifier: Apache-2.0
"""Everything that can go wrong on the serial pins: nothing changes, it is counted, work goes on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hueflight.devices.illuminator import Illuminator
from hueflight.devices.pulse_schedule import PulseSchedule
from hueflight_hdl.testbench.illuminator import IlluminatorTestbench
from hueflight_hdl.testbench.serial_line import line_levels
from hueflight_protocol import (
    Access,
    CobsDecoder,
    Response,
    cobs_encode,
    decode_response,
    encode_request,
    serial_frame,
)
from hueflight_protocol.checksum import crc32c
from hueflight_protocol.control import MAX_COBS_BYTES, MAX_MESSAGE_BYTES, Result, read, write
from hueflight_protocol.typed_registers import illuminator as registers

from .conftest import SMALL

BIT_CLOCKS = SMALL.pulse_hz / SMALL.baud
BYTE_CLOCKS = round(10 * BIT_CLOCKS)
MAP = SMALL.registers()
SCRATCH = MAP["scratch"].address
Damage = Callable[[np.random.Generator, bytes], tuple[list[bytes], str]]


@pytest.fixture
def armed(driver: Illuminator) -> Illuminator:
    """A board at work, whose registers are not what they were after reset."""
    driver.play(PulseSchedule.even(3, spacing_ns=300, width_ns=100, period_ns=3200))
    driver.board.write(registers.Scratch(0x600D))
    driver.board.write(registers.StepCount(7), 1)
    driver.arm(watchdog_ms=65535)
    return driver


def kept(driver: Illuminator) -> dict[tuple[str, tuple[int, ...]], tuple[int, ...]]:
    """Every register that a request could have written."""
    return {
        (register.name, indices): driver.board.read_words(
            register.address_of(*indices), register.words
        )
        for register in MAP
        if register.access is Access.RW
        for indices in register.elements()
    }


def exchange(bench: IlluminatorTestbench, line: bytes, *, rest: int = 150) -> list[Response]:
    """Put bytes on the line, without a pause, and return what is answered."""
    bench.write(line)
    decoder = CobsDecoder(limit=MAX_COBS_BYTES)
    clocks = BYTE_CLOCKS * (len(line) + rest)
    return [decode_response(message) for message in decoder.feed(bench.advance(clocks))]


def harm(value: int) -> bytes:
    """A request that would change something, were it taken."""
    return encode_request(write(value, SCRATCH, [0xBAD0000 + value]))


def bad_crc(rng: np.random.Generator, message: bytes) -> tuple[list[bytes], str]:
    damaged = bytearray(message)
    damaged[rng.integers(len(message))] ^= 1 << rng.integers(8)
    return [serial_frame(bytes(damaged))], "crc"


def bad_cobs(rng: np.random.Generator, message: bytes) -> tuple[list[bytes], str]:
    """The last block's code points beyond the end."""
    frame = bytearray(cobs_encode(message))
    at = 0
    while at + frame[at] < len(frame):
        at += frame[at]
    frame[at] += int(rng.integers(1, 20))
    return [bytes(frame) + b"\0"], "framing"


def truncated(rng: np.random.Generator, message: bytes) -> tuple[list[bytes], str]:
    """Cut within a word; a whole word less is a message with another CRC."""
    length = int(rng.choice([n for n in range(1, len(message)) if n % 4 or n < 12]))
    return [serial_frame(message[:length])], "framing"


def cut_by_a_word(rng: np.random.Generator, message: bytes) -> tuple[list[bytes], str]:
    return [serial_frame(message[:12])], "crc"


def overlong(rng: np.random.Generator, message: bytes) -> tuple[list[bytes], str]:
    """Longer than any message, with a good one at its end; buffers are passed, and then some."""
    length = MAX_MESSAGE_BYTES + int(rng.choice([3, 4, 200, 800]))
    filler = rng.integers(1, 256, length - len(message), dtype=np.uint8).tobytes()
    return [serial_frame(filler + message)], "framing"


def answer_of_another(rng: np.random.Generator, message: bytes) -> tuple[list[bytes], str]:
    """A response, as if another board shared the line."""
    damaged = bytearray(message[:-4])
    damaged[1] |= 0x80
    return [serial_frame(bytes(damaged) + crc32c(bytes(damaged)).to_bytes(4, "little"))], "framing"


DAMAGES: list[Damage] = [
    bad_crc,
    bad_cobs,
    truncated,
    cut_by_a_word,
    overlong,
    answer_of_another,
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_damage_is_counted_and_changes_nothing(
    armed: Illuminator, bench: IlluminatorTestbench, damage: Damage
):
    """Six of each, each followed at once by a good request, which is done."""
    rng = np.random.default_rng(11)
    before, errors = kept(armed), armed.board.read(registers.RequestErrors)
    expected = {"crc": 0, "framing": 0}
    for number in range(6):
        frames, kind = damage(rng, harm(number))
        expected[kind] += len(frames)
        good = serial_frame(encode_request(read(100 + number, SCRATCH)))
        (answer,) = exchange(bench, b"".join(frames) + good, rest=30)
        assert (answer.transaction, answer.payload) == (100 + number, (0x600D,))
    after = armed.board.read(registers.RequestErrors)
    counted = {"crc": after.crc - errors.crc, "framing": after.framing - errors.framing}
    assert counted == expected
    assert kept(armed) == before
    assert armed.state().armed


def test_a_byte_without_stop_bit(armed: Illuminator, bench: IlluminatorTestbench):
    """Any byte of a frame; the frame is bad, once the delimiter comes that it may have hidden."""
    errors = armed.board.read(registers.RequestErrors).framing
    frame = serial_frame(harm(1))
    for index in range(len(frame) - 1):
        levels = line_levels(frame, clocks_per_bit=BIT_CLOCKS)
        stop = slice(round((10 * index + 9) * BIT_CLOCKS), round((10 * index + 10) * BIT_CLOCKS))
        levels[stop] = 0
        bench.write_levels(np.concatenate((levels, np.ones(BYTE_CLOCKS, np.uint8))))
        assert exchange(bench, b"\0", rest=len(frame) + 5) == []
    assert armed.board.read(registers.Scratch).value == 0x600D
    assert armed.board.read(registers.RequestErrors).framing - errors == len(frame) - 1


def test_a_break_on_the_line(armed: Illuminator, bench: IlluminatorTestbench):
    """Held low for a hundred bytes' time, as when a cable is pulled."""
    bench.write_levels(np.zeros(100 * BYTE_CLOCKS, np.uint8))
    bench.write_levels(np.ones(20, np.uint8))
    (answer,) = exchange(bench, b"\0" + serial_frame(encode_request(read(5, SCRATCH))), rest=150)
    assert answer.payload == (0x600D,)
    assert armed.state().armed


def test_requests_back_to_back_at_full_rate(armed: Illuminator, bench: IlluminatorTestbench):
    """Writes without a bit between them, at the fastest rate the clock allows: all are done."""
    errors = armed.board.read(registers.RequestErrors)
    line = b"".join(
        serial_frame(encode_request(write(number, SCRATCH, [number]))) for number in range(60)
    )
    answers = exchange(bench, line)
    assert [answer.transaction for answer in answers] == list(range(60))
    assert {answer.result for answer in answers} == {Result.OK}
    assert armed.board.read(registers.Scratch).value == 59
    assert armed.board.read(registers.RequestErrors) == errors


def test_more_requests_than_the_line_can_answer(armed: Illuminator, bench: IlluminatorTestbench):
    """Long answers to short requests: what does not fit is dropped whole and counted."""
    errors = armed.board.read(registers.RequestErrors).framing
    address = MAP["step_setup"].address
    sent = 60
    line = b"".join(
        serial_frame(encode_request(read(number, address, 16))) for number in range(sent)
    )
    answers = exchange(bench, line, rest=sent * 80)
    dropped = armed.board.read(registers.RequestErrors).framing - errors
    numbers = [answer.transaction for answer in answers]
    assert 0 < dropped < sent
    assert len(answers) + dropped == sent
    assert numbers == sorted(set(numbers))
    assert {answer.result for answer in answers} == {Result.OK}
    assert armed.board.read(registers.Scratch).value == 0x600D


@pytest.mark.slow
def test_random_bytes_in_bulk(armed: Illuminator, bench: IlluminatorTestbench):
    """5000 random bytes, in frames of every length; chances of a good CRC are 1 in 10^7."""
    rng = np.random.default_rng(12)
    before, errors = kept(armed), armed.board.read(registers.RequestErrors)
    answers = exchange(bench, rng.integers(0, 256, 5000, dtype=np.uint8).tobytes() + b"\0")
    assert answers == []
    after = armed.board.read(registers.RequestErrors)
    assert after.framing - errors.framing > 10
    assert kept(armed) == before
    assert armed.state().armed
