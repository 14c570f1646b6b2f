# SPDX-License-Identifier: Apache-2.0
"""The golden vectors: the generator writes them again, and the package meets them."""

import dataclasses
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hueflight_protocol as hp
from hueflight_protocol.control import MAX_COBS_BYTES

ROOT = Path(__file__).resolve().parents[2]
VECTORS = ROOT / "protocol" / "vectors"
EXPECTATIONS = {path.stem: json.loads(path.read_text()) for path in sorted(VECTORS.glob("*.json"))}


def names(kind: str) -> list[str]:
    return [name for name, expected in EXPECTATIONS.items() if expected["kind"] == kind]


def read(name: str) -> bytes:
    return (VECTORS / f"{name}.bin").read_bytes()


def test_generator_writes_the_same_bytes_again(tmp_path: Path):
    subprocess.run([sys.executable, ROOT / "tools" / "vectors.py", tmp_path], check=True)
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    kept = {path.name: path.read_bytes() for path in VECTORS.iterdir() if path.suffix != ".md"}
    assert sorted(written) == sorted(kept)
    assert [name for name in kept if kept[name] != written[name]] == []


def test_the_set_is_whole_and_small():
    assert len(EXPECTATIONS) >= 40
    assert {path.stem for path in VECTORS.glob("*.bin")} == set(EXPECTATIONS)
    assert sum(path.stat().st_size for path in VECTORS.iterdir()) < 1_000_000


SUMS_FIELDS = (
    "picture", "first_pixel", "rows", "cols", "frames", "missed", "photons", "saturated", "tables",
    "offsets", "periods", "code_bits", "flags",
)  # fmt: skip


def described(packet: hp.Packet) -> dict:
    """A delivered packet in the words of the vectors."""
    content = packet.content
    place = {"offset": packet.offset, "size": len(packet.data)}
    if isinstance(content, hp.Frame):
        header = dataclasses.asdict(content.header) | {"flags": int(content.header.flags)}
        plain = content.codes.astype("<u2").tobytes()
        return place | {
            "kind": "frame",
            **header,
            "hits": int(np.count_nonzero(content.codes)),
            "codes_sha256": hashlib.sha256(plain).hexdigest(),
        }
    fields = {
        field.name: getattr(content, field.name)
        for field in dataclasses.fields(content)
        if field.name != "header"
    }
    if isinstance(content, hp.TestPattern):
        words = content.words
        fields = {
            "pattern": content.pattern,
            "seed": words[0],
            "words": words.size,
            "last_word": words[-1],
            "errors": content.errors(),
        }
    if isinstance(content, hp.Sums):
        fields = {name: getattr(content, name) for name in SUMS_FIELDS}
        lists = {"widths": list(content.widths), "values": content.values.tolist()}
        head = dataclasses.asdict(content.header)
        return place | {"kind": "sums"} | head | fields | lists
    if isinstance(content, hp.Opaque):
        fields["body"] = content.body.hex()
    kind = {"TestPattern": "test"}.get(type(content).__name__, type(content).__name__.lower())
    return place | {"kind": kind, **dataclasses.asdict(content.header), **fields}


PIECES = [
    (name, piece)
    for name in names("packets")
    for piece in (1, 7, 64, 1 << 20)
    if piece > 1 or EXPECTATIONS[name]["bytes"] < 3000  # byte by byte takes its time
]


@pytest.mark.parametrize(("name", "piece"), PIECES)
def test_parser_meets(name: str, piece: int):
    data, expected = read(name), EXPECTATIONS[name]
    parser = hp.PacketParser()
    packets = []
    for at in range(0, len(data), piece):
        packets += parser.feed(data[at : at + piece])
    packets += parser.finish()
    assert dataclasses.asdict(parser.report) == expected["report"]
    assert len(parser.damage) == len(expected["damage"])
    for found, wanted in zip(parser.damage, expected["damage"], strict=True):
        assert found.offset == wanted["offset"]
        assert found.rule == wanted.get("rule", found.rule)
    assert len(packets) == len(expected["packets"])
    for packet, wanted in zip(packets, expected["packets"], strict=True):
        assert packet.data == data[packet.offset : packet.offset + wanted["size"]]
        hits = wanted.get("pixels_and_codes")
        if hits is not None and isinstance(packet.content, hp.Frame):
            flat = packet.content.codes.reshape(-1)
            assert [[int(p), int(flat[p])] for p in np.flatnonzero(flat)] == hits
        assert described(packet) == {k: v for k, v in wanted.items() if k != "pixels_and_codes"}


@pytest.mark.parametrize("name", names("serial"))
def test_register_file_answers(name: str):
    expected = EXPECTATIONS[name]
    board = hp.RegisterFile(hp.illuminator_map(channels=expected["channels"]))
    line = hp.CobsDecoder(limit=MAX_COBS_BYTES)
    answers = [
        answer for message in line.feed(read(name)) if (answer := board.handle(message)) is not None
    ]
    assert [hp.serial_frame(answer).hex() for answer in answers] == [
        answer["wire"] for answer in expected["answers"]
    ]
    for answer, wanted in zip(answers, expected["answers"], strict=True):
        fields = dataclasses.asdict(hp.decode_response(answer))
        fields["payload"] = list(fields["payload"])
        assert fields == {k: v for k, v in wanted.items() if k != "wire"}
    errors = board.registers["request_errors"].decode(board.get("request_errors"))
    assert errors["crc"] == expected["crc_errors"]
    assert errors["framing"] + line.damaged + line.overlong == expected["framing_errors"]


@pytest.mark.parametrize("piece", [1, 100, 1 << 20])
@pytest.mark.parametrize("name", names("cobs"))
def test_cobs_decoder_meets(name: str, piece: int):
    data, expected = read(name), EXPECTATIONS[name]
    line = hp.CobsDecoder(limit=1 << 16)
    messages = []
    for at in range(0, len(data), piece):
        messages += line.feed(data[at : at + piece])
    assert [message.hex() for message in messages] == expected["messages"]
    assert line.damaged == expected["damaged"]
    if not expected["damaged"]:
        assert b"".join(hp.cobs_encode(message) + b"\0" for message in messages) == data
