# SPDX-License-Identifier: Apache-2.0
"""Chunks as the MCAP specification lays them out, with each field of their heads wrong in turn."""

from __future__ import annotations

import struct
import zlib

import pytest

from hueflight.recording.records import CHANNEL_ID, decode_chunk

PAYLOAD = b"packets of a camera"
CHUNK, MESSAGE = 6, 5  #: opcodes


def chunk(**wrong: int) -> memoryview:
    """A chunk with one message; `wrong` are added to fields of the heads."""
    length = struct.calcsize("<HIQQ") + len(PAYLOAD) + wrong.get("message_length", 0)
    message = struct.pack("<BQ", MESSAGE + wrong.get("message_opcode", 0), length)
    message += struct.pack("<HIQQ", CHANNEL_ID + wrong.get("channel", 0), 7, 1000, 2000) + PAYLOAD
    size = len(message)
    content = struct.pack(
        "<QQQIIQ",
        *(1000, 1000, size + wrong.get("size", 0), zlib.crc32(message) ^ wrong.get("crc", 0)),
        *(wrong.get("compression", 0), size + wrong.get("stored", 0)),
    )
    content += message
    head = (CHUNK + wrong.get("opcode", 0), len(content) + wrong.get("length", 0))
    return memoryview(struct.pack("<BQ", *head) + content)


def test_a_whole_chunk():
    found = decode_chunk(chunk())
    assert found is not None
    assert (found.log_time, found.publish_time, bytes(found.payload)) == (1000, 2000, PAYLOAD)


@pytest.mark.parametrize(
    "field",
    [
        *("opcode", "length", "size", "crc", "compression", "stored"),
        *("message_opcode", "message_length", "channel"),
    ],
)
@pytest.mark.parametrize("by", [1, -1])
def test_a_chunk_with_a_wrong_field_is_none(field: str, by: int):
    if field in ("crc", "compression"):
        by = 1
    assert decode_chunk(chunk(**{field: by})) is None


def test_what_is_too_short_for_a_chunk_is_none():
    assert decode_chunk(chunk()[: -len(PAYLOAD) - 1]) is None
    assert decode_chunk(memoryview(b"")) is None
