#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Generate the parts of the protocol's documents that follow from its declarations.

    python tools/protocol_docs.py [FOLDER]

This replaces the blocks between `<!-- generated: NAME -->` and `<!-- end -->` in
docs/protocol.md and writes docs/registers.md. FOLDER is the folder of the two documents, by
default docs.
"""

import re
import sys
from collections.abc import Callable
from enum import IntEnum, IntFlag
from pathlib import Path

import numpy as np

import hueflight_protocol as hp
from hueflight_protocol import control, wire
from hueflight_protocol.illuminator_map import MAX_FINE_STEPS
from hueflight_protocol.layout import Layout
from hueflight_protocol.registers import Field, Register, RegisterMap
from vector_stream import random_codes

DOCS = Path(__file__).resolve().parent.parent / "docs"
CELL = 10
RUNS = (64, 128, 256, 512, 1024)
OCCUPANCIES = (0.05, 0.3, 0.7, 1.0)
ROWS, COLS, CODE_BITS = 192, 128, 9


def diagram(layout: Layout) -> str:
    """Return a byte diagram, eight bytes a line."""
    rule = "       +" + "+".join(["-" * (CELL - 1)] * 8) + "+"
    numbers = "        " + "".join(f"+{k}".ljust(CELL) for k in range(8))
    lines = [numbers.rstrip(), rule]
    for start in range(0, layout.size, 8):
        cells = [
            f"{field.name:<{field.size * CELL - 1}}"
            for field in layout.fields
            if start <= field.offset < start + 8
        ]
        lines += [f"{start:6} |" + "|".join(cells) + "|"]
        width = sum(len(cell) + 1 for cell in cells)
        lines.append(rule[: 8 + width])
    return "```text\n" + "\n".join(lines) + "\n```"


def fields(layout: Layout) -> str:
    """Return a diagram and a table of a layout's fields."""
    lines = ["| byte | size | field | meaning |", "|---|---|---|---|"]
    for field in layout.fields:
        value = ""
        if field.constant is not None:
            value = f"always {field.constant}: " if field.constant < 1 << 16 else ""
        sign = " signed" if field.dtype.kind == "i" else ""
        row = f"| {field.offset} | {field.size}{sign} | `{field.name}` | {value}{field.doc} |"
        lines.append(row)
    return diagram(layout) + "\n\n" + "\n".join(lines)


def names(enumeration: type[IntEnum] | type[IntFlag], meanings: dict[str, str]) -> str:
    """Return a table of an enumeration's members."""
    lines = ["| value | name | meaning |", "|---|---|---|"]
    for member in enumeration:
        value = f"{member.value:#06x}" if isinstance(member, IntFlag) else f"{member.value}"
        lines.append(f"| {value} | `{member.name}` | {meanings[member.name or '']} |")
    return "\n".join(lines)


FLAG_MEANINGS = {
    "MASKED": "codes of masked pixels were replaced by 0",
    "ROI": "codes outside the region of interest were replaced by 0",
    "GATED": "codes outside the time gate were replaced by 0",
    "SATURATED": "a counter in this header has reached its largest value and may be too low",
    "TEST_PATTERN": "codes come from the pattern generator of the camera instead of its sensor",
    "SIMULATED": "the packet was written by software",
    "TRIGGER_LOST": "the illuminator missed a trigger since the frame before",
}
EVENT_MEANINGS = {
    "RUN_STARTED": "a capture began; `value` = its label",
    "RUN_STOPPED": "a capture ended; `value` = its frames, those dropped and aborted included",
    "OVERFLOW": "a frame was dropped or aborted; `value` = its number",
    "TRIGGER_LOST": "the illuminator missed triggers; `value` = how many since the last event",
    "TEMPERATURE": "a temperature limit was crossed; `value` = millidegrees Celsius",
    "SENSOR_FAULT": "the sensor sent fewer or more codes than a frame has; `value` = frame",
    "LINK_ERROR": "the link was reset; `value` = bytes that were lost",
}
OP_MEANINGS = {
    "IDENTIFY": "the 8 words of the identity block at address 0x000",
    "STATUS": "the 8 words of the status block at address 0x008",
    "READ": "`count` words from consecutive addresses",
    "WRITE": "`count` words, the payload, to consecutive addresses",
}
RESULT_MEANINGS = {
    "OK": "done",
    "BAD_VERSION": "`version` is not 1",
    "BAD_OP": "`op` is not in the table of operations",
    "BAD_COUNT": "`count` is not 1 to 64, or not what the payload holds",
    "BAD_ADDRESS": "an address has no register",
    "READ_ONLY": "an address cannot be written",
    "REFUSED": "the device's state does not allow it now",
}


def frame_bytes(occupancy: float, run: int) -> int:
    """Return the bytes of a random frame of the paper's sensor."""
    codes = random_codes(int(1000 * occupancy), ROWS, COLS, occupancy, code_bits=CODE_BITS)
    return len(hp.encode_frame(codes, sequence=0, frame=0, timestamp=0, run=run))


def run_study() -> str:
    """Return the table from which the default run length was chosen."""
    ideals: list[float] = []
    for occupancy in OCCUPANCIES:
        codes = random_codes(int(1000 * occupancy), ROWS, COLS, occupancy, code_bits=CODE_BITS)
        hits = np.count_nonzero(codes)
        ideals.append(min(ROWS * COLS + hits * CODE_BITS, ROWS * COLS * CODE_BITS) / 8)
    head = "| run | " + " | ".join(f"occupancy {o:g}" for o in OCCUPANCIES) + " | buffer |"
    lines = [head, "|---" * (len(OCCUPANCIES) + 2) + "|"]
    for run in RUNS:
        cells = []
        for occupancy, ideal in zip(OCCUPANCIES, ideals, strict=True):
            size = frame_bytes(occupancy, run)
            cells.append(f"{size} (+{100 * (size / ideal - 1):.1f} %)")
        lines.append(f"| {run} | " + " | ".join(cells) + f" | {run * CODE_BITS // 8} |")
    lines.append("| *ideal* | " + " | ".join(f"{ideal:.0f}" for ideal in ideals) + " | |")
    return "\n".join(lines)


def example() -> str:
    """Return the worked example as an annotated hex dump."""
    codes = np.zeros((4, 5), np.uint16)
    codes[0, 1], codes[0, 4], codes[3, :4] = 0x1FF, 0x003, (1, 2, 3, 4)
    packet = hp.encode_frame(
        codes,
        sequence=5,
        frame=4,
        timestamp=0x0123_4567,
        run=16,
        periods=3125,
        dropped=1,
        step=2,
        capture=7,
        clock_hz=100_000_000,
    )
    notes: list[tuple[int, str]] = [
        (field.size, f"{field.name}") for field in wire.FRAME_HEADER.fields
    ]
    notes += [
        (4, "chunk: kind 1, index 0, 3 hits"),
        (2, "bitmap: pixels 1, 4 and 15"),
        (4, "codes 1ff 003 001, 27 bits"),
        (2, "padding to 4"),
        (4, "chunk: kind 2, index 1, 3 hits"),
        (5, "codes 002 003 004 000, 36 bits"),
        (3, "padding to 4"),
    ]
    if sum(size for size, _ in notes) % 8:
        notes.append((4, "pad word"))
    notes += [
        (4, "end word: kind 3, status 0, 2 chunks"),
        (4, "hits"),
        (4, "packet_words"),
        (4, "crc"),
    ]
    lines: list[str] = []
    at = 0
    for size, note in notes:
        lines.append(f"{at:4}  {packet[at : at + size].hex(' '):<24}  {note}")
        at += size
    if at != len(packet):
        raise SystemExit(f"the example's notes cover {at} of {len(packet)} bytes")
    return "```text\n" + "\n".join(lines) + "\n```"


def message_example() -> str:
    """Return a control request and its COBS frame."""
    message = hp.encode_request(control.write(1, 0x104, [8 << 16 | 24]))
    frame = hp.serial_frame(message)
    return f"```text\nmessage  {message.hex(' ')}\nframe    {frame.hex(' ')}\n```"


def bit_range(shift: int, width: int) -> str:
    """Return the bits of a field, highest first."""
    return f"{shift}" if width == 1 else f"{shift + width - 1}:{shift}"


def address_range(register: Register) -> str:
    """Return the addresses of a register, and those of an array as a formula."""
    text = f"{register.address:#06x}"
    if register.words > 1:
        text += f"–{register.address + register.words - 1:#06x}"
    symbols = "ijk"
    terms = [
        f" + {'' if stride == 1 else f'{stride}·'}{symbol}"
        for symbol, stride in zip(symbols, register.strides, strict=False)
    ]
    return text + "".join(terms)


def bounds(register: Register) -> str:
    """Return the name of a register with the size of its axes."""
    symbols = "ijk"
    axes = [f"{s} < {n}" for s, n in zip(symbols, register.count, strict=False)]
    return f"`{register.name}`" + (f"<br>{', '.join(axes)}" if axes else "")


def field_text(field: Field, shift: int) -> str:
    """Return one field in words."""
    text = f"{bit_range(shift, field.width)} `{field.name}`"
    notes = [field.doc] if field.doc else []
    if field.unit:
        notes.append(f"in {field.unit}")
    if field.choices is not None:
        notes.append(", ".join(f"{c.value} = {c.name.lower()}" for c in field.choices))
    if field.reset:
        notes.append(f"reset {field.reset}")
    return text + (": " + "; ".join(notes) if notes else "")


def register_table(registers: RegisterMap) -> str:
    """Return the table of a board's registers."""
    lines = ["| address | register | access | fields | meaning |", "|---|---|---|---|---|"]
    for r in registers:
        parts = "<br>".join(field_text(p.field, p.shift) for p in r.fields.values())
        row = (address_range(r), bounds(r), r.access.value, parts, r.doc)
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


BLOCKS: dict[str, Callable[[], str]] = {
    "frame header": lambda: fields(wire.FRAME_HEADER),
    "frame trailer": lambda: fields(wire.FRAME_TRAILER),
    "packet header": lambda: fields(wire.PACKET_HEADER),
    "packet trailer": lambda: fields(wire.PACKET_TRAILER),
    "event body": lambda: fields(wire.EVENT_BODY),
    "status body": lambda: fields(wire.STATUS_BODY),
    "sums body": lambda: fields(wire.SUMS_BODY),
    "test body": lambda: fields(wire.TEST_BODY),
    "control header": lambda: fields(control.CONTROL_HEADER),
    "flags": lambda: names(wire.FrameFlags, FLAG_MEANINGS),
    "events": lambda: names(wire.EventCode, EVENT_MEANINGS),
    "operations": lambda: names(control.Op, OP_MEANINGS),
    "results": lambda: names(control.Result, RESULT_MEANINGS),
    "run study": run_study,
    "example": example,
    "message example": message_example,
}

REGISTERS_HEAD = """\
# Registers

`tools/protocol_docs.py` generates this page from the declarations in
`protocol/hueflight_protocol/*_map.py`; [protocol.md](protocol.md) has the rules. Addresses count
32-bit words and are the same in every build; registers beyond the size of a build are absent.
Fields are listed with their bits, name and meaning. Bits outside of fields read as 0. Reset values
are 0 unless stated otherwise; those of `const` registers are the values of the build shown here.
Registers whose names begin with `reduction` exist only in builds that can reduce codes to sums; the
[page on sums](sums.md) says what a camera does with settings that it can't follow.
"""


def registers_document() -> str:
    """Return docs/registers.md."""
    parts = [REGISTERS_HEAD]
    boards = (
        hp.illuminator_map(external_clock=True, fine_steps=MAX_FINE_STEPS),
        hp.camera_map(reduction=hp.ReductionRoom(), external_clock=True),
    )
    for registers in boards:
        size = "nine channels" if registers.name == "illuminator" else "192 × 128 pixels"
        parts.append(f"## {registers.name.capitalize()} ({size})\n")
        parts.append(register_table(registers) + "\n")
    return "\n".join(parts)


def filled(text: str) -> str:
    """Return a document with all its generated blocks replaced."""

    def block(match: re.Match[str]) -> str:
        name = match.group(1)
        return f"<!-- generated: {name} -->\n{BLOCKS[name]()}\n<!-- end -->"

    return re.sub(r"<!-- generated: (.*?) -->\n.*?<!-- end -->", block, text, flags=re.DOTALL)


def main() -> None:
    """Fill docs/protocol.md and write docs/registers.md."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS
    protocol = folder / "protocol.md"
    protocol.write_text(filled(protocol.read_text()))
    (folder / "registers.md").write_text(registers_document())


if __name__ == "__main__":
    main()
