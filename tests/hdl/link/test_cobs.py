# SPDX-License-Identifier: Apache-2.0
"""COBS in gateware against the software codec, byte for byte, with any pauses."""

from __future__ import annotations

import numpy as np
import pytest

from hueflight_hdl.link.cobs import CobsDecoder, CobsEncoder
from hueflight_hdl.testbench.cxxrtl import Simulation, simulate
from hueflight_protocol import CobsDecoder as SoftwareDecoder
from hueflight_protocol import cobs_decode, cobs_encode
from hueflight_protocol.control import MAX_COBS_BYTES, MAX_MESSAGE_BYTES


@pytest.fixture(scope="module")
def decoder(simulator: None) -> Simulation:
    return simulate(CobsDecoder())


@pytest.fixture(scope="module")
def encoder(simulator: None) -> Simulation:
    return simulate(CobsEncoder())


def random_message(rng: np.random.Generator) -> bytes:
    """Any length, with few zeros, many, or none: blocks of 254 bytes among them."""
    length = int(rng.choice([1, 2, 12, 253, 254, 255, 256, rng.integers(1, MAX_MESSAGE_BYTES + 1)]))
    data = rng.integers(1, 256, length, dtype=np.uint8)
    data[rng.random(length) < rng.choice([0, 0.01, 0.3, 0.9])] = 0
    return data.tobytes()


def encode(simulation: Simulation, rng: np.random.Generator, message: bytes) -> bytes:
    """Feed a message and take its frame, both with pauses, until its delimiter."""
    out = bytearray()
    fed = 0
    while not (out and out[-1] == 0):
        records = simulation.inputs(1)
        sending = fed < len(message) and rng.random() < 0.8
        if sending:
            records["messages__valid"] = 1
            records["messages__payload"] = message[fed] | (fed == len(message) - 1) << 8
        records["line__ready"] = taking = int(rng.random() < 0.7)
        result = simulation.run(records)[0]
        fed += bool(sending and result["messages__ready"])
        if taking and result["line__valid"]:
            out.append(result["line__payload"])
        assert len(out) <= MAX_COBS_BYTES + 1
    assert fed == len(message)
    return bytes(out[:-1])


def test_encoder(encoder: Simulation):
    rng = np.random.default_rng(1)
    for _ in range(60):
        message = random_message(rng)
        encoded = encode(encoder, rng, message)
        assert encoded == cobs_encode(message)
        assert cobs_decode(encoded) == message


def decode(
    simulation: Simulation, rng: np.random.Generator, line: bytes, bad: frozenset[int] = frozenset()
) -> tuple[list[bytes], int]:
    """Feed bytes with pauses; return the messages, and how many frames were bad."""
    gaps = rng.integers(1, 4, len(line))
    at = np.cumsum(gaps)
    records = simulation.inputs(int(at[-1]) + 4 if len(line) else 4)
    records["line__valid"][at] = 1
    records["line__payload"][at] = list(line)
    for index in bad:
        records["line__payload"][at[index]] |= 1 << 8
    outputs = simulation.run(records)
    messages, damaged, current = [], 0, bytearray()
    for beat in outputs["frames__payload"][outputs["frames__valid"] == 1]:
        data, end, is_bad = int(beat) & 0xFF, beat >> 8 & 1, beat >> 9 & 1
        if not end:
            current.append(data)
            continue
        if is_bad:
            damaged += 1
        else:
            messages.append(bytes(current))
        current.clear()
    return messages, damaged


def test_decoder_on_good_frames(decoder: Simulation):
    rng = np.random.default_rng(2)
    for _ in range(60):
        messages = [random_message(rng) for _ in range(3)]
        idle = [bytes(int(rng.integers(4))) for _ in messages]
        line = b"".join(i + cobs_encode(m) + b"\0" for i, m in zip(idle, messages, strict=True))
        assert decode(decoder, rng, line) == (messages, 0)


def test_decoder_on_noise(decoder: Simulation):
    """Whatever comes, gateware and software see the same messages and as many bad frames."""
    rng = np.random.default_rng(3)
    decode(decoder, rng, b"\0")
    for _ in range(300):
        line = bytearray()
        for _ in range(4):
            frame = bytearray(cobs_encode(random_message(rng)) + b"\0")
            kind = rng.integers(5)
            if kind == 0:  # flipped bits
                for _ in range(3):
                    frame[rng.integers(len(frame))] ^= 1 << rng.integers(8)
            elif kind == 1:  # cut short
                del frame[rng.integers(len(frame)) : -1]
            elif kind == 2:  # two frames in one, most often too long
                frame[-1:] = cobs_encode(random_message(rng)) + b"\0"
            elif kind == 3:  # anything
                frame = bytearray(rng.integers(0, 256, rng.integers(1, 400), dtype=np.uint8))
            line += frame
        line += b"\0"
        software = SoftwareDecoder(limit=MAX_COBS_BYTES)
        messages = software.feed(bytes(line))
        bad = software.damaged + software.overlong
        assert decode(decoder, rng, bytes(line)) == (messages, bad), bytes(line).hex()


def test_a_byte_without_stop_bit_spoils_its_frame(decoder: Simulation):
    rng = np.random.default_rng(4)
    message = bytes(range(20))
    line = cobs_encode(message) + b"\0"
    for index in range(len(line) - 1):
        following = line + line
        assert decode(decoder, rng, following, frozenset({index})) == ([message], 1)


def test_a_trailing_empty_block_is_accepted(decoder: Simulation):
    """Other encoders end a message of 254 bytes with a block of code 1 (rule B2)."""
    message = bytes([7]) * 254
    line = b"\xff" + message + b"\x01\0"
    assert decode(decoder, np.random.default_rng(5), line) == ([message], 0)
