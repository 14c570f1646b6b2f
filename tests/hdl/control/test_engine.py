# SPDX-License-Identifier: Apache-2.0
"""Engine and register file against the software register file, request by request."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from hueflight_hdl.control.messages import request_stream, response_stream
from hueflight_hdl.control.register_file import RegisterFile
from hueflight_hdl.control.standard_block import add_control
from hueflight_hdl.testbench.cxxrtl import Simulation, simulate
from hueflight_protocol import RegisterFile as SoftwareRegisterFile
from hueflight_protocol import decode_request, decode_response, encode_request, illuminator_map
from hueflight_protocol.control import Request, Result, identify, read, status, write
from hueflight_protocol.errors import MessageError
from hueflight_protocol.registers import Access, Register

MAP = illuminator_map(channels=3, pulses=2, steps=4)
UPTIME = {MAP["uptime"].address, MAP["uptime"].address + 1}
STEPS = ("step_setup", "step_mask", "step_count", "step_idle")


def is_locked(register: Register, indices: tuple[int, ...], word: int = 0) -> bool:
    return register.name == "pulse" and indices[0] == 1


class Board(wiring.Component):
    """A board of nothing but registers, some of which the outside sees."""

    def __init__(self) -> None:
        super().__init__(
            {
                "requests": In(request_stream()),
                "responses": Out(response_stream()),
                "locked": In(1),
                "swaps": In(32),
                "faults": In(5),
                "period": Out(16),
                "started": Out(1),
                "armed_with": Out(32),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        registers = RegisterFile(
            MAP,
            constants={"serial": 0x0123_4567_89AB_CDEF, ("limit", (1,)): 0xABCD},
            unkept=STEPS,
            lock_of=lambda register, indices: 0 if is_locked(register, indices) else None,
            locks=1,
        )
        engine = add_control(m, registers, clock_ratio=3)
        connect(m, flipped(self.requests), engine.requests)
        connect(m, engine.responses, flipped(self.responses))
        m.d.comb += [
            registers.locked.eq(self.locked),
            registers.swaps.value.eq(self.swaps),
            registers.faults_set.eq(self.faults),
            self.period.eq(registers.trigger_period.value),
        ]
        with m.If(registers.sequencer_control.start):
            m.d.sync += self.started.eq(~self.started)
        with m.If(registers.arm_written):
            m.d.sync += self.armed_with.eq(registers.arm)
        return m


class Talk:
    """Whole requests in, whole responses out."""

    def __init__(self) -> None:
        self.simulation: Simulation = simulate(Board())
        self.level = self.simulation.inputs(1)
        self.level["responses__ready"] = 1

    def exchange(
        self,
        message: bytes,
        *,
        bad: bool = False,
        clocks: int = 4500,
        ready: np.ndarray | None = None,
    ) -> bytes:
        records = np.repeat(self.level, len(message) + 1 + clocks)
        records["requests__payload"][: len(message)] = list(message)
        records["requests__payload"][len(message)] = 1 << 8 | bad << 9
        records["requests__valid"][: len(message) + 1] = 1
        if ready is not None:
            records["responses__ready"] = np.resize(ready, len(records))
        self.outputs = self.simulation.run(records)
        taken = (self.outputs["responses__valid"] & records["responses__ready"]) == 1
        beats = self.outputs["responses__payload"][taken]
        assert not (beats[:-1] >> 8).any()
        assert beats.size == 0 or beats[-1] >> 8
        return bytes((beats & 0xFF).astype(np.uint8))

    def answer(self, request: Request):
        return decode_response(self.exchange(encode_request(request)))


@pytest.fixture(scope="module")
def board(simulator: None) -> Talk:
    return Talk()


def random_request(rng: np.random.Generator, addresses: list[int]) -> bytes:
    op = int(rng.choice([1, 2, 3, 3, 3, 4, 4, 4, 4, 0, 5, 127]))
    address = int(rng.choice([*addresses, *addresses, 0x12, 0x1FF, 0x200, 0x1100, 0xFFFF]))
    count = int(rng.choice([0, 1, 1, 2, 3, 8, 16, rng.integers(256), 64, 65]))
    words = count if (op == 4) == (rng.random() < 0.95) else int(rng.integers(3))
    payload = rng.integers(0, 1 << 32, min(words, 64)).tolist()
    version = 1 if rng.random() < 0.97 else int(rng.integers(256))
    message = bytearray(
        encode_request(
            Request(int(rng.integers(1 << 16)), op, address, count, tuple(payload), version)
        )
    )
    kind = rng.integers(12)
    if kind == 0:
        message[rng.integers(len(message))] ^= 1 << rng.integers(8)
    elif kind == 1:
        del message[rng.integers(len(message)) :]
    elif kind == 2:
        message += bytes(int(rng.integers(300)))
    elif kind == 3:  # a response, CRC and all
        message = bytearray(encode_request(Request(1, op | 0x80, address, count)))
    return bytes(message)


def software_board() -> SoftwareRegisterFile:
    software = SoftwareRegisterFile(MAP)
    software.set("serial", value=0x0123_4567_89AB_CDEF)
    software.set("limit", 1, **MAP["limit"].decode(0xABCD))
    return software


def test_random_requests(simulator: None):
    """Answers, results, counters and everything that can be read afterwards are the same."""
    board, software = Talk(), software_board()
    locked = False
    software._refuses = lambda *place: locked and is_locked(*place)
    rng = np.random.default_rng(5)
    addresses = [address for address in range(0x200) if address in MAP]
    kinds = set()
    for _ in range(700):
        locked = bool(rng.integers(2))
        board.level["locked"] = locked
        message = random_request(rng, addresses)
        found, wanted = board.exchange(message), software.handle(message) or b""
        if not wanted:
            assert found == b""
            continue
        got, want = decode_response(found), decode_response(wanted)
        assert replace(got, payload=()) == replace(want, payload=())
        kinds.add(got.result)
        base = {1: 0, 2: 8}.get(got.op, got.address)
        for place, (a, b) in enumerate(zip(got.payload, want.payload, strict=True), base):
            assert a == b or place in UPTIME, hex(place)
    assert kinds == set(Result)
    for address in addresses:
        message = encode_request(read(1, address))
        if address not in UPTIME:
            assert board.exchange(message, clocks=600) == software.handle(message)


def test_every_bit_flip_of_a_write_changes_nothing(board: Talk):
    """Nothing but the error counter moves; the next good request works."""
    address = MAP["trigger_period"].address
    board.answer(write(1, address, [777]))
    message = encode_request(write(2, address, [0x5A5]))
    before = MAP["request_errors"].decode(board.answer(status(3)).payload[5])
    for bit in range(8 * len(message)):
        damaged = bytearray(message)
        damaged[bit // 8] ^= 1 << bit % 8
        assert board.exchange(bytes(damaged), clocks=300) == b""
        assert (board.outputs["period"] == 777).all()
    after = MAP["request_errors"].decode(board.answer(status(3)).payload[5])
    assert after["crc"] - before["crc"] == 8 * len(message)
    assert board.answer(write(4, address, [0x5A5])).result == Result.OK
    assert board.outputs["period"][-1] == 0x5A5


def test_every_truncation_changes_nothing(board: Talk):
    address = MAP["trigger_period"].address
    board.answer(write(1, address, [778]))
    message = encode_request(write(2, address, [1, 1]))
    for length in range(len(message)):
        assert board.exchange(message[:length], clocks=300) == b""
        assert (board.outputs["period"] == 778).all()
    assert board.exchange(message, bad=True, clocks=300) == b""
    assert (board.outputs["period"] == 778).all()


def test_back_to_back_requests_are_answered_in_order(board: Talk):
    """Two fit; a third that comes before the first is answered is dropped and counted."""
    requests = [write(number, MAP["scratch"].address, [number]) for number in range(3)]
    stream = [encode_request(request) for request in requests]
    records = np.repeat(board.level, 3000)
    at = 0
    for message in stream:
        records["requests__payload"][at : at + len(message)] = list(message)
        records["requests__payload"][at + len(message)] = 1 << 8
        records["requests__valid"][at : at + len(message) + 1] = 1
        at += len(message) + 1
    outputs = board.simulation.run(records)
    beats = outputs["responses__payload"][outputs["responses__valid"] == 1]
    ends = np.flatnonzero(beats >> 8) + 1
    answers = [
        decode_response(bytes((part & 0xFF).astype(np.uint8)))
        for part in np.split(beats, ends)[:-1]
    ]
    assert [answer.transaction for answer in answers] == [0, 1]
    assert board.answer(read(9, MAP["scratch"].address)).payload == (1,)


def test_an_answer_waits_for_a_slow_link(board: Talk):
    """Whenever the link takes bytes, they are the same bytes."""
    message = encode_request(identify(77))
    wanted = board.exchange(message)
    for seed in range(5):
        ready = np.random.default_rng(seed).random(5000) < (0.05, 0.2, 0.5, 0.8, 0.95)[seed]
        assert board.exchange(message, clocks=6000, ready=ready.astype(np.uint32)) == wanted


def test_uptime_counts_device_clocks_and_its_high_word_holds(board: Talk):
    low = MAP["uptime"].address
    first = board.answer(read(1, low, 2)).payload
    second = board.answer(read(1, low, 2)).payload
    spent = (second[0] | second[1] << 32) - (first[0] | first[1] << 32)
    assert spent == 3 * (len(encode_request(read(1, low, 2))) + 1 + 4500)


def test_pulse_and_key_registers_act_once(board: Talk):
    board.answer(write(1, MAP["sequencer_control"].address, [1]))
    assert np.count_nonzero(np.diff(board.outputs["started"].astype(int))) == 1
    board.answer(write(1, MAP["arm"].address, [0x214D5241]))
    assert board.outputs["armed_with"][-1] == 0x214D5241
    assert board.answer(read(1, MAP["arm"].address)).payload == (0,)


def test_a_held_bit_is_cleared_unless_it_is_set_again(board: Talk):
    address = MAP["faults"].address
    board.level["faults"] = 0b10
    board.answer(identify(1))
    board.level["faults"] = 0
    assert board.answer(read(1, address)).payload == (0b10,)
    board.answer(write(1, address, [0b01]))
    assert board.answer(read(1, address)).payload == (0b10,)
    board.level["faults"] = 0b10  # set in the very clock of the write, and all others
    board.answer(write(1, address, [0b10]))
    board.level["faults"] = 0
    assert board.answer(read(1, address)).payload == (0b10,)
    board.answer(write(1, address, [0b10]))
    assert board.answer(read(1, address)).payload == (0,)


def test_every_access_is_in_the_map():
    assert {register.access for register in MAP} == set(Access)


def test_requests_that_software_drops_are_dropped(board: Talk):
    for message in (b"", b"\0" * 12, bytes(500), bytes(700)):
        with pytest.raises(MessageError):
            decode_request(message)
        assert board.exchange(message) == b""
    assert board.answer(identify(5)).result == Result.OK
