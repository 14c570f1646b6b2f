#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Write the registers of both boards as types, from the declarations of the register maps.

    python tools/typed_registers.py [FOLDER]

writes common.py, camera.py and illuminator.py in protocol/hueflight_protocol/typed_registers;
FOLDER stands for it. Each register becomes a dataclass of its fields, with its name, its address
and the largest value of every field, so that a type checker sees a name that is misspelt.
"""

import sys
import textwrap
from collections.abc import Iterable
from pathlib import Path

from hueflight_protocol import ReductionRoom, camera_map, illuminator_map
from hueflight_protocol.illuminator_map import MAX_FINE_STEPS
from hueflight_protocol.registers import Field, Register, RegisterMap

FOLDER = (
    Path(__file__).resolve().parent.parent / "protocol" / "hueflight_protocol" / "typed_registers"
)
WIDTH = 100
#: two builds that differ in everything a build may choose: what they share holds for all builds
BUILDS = {
    "camera": (
        camera_map(reduction=ReductionRoom(), external_clock=True),
        camera_map(
            rows=1024,
            cols=1024,
            code_bits=16,
            lanes=16,
            run=64,
            geometry=1,
            clock_hz=1,
            reduction=ReductionRoom(sums=1, entry_bits=1, sum_bits=2, group=4, narrow=1),
            external_clock=True,
            reference_hz=1,
        ),
    ),
    "illuminator": (
        illuminator_map(external_clock=True, fine_steps=MAX_FINE_STEPS),
        illuminator_map(
            channels=32,
            pulses=1,
            steps=1,
            lanes=8,
            tick_fs=1,
            clock_hz=1,
            external_clock=True,
            reference_hz=1,
            fine_steps=2,
            fine_step_fs=1,
        ),
    ),
}
HEAD = '''\
# SPDX-License-Identifier: Apache-2.0
"""Registers {of} as types; written by `tools/typed_registers.py`, not by hand."""

from dataclasses import dataclass
from typing import ClassVar
{imports}
__all__ = [
{names}]
'''


def class_name(register: Register) -> str:
    """Return the name of a register's class."""
    return "".join(part.capitalize() for part in register.name.split("_"))


def sentence(text: str, unit: str = "") -> str:
    """Return a text as a sentence."""
    text = text[:1].upper() + text[1:] if text else "Value"
    return f"{text}, in {unit}." if unit else f"{text}."


def described(field: Field) -> str:
    """Return the meaning of a field as a sentence."""
    return sentence(field.doc, field.unit)


def field_type(field: Field) -> str:
    """Return the type of a field as it stands in Python."""
    return "int" if field.choices is None else f"{field.choices.__name__} | int"


def same_fields(one: Register, other: Register) -> bool:
    """Return whether two boards have a register with the same fields; reset values may differ."""
    layouts = [
        [(name, place.shift, place.field.width) for name, place in register.fields.items()]
        for register in (one, other)
    ]
    return one.address == other.address and layouts[0] == layouts[1]


def class_text(register: Register, other: Register) -> str:
    """Return the class of a register.

    `other` is the same register in another build: what differs between them is left out.
    """
    fields = [place.field for place in register.fields.values()]
    others = [place.field for place in other.fields.values()]
    single = len(fields) == 1
    options = "frozen=True, slots=True" if single else "frozen=True, slots=True, kw_only=True"
    lines = [f"@dataclass({options})", f"class {class_name(register)}(RegisterValue):"]
    summary, detail = register.doc, ""
    if len(summary) > WIDTH - 10:
        summary, _, detail = summary.partition(": ")
    lines += wrapped('"""' + sentence(summary), "    ")
    if detail:
        lines += ["", *wrapped(sentence(detail), "    ")]
    lines += ["", "    Attributes", "    ----------"]
    for field in fields:
        lines += [f"    {field.name} : {field_type(field)}"]
        lines += wrapped(described(field), "        ")
    lines += ['    """', "", f'    NAME: ClassVar[str] = "{register.name}"']
    lines += [f"    ADDRESS: ClassVar[int] = 0x{register.address:04X}"]
    for field, elsewhere in zip(fields, others, strict=True):
        if field.width == elsewhere.width:
            name = field.name.upper()
            lines += [f"    {name}_MAX: ClassVar[int] = {field.maximum}"]
            if field.signed:
                lines += [f"    {name}_MIN: ClassVar[int] = {field.minimum}"]
    lines += [""]
    for field, elsewhere in zip(fields, others, strict=True):
        default = "" if single or field.reset != elsewhere.reset else f" = {field.reset}"
        lines += [f"    {field.name}: {field_type(field)}{default}"]
    return "\n".join(lines)


def wrapped(text: str, indent: str) -> list[str]:
    """Return a text as indented lines."""
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent)


def module_text(
    board: str, registers: Iterable[Register], other: RegisterMap, shared: Iterable[str]
) -> str:
    """Return the module of a board, which also offers the registers that both boards share."""
    registers, shared = list(registers), sorted(shared)
    choices = {
        (place.field.choices.__module__, place.field.choices.__name__)
        for register in registers
        for place in register.fields.values()
        if place.field.choices is not None
    }
    imports: list[str] = [""]
    for module in sorted({module for module, _ in choices}):
        names = ", ".join(sorted(name for place, name in choices if place == module))
        imports += [f"from ..{module.rpartition('.')[2]} import {names}"]
    imports += ["from ..register_value import RegisterValue"]
    imports.sort(key=lambda line: line.split("import")[0])
    if shared:
        imports += ["from .common import (", *(f"    {name}," for name in shared), ")"]
    own = [class_name(register) for register in registers]
    head = HEAD.format(
        of="that both boards have" if board == "common" else f"of the {board}",
        imports="\n".join(imports) + "\n",
        names="".join(f'    "{name}",\n' for name in sorted([*own, *shared])),
    )
    classes = [class_text(register, other[register.name]) for register in registers]
    return "\n\n".join([head, *(text + "\n" for text in classes)])


def modules() -> dict[str, str]:
    """Return every module by its file name."""
    camera, illuminator = BUILDS["camera"][0], BUILDS["illuminator"][0]
    both = {register.name for register in camera} & {register.name for register in illuminator}
    common = [r for r in camera if r.name in both and same_fields(r, illuminator[r.name])]
    names = {register.name for register in common}
    written = {"common.py": module_text("common", common, illuminator, ())}
    for board, (first, second) in BUILDS.items():
        own = [register for register in first if register.name not in names]
        shared = [class_name(register) for register in common]
        written[f"{board}.py"] = module_text(board, own, second, shared)
    return written


def main() -> None:
    """Write the modules."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    for name, text in modules().items():
        (folder / name).write_text(text)


if __name__ == "__main__":
    main()
