# SPDX-License-Identifier: Apache-2.0
"""Golden vectors of the control protocol on the serial line, and of COBS alone.

Each dialogue states by hand what a freshly reset illuminator of 32 channels answers.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import hueflight_protocol as hp
from hueflight_protocol import control

CHANNELS = 32
MAP = hp.illuminator_map(channels=CHANNELS)
PULSE = 0x100
TRIGGER = 0x020
SCRATCH = 0x00F
HOLE = 0x0FFF
ONES = 0xFFFF_FFFF

Vector = tuple[str, bytes, dict[str, Any]]


@dataclass
class Dialogue:
    """Bytes from host to board, and the answers that they must get."""

    about: str
    data: bytearray = field(default_factory=bytearray)
    answers: list[dict[str, Any]] = field(default_factory=list)
    crc_errors: int = 0
    framing_errors: int = 0

    def ask(
        self, request: hp.Request, *words: int, result: hp.Result = hp.Result.OK, **changes: int
    ) -> None:
        """Add a request and the answer to it."""
        message = hp.encode_request(request)
        for at, byte in changes.items():
            message = sealed(message, int(at.removeprefix("byte")), byte)
        self.data += hp.serial_frame(message)
        response = hp.Response(request.transaction, request.op, request.address, result, words)
        wire = hp.serial_frame(hp.encode_response(response))
        answer = asdict(response)
        answer["wire"] = wire.hex()
        self.answers.append(answer)

    def lose(self, wire: bytes, *, crc: int = 0, framing: int = 0) -> None:
        """Add bytes that get no answer, and say which errors they count."""
        self.data += wire
        self.crc_errors += crc
        self.framing_errors += framing

    def finished(self, name: str) -> Vector:
        """Return the vector."""
        expectation = {
            "about": self.about,
            "kind": "serial",
            "board": "illuminator",
            "channels": CHANNELS,
            "bytes": len(self.data),
            "answers": self.answers,
            "crc_errors": self.crc_errors,
            "framing_errors": self.framing_errors,
        }
        return name, bytes(self.data), expectation


def sealed(message: bytes, at: int, byte: int) -> bytes:
    """Return a message with one byte replaced and its CRC made right again."""
    body = message[:at] + bytes([byte]) + message[at + 1 : -4]
    return body + hp.crc32c(body).to_bytes(4, "little")


def reading() -> Iterator[Vector]:
    """Yield dialogues that only read."""
    talk = Dialogue("The identity block, by its operation and by reading.")
    board = int.from_bytes(b"HILL", "little")
    identity = (board, 1, MAP.fingerprint, 0, 0, 200_000_000, 0, 0)
    talk.ask(control.identify(0), *identity)
    talk.ask(control.read(0xFFFF, 0, 8), *identity)
    yield talk.finished("control-identify")
    talk = Dialogue("The status block; it counts the requests answered before.")
    for number in range(3):
        talk.ask(control.status(number), 0, 0, 0, 0, number, 0, 1 << 31, 0)
    yield talk.finished("control-status")
    talk = Dialogue("Reading one word, and the most words that a request can.")
    talk.ask(control.read(1, 0x021), 256)
    talk.ask(control.read(2, PULSE, 64), *[0] * 64)
    yield talk.finished("control-read")


def writing() -> Iterator[Vector]:
    """Yield dialogues that write and read back."""
    talk = Dialogue("Writing one word and three.")
    talk.ask(control.write(1, SCRATCH, [0xDEADBEEF]))
    talk.ask(control.read(2, SCRATCH), 0xDEADBEEF)
    talk.ask(control.write(3, PULSE + 4, [8 << 16, 8 << 16 | 24, 8 << 16 | 48]))
    talk.ask(control.read(4, PULSE + 3, 5), 0, 8 << 16, 8 << 16 | 24, 8 << 16 | 48, 0)
    yield talk.finished("control-write")
    talk = Dialogue("The longest request, without a zero byte for 256 bytes; reserved bits read 0.")
    talk.ask(control.write(1, PULSE, [ONES] * 64))
    talk.ask(control.read(2, PULSE, 64), *[0x0FFF_0FFF] * 64)
    yield talk.finished("control-write-longest")
    talk = Dialogue("PULSE and KEY registers read 0; writing to them is answered.")
    talk.ask(control.write(1, 0x022, [1]))
    talk.ask(control.write(2, 0x018, [0]))
    talk.ask(control.read(3, 0x022), 0)
    talk.ask(control.read(4, 0x018), 0)
    yield talk.finished("control-pulse")
    talk = Dialogue("A block write is all or nothing: the hole after the program refuses it.")
    talk.ask(control.write(1, 0x0FF, [5, 6]))
    talk.ask(control.read(2, 0x0FF, 2), 5, 6 & 0x0FFF_0FFF)
    talk.ask(control.write(3, 0x1FE, [1, 2, 3]), result=hp.Result.BAD_ADDRESS)
    talk.ask(control.read(4, 0x1FE, 2), 0, 0)
    talk.ask(control.write(5, SCRATCH, [1, 2]), result=hp.Result.READ_ONLY)
    talk.ask(control.read(6, SCRATCH), 0)
    yield talk.finished("control-atomic")


def refusals() -> Iterator[Vector]:
    """Yield well-formed requests that are refused."""
    result = hp.Result
    talk = Dialogue("Operations that do not exist.")
    for op in (0, 5, 0x7F):
        talk.ask(hp.Request(op, op), result=result.BAD_OP)
    yield talk.finished("control-bad-op")
    talk = Dialogue("Versions that do not exist; the answer carries the board's own.")
    for version in (0, 2, 255):
        talk.ask(hp.Request(version, 3, SCRATCH, 1, version=version), result=result.BAD_VERSION)
    yield talk.finished("control-bad-version")
    talk = Dialogue("Counts of 0 and 65, a read with payload, counts that are not the payload's.")
    for number, request in enumerate(
        (
            hp.Request(0, hp.Op.READ, SCRATCH, 0),
            hp.Request(1, hp.Op.READ, PULSE, 65),
            hp.Request(2, hp.Op.READ, SCRATCH, 1, (1,)),
            hp.Request(3, hp.Op.WRITE, SCRATCH, 0),
            hp.Request(4, hp.Op.WRITE, PULSE, 1, (1, 2)),
            hp.Request(5, hp.Op.WRITE, PULSE, 2, (1,)),
            hp.Request(6, hp.Op.IDENTIFY, 0, 0, (1,)),
        )
    ):
        talk.ask(request, result=result.BAD_COUNT)
        talk.ask(control.read(100 + number, SCRATCH), 0)
    yield talk.finished("control-bad-count")
    talk = Dialogue("Addresses without a register, and across the end of the address space.")
    talk.ask(control.read(1, HOLE), result=result.BAD_ADDRESS)
    talk.ask(control.write(2, HOLE, [0]), result=result.BAD_ADDRESS)
    talk.ask(control.read(3, 0x1FF, 2), result=result.BAD_ADDRESS)
    talk.ask(control.read(4, 0xFFFF, 2), result=result.BAD_ADDRESS)
    yield talk.finished("control-bad-address")
    talk = Dialogue("Writing what cannot be written.")
    talk.ask(control.write(1, 0x000, [0]), result=result.READ_ONLY)
    talk.ask(control.write(2, 0x028, [0]), result=result.READ_ONLY)
    yield talk.finished("control-read-only")
    talk = Dialogue("Several things wrong at once: the lowest result number is answered.")
    talk.ask(hp.Request(1, 9, HOLE, 99, version=9), result=result.BAD_VERSION)
    talk.ask(hp.Request(2, 9, HOLE, 99), result=result.BAD_OP)
    talk.ask(hp.Request(3, hp.Op.WRITE, HOLE, 99), result=result.BAD_COUNT)
    talk.ask(hp.Request(4, hp.Op.WRITE, 0x1FF, 2, (0, 0)), result=result.BAD_ADDRESS)
    yield talk.finished("control-precedence")
    talk = Dialogue("Bytes that a device must ignore: result in a request, address of IDENTIFY.")
    talk.ask(control.read(1, SCRATCH), 0, byte7=0x55)
    board = int.from_bytes(b"HILL", "little")
    identity = (board, 1, MAP.fingerprint, 0, 0, 200_000_000, 0, 0)
    talk.ask(hp.Request(2, hp.Op.IDENTIFY, HOLE, 99), *identity)
    yield talk.finished("control-ignored-fields")


def damage() -> Iterator[Vector]:
    """Yield bytes that change nothing and get no answer, with good requests around them."""
    write = hp.encode_request(control.write(7, SCRATCH, [0x01020304]))

    def around(name: str, about: str, wire: bytes, **errors: int) -> Vector:
        talk = Dialogue(about)
        talk.ask(control.read(1, SCRATCH), 0)
        talk.lose(wire, **errors)
        talk.ask(control.read(2, SCRATCH), 0)
        return talk.finished(name)

    flipped = bytes([*write[:9], write[9] ^ 4, *write[10:]])
    yield around(
        "control-bit-flip", "A write with one bit flipped.", hp.serial_frame(flipped), crc=1
    )
    yield around(
        "control-bad-crc",
        "A write whose CRC is wrong.",
        hp.serial_frame(write[:-1] + bytes([write[-1] ^ 0x80])),
        crc=1,
    )
    yield around(
        "control-truncated", "A write that lost its end.", hp.serial_frame(write[:-3]), framing=1
    )
    yield around("control-empty-body", "Eight bytes.", hp.serial_frame(write[:8]), framing=1)
    yield around("control-broken-cobs", "A COBS code beyond the end.", b"\x20abc\0", framing=1)
    yield around(
        "control-overlong",
        "A frame longer than any message, with a good one inside its tail.",
        b"\x55" * 300 + hp.cobs_encode(write) + b"\0",
        framing=1,
    )
    yield around("control-idle", "Delimiters alone count nothing.", b"\0\0\0\0")
    yield around(
        "control-noise", "Noise, ended by a delimiter.", bytes(range(1, 60)) + b"\0", framing=1
    )
    response = hp.encode_response(hp.Response(3, hp.Op.READ, SCRATCH, hp.Result.OK, (1,)))
    yield around(
        "control-response", "A response sent to a board.", hp.serial_frame(response), framing=1
    )
    yield around(
        "control-two-in-one",
        "Two messages in one COBS frame.",
        hp.serial_frame(write + write),
        crc=1,
    )


def cobs_alone() -> Iterator[Vector]:
    """Yield COBS frames at the edges of its blocks."""
    run = bytes(range(1, 255))
    messages = [
        b"\0",
        b"\0\0",
        b"\0\x11\0",
        b"\x11\x22\0\x33",
        b"\x11\x22\x33\x44",
        b"\x11\0\0\0",
        run,
        b"\0" + run,
        run + b"\xff",
        run[1:] + b"\xff\0",
        run[2:] + b"\xff\0\x01",
        run + run,
        b"\xff" * 1000,
    ]
    data = b"".join(hp.cobs_encode(message) + b"\0" for message in messages)
    expectation: dict[str, Any] = {
        "about": "Messages at the edges of COBS blocks.",
        "kind": "cobs",
        "bytes": len(data),
        "messages": [message.hex() for message in messages],
        "damaged": 0,
    }
    yield "cobs-blocks", data, expectation
    data = b"\x05\x11\x22\0" + b"\x03\x11\x22\x02\x33\0" + b"\xff" + run + b"\x01\0"
    expectation = {
        "about": "A code beyond the end; a good frame; a full block with a trailing code 1.",
        "kind": "cobs",
        "bytes": len(data),
        "messages": ["11220033", run.hex()],
        "damaged": 1,
    }
    yield "cobs-damaged", data, expectation


def message_vectors() -> Iterator[Vector]:
    """Yield all vectors of the control protocol."""
    yield from reading()
    yield from writing()
    yield from refusals()
    yield from damage()
    yield from cobs_alone()
