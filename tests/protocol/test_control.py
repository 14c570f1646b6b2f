# SPDX-License-Identifier: Apache-2.0
"""Control messages: inverse, every bit flip refused, and how a board answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight_protocol as hp
from hueflight_protocol import control

words = st.lists(st.integers(0, 2**32 - 1), max_size=64).map(tuple)
u8, u16 = st.integers(0, 255), st.integers(0, 65535)
requests = st.builds(hp.Request, u16, st.integers(0, 127), u16, u8, words, u8)
responses = st.builds(hp.Response, u16, st.integers(0, 127), u16, u8, words, u8)


@given(requests)
def test_requests(request: hp.Request):
    message = hp.encode_request(request)
    assert hp.decode_request(message) == request
    assert len(message) <= control.MAX_MESSAGE_BYTES
    assert len(hp.serial_frame(message)) <= control.MAX_COBS_BYTES + 1
    assert hp.cobs_decode(hp.serial_frame(message)[:-1]) == message


@given(responses)
def test_responses(response: hp.Response):
    assert hp.decode_response(hp.encode_response(response)) == response


def test_every_bit_flip_is_refused_and_changes_nothing():
    board = hp.RegisterFile(hp.illuminator_map())
    message = hp.encode_request(control.write(7, 0x00F, [0x12345678]))
    for bit in range(8 * len(message)):
        flipped = bytearray(message)
        flipped[bit // 8] ^= 1 << bit % 8
        assert board.handle(bytes(flipped)) is None
    assert board.get("scratch") == 0
    assert board.registers["request_errors"].decode(board.get("request_errors"))["crc"] == 8 * 16
    assert board.handle(message) is not None
    assert board.get("scratch") == 0x12345678


@pytest.mark.parametrize("size", [0, 8, 11, 13, 272])
def test_impossible_lengths(size: int):
    with pytest.raises(hp.MessageError, match=f"{size} bytes: must be 12 to 268"):
        hp.decode_request(bytes(size))


def test_directions_are_told_apart():
    request = hp.encode_request(control.identify(1))
    response = hp.encode_response(hp.Response(1, hp.Op.IDENTIFY))
    with pytest.raises(hp.MessageError, match="op 0x01 is a request"):
        hp.decode_response(request)
    with pytest.raises(hp.MessageError, match="op 0x81 is a response"):
        hp.decode_request(response)


def test_a_response_whose_count_lies_is_refused():
    message = bytearray(hp.encode_response(hp.Response(1, hp.Op.READ, 0, 0, (1, 2))))
    message[6] = 1
    message[-4:] = hp.crc32c(message[:-4]).to_bytes(4, "little")
    with pytest.raises(hp.MessageError, match="says 1 words and has 2"):
        hp.decode_response(bytes(message))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: control.read(1, 0, 0), "count = 0: a read takes 1 to 64 words"),
        (lambda: control.read(1, 0, 65), "count = 65"),
        (lambda: control.write(1, 0, []), "0 words: a write takes 1 to 64"),
        (lambda: control.write(1, 0, [0] * 65), "65 words"),
        (lambda: hp.encode_request(control.write(1, 0, [1 << 32])), "word 0 is 4294967296"),
        (lambda: hp.encode_request(control.read(1, 1 << 16)), "address = 65536: must be"),
        (lambda: hp.encode_request(hp.Request(1, 3, 0, 0, (0,) * 65)), "at most 64"),
    ],
)
def test_what_cannot_be_sent_is_refused(make, message: str):
    with pytest.raises(hp.ProtocolError, match=message):
        make()


@settings(max_examples=300)
@given(requests)
def test_every_well_formed_request_is_answered(request: hp.Request):
    board = hp.RegisterFile(hp.illuminator_map())
    before = {name: board.get(name) for name in ("scratch", "trigger", "bank_select")}
    answer = board.handle(hp.encode_request(request))
    assert answer is not None
    response = hp.decode_response(answer)
    assert (response.transaction, response.op) == (request.transaction, request.op)
    assert response.version == control.CONTROL_VERSION
    assert response.result in list(hp.Result)
    if response.result != hp.Result.OK:
        assert response.payload == ()
        assert {name: board.get(name) for name in before} == before


def ask(board: hp.RegisterFile, request: hp.Request) -> hp.Response:
    answer = board.handle(hp.encode_request(request))
    assert answer is not None
    return hp.decode_response(answer)


def test_a_board_acts_on_pulses_and_keys_and_can_refuse():
    seen: list[tuple[str, tuple[int, ...], int]] = []
    board = hp.RegisterFile(
        hp.illuminator_map(),
        on_write=lambda register, indices, word: seen.append((register.name, indices, word)),
        refuses=lambda register, indices, _: register.name == "pulse" and indices[0] == 0,
    )
    assert ask(board, control.write(1, 0x018, [0x214D5241])).result == hp.Result.OK
    address = board.registers["pulse"].address_of(1, 2, 3)
    assert ask(board, control.write(2, address, [0x00080018])).result == hp.Result.OK
    assert seen == [("arm", (), 0x214D5241), ("pulse", (1, 2, 3), 0x00080018)]
    address = board.registers["pulse"].address_of(0, 0, 0)
    assert ask(board, control.write(3, address, [1])).result == hp.Result.REFUSED
    assert board.get("pulse", 0, 0, 0) == 0
    assert len(seen) == 2
    with pytest.raises(hp.RegisterError, match="pulse takes 3 indices, got"):
        board.get("pulse", 0)


def test_w1c_bits_are_cleared_by_ones():
    board = hp.RegisterFile(hp.illuminator_map())
    board.set("faults", watchdog=1, on_limit=1)
    assert ask(board, control.write(1, board.registers["faults"].address, [1])).result == 0
    assert board.registers["faults"].decode(board.get("faults"))["on_limit"] == 1
    assert board.registers["faults"].decode(board.get("faults"))["watchdog"] == 0


def test_the_high_word_is_that_of_the_low_words_moment():
    board = hp.RegisterFile(hp.illuminator_map())
    address = board.registers["uptime"].address
    board.set("uptime", value=0xFFFF_FFFF)
    assert ask(board, control.read(1, address)).payload == (0xFFFF_FFFF,)
    board.set("uptime", value=0x1_0000_0005)
    assert ask(board, control.read(2, address + 1)).payload == (0,)
    assert ask(board, control.read(3, address, 2)).payload == (5, 1)


def test_error_counters_saturate():
    board = hp.RegisterFile(hp.illuminator_map())
    board.set("request_errors", crc=65535, framing=65535)
    board.count_error("crc")
    board.handle(b"")
    assert board.get("request_errors") == 0xFFFF_FFFF


def test_the_identity_carries_the_maps_fingerprint():
    for registers in (hp.illuminator_map(channels=3), hp.camera_map(rows=64)):
        board = hp.RegisterFile(registers)
        payload = ask(board, control.identify(1)).payload
        assert payload[2] == registers.fingerprint
        name = np.array(payload[:1], "<u4").tobytes()
        assert name == {"illuminator": b"HILL", "camera": b"HCAM"}[registers.name]
