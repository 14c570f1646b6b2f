# SPDX-License-Identifier: Apache-2.0
"""Control messages: one request, one response, the same layout both ways and on both boards.

A message is eight bytes of header, 0 to 64 words of payload, and a CRC-32C. On the serial
line it travels as a COBS frame, on USB as one bulk transfer; 268 bytes fit one high-speed
packet. See ``docs/protocol.md``, section *Control*.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from construct import Struct

from .checksum import crc32c
from .cobs import cobs_encode
from .errors import MessageError, ProtocolError
from .layout import U8, U16, U32, Layout

CONTROL_VERSION = 1
MAX_WORDS = 64
MAX_TRANSACTION = (1 << 16) - 1
RESPONSE_BIT = 0x80
"""Set in ``op`` of a response."""


class Op(IntEnum):
    """What a request asks for."""

    IDENTIFY = 1
    """The identity block: the same as reading `IDENTITY_WORDS` words from address 0."""
    STATUS = 2
    """The status block: the same as reading `STATUS_WORDS` words after the identity."""
    READ = 3
    """`count` words from consecutive addresses."""
    WRITE = 4
    """The payload's words to consecutive addresses: all of them, or none."""


class Result(IntEnum):
    """How a request ended."""

    OK = 0
    BAD_VERSION = 1
    BAD_OP = 2
    BAD_COUNT = 3
    BAD_ADDRESS = 4
    """At least one address has no register."""
    READ_ONLY = 5
    """At least one address cannot be written."""
    REFUSED = 6
    """The device's state does not allow it now, such as a schedule bank in use."""


CONTROL_HEADER = Layout(
    Struct(
        "version" / U8 * "1",
        "op" / U8 * "see operations; bit 7 is set in a response",
        "transaction" / U16 * "chosen by the host, repeated in the response",
        "address" / U16 * "word address of the first register",
        "count" / U8 * "words asked for (read), or in the payload (all others)",
        "result" / U8 * "0 in a request; see results",
    )
)
"""First eight bytes of a control message."""

CONTROL_CRC_BYTES: int = U32.sizeof()
MAX_MESSAGE_BYTES = CONTROL_HEADER.size + 4 * MAX_WORDS + CONTROL_CRC_BYTES
MIN_MESSAGE_BYTES = CONTROL_HEADER.size + CONTROL_CRC_BYTES
MAX_COBS_BYTES = MAX_MESSAGE_BYTES + 2
"""Longest encoded message, delimiter not counted."""

IDENTITY_ADDRESS = 0x000
IDENTITY_WORDS = 8
STATUS_ADDRESS = 0x008
STATUS_WORDS = 8


@dataclass(frozen=True, slots=True)
class Request:
    """What the host asks.

    Parameters
    ----------
    transaction : int
        0 to 65535, repeated in the response.
    op : int
        An `Op`; other values are what a device answers with `Result.BAD_OP`.
    address : int
        Word address of the first register; 0 for `Op.IDENTIFY` and `Op.STATUS`.
    count : int
        Words to read, or words in `payload`; 0 for `Op.IDENTIFY` and `Op.STATUS`.
    payload : tuple of int
        Words to write, empty otherwise.
    version : int
        Of the control protocol.
    """

    transaction: int
    op: int
    address: int = 0
    count: int = 0
    payload: tuple[int, ...] = ()
    version: int = CONTROL_VERSION


@dataclass(frozen=True, slots=True)
class Response:
    """What the device answers.

    Parameters
    ----------
    transaction, op, address : int
        As in the request; `op` without the response bit.
    result : int
        A `Result`.
    payload : tuple of int
        Words read; empty unless `result` is OK.
    version : int
        Of the device's control protocol.
    """

    transaction: int
    op: int
    address: int = 0
    result: int = Result.OK
    payload: tuple[int, ...] = ()
    version: int = CONTROL_VERSION


def identify(transaction: int, /) -> Request:
    """Return a request for the identity block."""
    return Request(transaction, Op.IDENTIFY)


def status(transaction: int, /) -> Request:
    """Return a request for the status block."""
    return Request(transaction, Op.STATUS)


def read(transaction: int, address: int, count: int = 1, /) -> Request:
    """Return a request for `count` words from `address` on."""
    if not 1 <= count <= MAX_WORDS:
        raise ProtocolError(f"count = {count}: a read takes 1 to {MAX_WORDS} words")
    return Request(transaction, Op.READ, address, count)


def write(transaction: int, address: int, words: Sequence[int], /) -> Request:
    """Return a request that writes `words` from `address` on."""
    if not 1 <= len(words) <= MAX_WORDS:
        raise ProtocolError(f"{len(words)} words: a write takes 1 to {MAX_WORDS}")
    return Request(transaction, Op.WRITE, address, len(words), tuple(words))


def encode_request(request: Request, /) -> bytes:
    """Return the message of a request, not yet framed for a transport.

    Parameters
    ----------
    request : Request
        The request.

    Returns
    -------
    bytes
        The message.
    """
    return _encode(
        {
            "version": request.version,
            "op": request.op,
            "transaction": request.transaction,
            "address": request.address,
            "count": request.count,
            "result": 0,
        },
        request.payload,
    )


def encode_response(response: Response, /) -> bytes:
    """Return the message of a response, not yet framed for a transport.

    Parameters
    ----------
    response : Response
        The response.

    Returns
    -------
    bytes
        The message.
    """
    return _encode(
        {
            "version": response.version,
            "op": response.op | RESPONSE_BIT,
            "transaction": response.transaction,
            "address": response.address,
            "count": len(response.payload),
            "result": response.result,
        },
        response.payload,
    )


def serial_frame(message: bytes, /) -> bytes:
    """Return a message as it travels on the serial line: COBS, then a zero byte.

    Parameters
    ----------
    message : bytes
        The message.

    Returns
    -------
    bytes
        The COBS frame and its delimiter.
    """
    return cobs_encode(message) + b"\0"


def decode_request(message: bytes, /) -> Request:
    """Return the request in a well-formed message, whatever it asks for.

    Parameters
    ----------
    message : bytes
        The message, without framing.

    Returns
    -------
    Request
        The request.

    Raises
    ------
    MessageError
        If the message is not well-formed; a device drops it and counts it.
    """
    header, payload = _decode(message)
    if header["op"] & RESPONSE_BIT:
        raise MessageError(f"op {header['op']:#04x} is a response, not a request", rule="C5")
    return Request(
        transaction=header["transaction"],
        op=header["op"],
        address=header["address"],
        count=header["count"],
        payload=payload,
        version=header["version"],
    )


def decode_response(message: bytes, /) -> Response:
    """Return the response in a well-formed message.

    Parameters
    ----------
    message : bytes
        The message, without framing.

    Returns
    -------
    Response
        The response.

    Raises
    ------
    MessageError
        If the message is not well-formed, or its count is not its payload's.
    """
    header, payload = _decode(message)
    if not header["op"] & RESPONSE_BIT:
        raise MessageError(f"op {header['op']:#04x} is a request, not a response", rule="C5")
    if header["count"] != len(payload):
        raise MessageError(
            f"response says {header['count']} words and has {len(payload)}", rule="C6"
        )
    return Response(
        transaction=header["transaction"],
        op=header["op"] & ~RESPONSE_BIT,
        address=header["address"],
        result=header["result"],
        payload=payload,
        version=header["version"],
    )


def _encode(header: dict[str, int], payload: tuple[int, ...]) -> bytes:
    if len(payload) > MAX_WORDS:
        raise ProtocolError(f"{len(payload)} words: a message holds at most {MAX_WORDS}")
    for number, word in enumerate(payload):
        if not 0 <= word < 1 << 32:
            raise ProtocolError(f"word {number} is {word}: must be from 0 to 2**32 - 1")
    body = CONTROL_HEADER.pack(header) + np.asarray(payload, "<u4").tobytes()
    return body + crc32c(body).to_bytes(CONTROL_CRC_BYTES, "little")


def _decode(message: bytes) -> tuple[dict[str, int], tuple[int, ...]]:
    size = len(message)
    if size % 4 or not MIN_MESSAGE_BYTES <= size <= MAX_MESSAGE_BYTES:
        raise MessageError(
            f"{size} bytes: must be {MIN_MESSAGE_BYTES} to {MAX_MESSAGE_BYTES}, a multiple of 4",
            rule="C3",
        )
    stored = int.from_bytes(message[-CONTROL_CRC_BYTES:], "little")
    computed = crc32c(message[:-CONTROL_CRC_BYTES])
    if stored != computed:
        raise MessageError(f"CRC is {stored:#010x}, the bytes give {computed:#010x}", rule="C4")
    words = np.frombuffer(message[CONTROL_HEADER.size : -CONTROL_CRC_BYTES], "<u4")
    return CONTROL_HEADER.unpack(message), tuple(int(word) for word in words)
