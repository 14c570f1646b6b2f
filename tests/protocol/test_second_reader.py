# SPDX-License-Identifier: Apache-2.0
"""A second reader of the stream, written from docs/protocol.md alone, bit by bit.

It shares no line with the package: if the two agree on the golden vectors, then the document
says what the code does.
"""

import hashlib
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight_protocol as hp

VECTORS = Path(__file__).resolve().parents[2] / "protocol" / "vectors"
PACKETS = [
    path
    for path in sorted(VECTORS.glob("*.json"))
    if json.loads(path.read_text())["kind"] == "packets"
]


class Broken(Exception):  # noqa: N818
    """A rule is broken."""

    def __init__(self, rule, *, header=True):
        super().__init__(rule)
        self.rule = rule
        self.header = header  # whether it was a rule of the header, P2 to P5


def crc(data):
    """Rocksoft model: width 32, poly 0x1EDC6F41, init and xorout all ones, reflected."""
    state = 0xFFFFFFFF
    for byte in data:
        state ^= byte
        for _ in range(8):
            state = state >> 1 ^ (0x82F63B78 if state & 1 else 0)
    return state ^ 0xFFFFFFFF


def number(data, at, size):
    if at + size > len(data):
        raise Broken("P7", header=False)
    return sum(data[at + k] << 8 * k for k in range(size))


def bits(data, at, count):
    """Bits `at` to `at + count - 1` of a byte string, as a list."""
    return [data[k // 8] >> k % 8 & 1 for k in range(at, at + count)]


def value(some_bits):
    return sum(bit << k for k, bit in enumerate(some_bits))


def pad(size, multiple):
    while size % multiple:
        size += 1
    return size


def read_header(data):
    if data[:4] != b"\xa7Hue":
        raise Broken("P2")
    if number(data, 4, 1) != 1:
        raise Broken("P3")
    kind, size = number(data, 5, 1), number(data, 6, 2)
    wanted = {1: 64, 2: 32, 3: 32, 4: 32, 5: 32}.get(kind, size)
    if size != wanted or size % 8 or not 32 <= size <= 256:
        raise Broken("P4")
    folded = 0
    for at in range(0, size, 4):
        folded ^= number(data, at, 4)
    if folded:
        raise Broken("P5")
    return kind, size


def check_end(data, size):
    """P6 and P7, for a packet of `size` bytes."""
    if number(data, size - 4, 4) != crc(data[: size - 4]):
        raise Broken("P6", header=False)
    if number(data, size - 8, 4) * 4 != size:
        raise Broken("P7", header=False)


FRAME_FIELDS = {
    "sequence": (12, 4), "timestamp": (16, 8), "frame": (24, 8), "periods": (32, 4),
    "dropped": (36, 4), "rows": (40, 2), "cols": (42, 2), "run": (44, 2), "code_bits": (46, 1),
    "geometry": (47, 1), "flags": (48, 2), "step": (50, 2), "capture": (52, 4), "clock_hz": (56, 4),
}  # fmt: skip


def read_frame(data):
    head = {name: number(data, at, size) for name, (at, size) in FRAME_FIELDS.items()}
    rows, cols, run, width = head["rows"], head["cols"], head["run"], head["code_bits"]

    def need(condition, rule):
        if not condition:
            raise Broken(rule, header=False)

    need(number(data, 8, 4) == 0xFFFFFFFF, "F1")
    need(1 <= rows <= 1024 and 1 <= cols <= 1024 and 1 <= width <= 16, "F2")
    need(8 <= run <= 4096 and run % 8 == 0, "F3")
    runs = (rows * cols + run - 1) // run
    need(runs <= 16384, "F3")
    need(head["flags"] < 128, "F4")
    codes = {}
    at, last, chunks, hits = 64, -1, 0, 0
    while True:
        word = number(data, at, 4)
        kind = word & 3
        if kind == 0:
            need(word == 0 and at % 8 == 4 and number(data, at + 4, 1) & 3 == 3, "F6")
            at += 4
            continue
        if kind == 3:
            break
        index, lit = word >> 2 & 0x3FFF, word >> 16
        need(last < index < runs, "F7")
        n = min(run, rows * cols - index * run)
        need(1 <= lit <= n, "F8")
        bitmap_size = (n + 7) // 8
        as_bitmap = pad(bitmap_size + (lit * width + 7) // 8, 4)
        as_dense = pad((n * width + 7) // 8, 4)
        need(kind == (2 if as_dense <= as_bitmap else 1), "F9")
        size = as_dense if kind == 2 else as_bitmap
        number(data, at + 4, size)  # all there
        payload = data[at + 4 : at + 4 + size]
        if kind == 2:
            found = [value(bits(payload, i * width, width)) for i in range(n)]
            need(not any(bits(payload, n * width, 8 * size - n * width)), "F10")
            need(sum(code != 0 for code in found) == lit, "F11")
        else:
            where = [i for i in range(n) if bits(payload, i, 1)[0]]
            need(not any(bits(payload, n, 8 * bitmap_size - n)), "F10")
            need(len(where) == lit, "F11")
            start = 8 * bitmap_size
            in_order = [value(bits(payload, start + i * width, width)) for i in range(lit)]
            end = start + lit * width
            need(not any(bits(payload, end, 8 * size - end)), "F10")
            need(all(in_order), "F11")
            found = [0] * n
            for i, code in zip(where, in_order, strict=True):
                found[i] = code
        codes |= {index * run + i: code for i, code in enumerate(found) if code}
        at, last, chunks, hits = at + 4 + size, index, chunks + 1, hits + lit
    need(at % 8 == 0, "F6")
    status, counted, total = word >> 2 & 0x3FFF, word >> 16, number(data, at + 4, 4)
    need(status in (0, 1) and counted == chunks and total == hits, "F12")
    check_end(data, at + 16)
    return at + 16, head, None if status else {"kind": "frame", **head, "codes": codes}


def read_other(data, kind, header_size):
    length = number(data, 8, 4)
    if length > 1 << 20:
        raise Broken("P8", header=False)
    size = header_size + pad(length, 8) + 8
    number(data, size - 4, 4)
    check_end(data, size)
    if any(data[header_size + length : size - 8]):
        raise Broken("P8", header=False)
    body = data[header_size : header_size + length]
    head = {"sequence": number(data, 12, 4), "timestamp": number(data, 16, 8)}
    head["capture"] = number(data, 24, 4)
    return size, head, {**head, **read_body(kind, body)}


def signed(raw, width):
    return raw - (1 << width) if raw >> width - 1 else raw


def read_body(kind, body):
    sizes_ok = {2: len(body) == 16, 3: len(body) == 32, 4: len(body) >= 8 and len(body) % 4 == 0}
    if not sizes_ok.get(kind, True):
        raise Broken("E1", header=False)
    if kind == 2:
        if body[2] > 2 or body[3]:
            raise Broken("E2", header=False)
        return {
            "kind": "event",
            "code": number(body, 0, 2),
            "level": body[2],
            "count": number(body, 4, 4),
            "value": signed(number(body, 8, 8), 64),
        }
    if kind == 3:
        temperature = signed(number(body, 28, 4), 32)
        return {
            "kind": "status",
            "frames_sent": number(body, 0, 8),
            "frames_dropped": number(body, 8, 4),
            "frames_aborted": number(body, 12, 4),
            "triggers_lost": number(body, 16, 4),
            "stall_clocks": number(body, 20, 4),
            "buffer_peak": number(body, 24, 4),
            "temperature_mdeg": None if temperature == -(1 << 31) else temperature,
        }
    if kind == 4:
        if number(body, 0, 4) > 1:
            raise Broken("E4", header=False)
        words = [number(body, at, 4) for at in range(4, len(body), 4)]
        wrong = sum(
            follow != following(word, number(body, 0, 4)) for word, follow in pairwise(words)
        )
        return {
            "kind": "test",
            "pattern": number(body, 0, 4),
            "seed": words[0],
            "words": len(words),
            "last_word": words[-1],
            "errors": wrong,
        }
    if kind == 5:
        return read_sums(body)
    return {"kind": "opaque", "type": kind, "body": body.hex()}


SUMS_FIELDS = {
    "picture": (0, 4), "first_pixel": (4, 4), "rows": (12, 2), "cols": (14, 2), "frames": (16, 4),
    "missed": (20, 4), "photons": (24, 8), "saturated": (32, 4), "tables": (36, 4),
    "offsets": (40, 4), "periods": (44, 4), "code_bits": (48, 1), "flags": (50, 2),
}  # fmt: skip


def read_sums(body):
    def need(condition, rule):
        if not condition:
            raise Broken(rule, header=False)

    need(len(body) >= 56, "U1")
    head = {name: number(body, at, size) for name, (at, size) in SUMS_FIELDS.items()}
    pixels, count = number(body, 8, 4), body[49]
    need(1 <= head["rows"] <= 1024 and 1 <= head["cols"] <= 1024, "U2")
    need(pixels >= 1 and head["first_pixel"] + pixels <= head["rows"] * head["cols"], "U2")
    need(1 <= head["code_bits"] <= 16 and 1 <= count <= 32 and head["flags"] < 128, "U2")
    need(number(body, 52, 4) == 0, "U2")
    widths = list(body[56 : 56 + count])
    start = 56 + pad(count, 8)
    need(len(widths) == count and all(1 <= width <= 32 for width in widths), "U3")
    need(not any(body[56 + count : start]), "U3")
    total = pixels * sum(widths)
    need(len(body) == start + (total + 7) // 8, "U3")
    need(not any(bits(body, 8 * start + total, 8 * len(body) - 8 * start - total)), "U3")
    at, values = 8 * start, []
    for _ in range(pixels):
        values.append([])
        for width in widths:
            values[-1].append(value(bits(body, at, width)))
            at += width
    full = sum(any(v == 2**w - 1 for v, w in zip(row, widths, strict=True)) for row in values)
    need(full == head["saturated"], "U4")
    return {"kind": "sums", **head, "widths": widths, "values": values}


def following(word, pattern):
    if pattern == 0:
        return (word + 1) % (1 << 32)
    word = (word ^ word << 13) % (1 << 32)
    word ^= word >> 17
    return (word ^ word << 5) % (1 << 32)


def read_stream(data):
    """All of S1 to S6, over a whole stream."""
    report = dict.fromkeys(
        ("packets", "frames", "aborted", "repeated", "damaged", "skipped_bytes", "missing",
         "restarts", "dropped", "dropped_before"), 0
    )  # fmt: skip
    packets, damage = [], []
    at, due, sequence, drops = 0, True, None, None
    while at < len(data):
        rest = data[at:]
        try:
            kind, header_size = read_header(rest)
            reading = read_frame(rest) if kind == 1 else read_other(rest, kind, header_size)
        except Broken as broken:
            is_packet = broken.rule != "P2" and (due or not broken.header)
            if is_packet:
                report["damaged"] += 1
                damage.append({"offset": at, "rule": broken.rule})
            report["skipped_bytes"] += 1
            at, due = at + 1, False
            continue
        size, head, content = reading
        report["packets"] += 1
        step = 1 if sequence is None else (head["sequence"] - sequence) % (1 << 32)
        sequence = head["sequence"]
        offset, at, due = at, at + size, True
        if step == 0:
            report["repeated"] += 1
            continue
        if step - 1 < 1 << 31:
            report["missing"] += step - 1
        else:
            report["restarts"] += 1
        if kind == 1:
            now = head["capture"], head["dropped"]
            if drops is None:
                report["dropped_before"] = now[1]
            elif drops[0] != now[0] or now[1] < drops[1]:
                report["dropped"] += now[1]
            else:
                report["dropped"] += now[1] - drops[1]
            drops = now
        if content is None:
            report["aborted"] += 1
            continue
        report["frames"] += kind == 1
        packets.append({"offset": offset, "size": size, **content})
    return packets, damage, report


@pytest.mark.parametrize("path", PACKETS, ids=lambda path: path.stem)
def test_vector(path):
    expected = json.loads(path.read_text())
    data = path.with_suffix(".bin").read_bytes()
    assert len(data) == expected["bytes"]
    packets, damage, report = read_stream(data)
    assert report == expected["report"]
    assert [d["offset"] for d in damage] == [d["offset"] for d in expected["damage"]]
    for found, wanted in zip(damage, expected["damage"], strict=True):
        assert found["rule"] == wanted.get("rule", found["rule"])
    assert len(packets) == len(expected["packets"])
    for found, wanted in zip(packets, expected["packets"], strict=True):
        assert_packet(found, wanted)


def assert_packet(found, wanted):
    if found["kind"] == "frame":
        codes = found.pop("codes")
        plain = bytearray(2 * found["rows"] * found["cols"])
        for pixel, code in codes.items():
            plain[2 * pixel : 2 * pixel + 2] = code.to_bytes(2, "little")
        found["hits"] = len(codes)
        found["codes_sha256"] = hashlib.sha256(plain).hexdigest()
        if "pixels_and_codes" in wanted:
            found["pixels_and_codes"] = [list(item) for item in sorted(codes.items())]
    assert found == wanted


@settings(max_examples=60)
@given(data=st.data())
def test_reads_what_the_encoder_writes(data):
    rows, cols = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 17))
    width = data.draw(st.integers(1, 16))
    code, pixels = st.just(0) | st.integers(0, (1 << width) - 1), rows * cols
    codes = data.draw(st.lists(code, min_size=pixels, max_size=pixels))
    run = 8 * data.draw(st.integers(1, 12))
    packet = hp.encode_frame(
        np.reshape(codes, (rows, cols)), sequence=1, frame=2, timestamp=3, code_bits=width, run=run
    )
    kind, _ = read_header(packet)
    size, _, content = read_frame(packet)
    assert (kind, size) == (1, len(packet))
    assert content is not None
    assert content["codes"] == {pixel: code for pixel, code in enumerate(codes) if code}


def test_crc_check_value():
    assert crc(b"123456789") == 0xE3069283
