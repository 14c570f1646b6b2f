# SPDX-License-Identifier: Apache-2.0
"""Register maps for other programs: JSON, CMSIS-SVD, and a C header.

# Ref: Arm, CMSIS System View Description, format 1.3.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from itertools import product
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from .registers import ADDRESS_BITS, WORD_BITS, Access, Register, RegisterMap

_WORD_BYTES = WORD_BITS // 8
_SVD_ACCESS = {
    Access.CONST: "read-only",
    Access.RO: "read-only",
    Access.RW: "read-write",
    Access.W1C: "read-write",
    Access.PULSE: "write-only",
    Access.KEY: "write-only",
}


def to_json(registers: RegisterMap, /) -> str:
    """Return a register map as JSON; addresses are in words.

    Parameters
    ----------
    registers : RegisterMap
        The map.

    Returns
    -------
    str
        An object with ``name``, ``fingerprint`` and ``registers``.
    """
    content = {
        "name": registers.name,
        "fingerprint": registers.fingerprint,
        "word_bits": WORD_BITS,
        "registers": [
            {
                "name": register.name,
                "address": register.address,
                "access": register.access.value,
                "words": register.words,
                "count": list(register.count),
                "strides": list(register.strides),
                "reset": register.reset,
                "doc": register.doc,
                "fields": [
                    {
                        "name": name,
                        "shift": place.shift,
                        "width": place.field.width,
                        "signed": place.field.signed,
                        "reset": place.field.reset,
                        "unit": place.field.unit,
                        "choices": _choices(register, name),
                        "doc": place.field.doc,
                    }
                    for name, place in register.fields.items()
                ],
            }
            for register in registers
        ],
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def to_svd(registers: RegisterMap, /) -> str:
    """Return a register map as CMSIS-SVD.

    SVD counts addresses in bytes, so each is four times the word address of the protocol. Arrays
    of several axes are one array of the last axis for each element of the others.

    Parameters
    ----------
    registers : RegisterMap
        The map.

    Returns
    -------
    str
        An XML document.
    """
    device = Element("device", {"schemaVersion": "1.3"})
    _texts(
        device,
        name=registers.name,
        version=f"{registers.fingerprint:08x}",
        description=f"Registers of the Hueflight {registers.name}",
        addressUnitBits=8,
        width=WORD_BITS,
    )
    peripheral = SubElement(SubElement(device, "peripherals"), "peripheral")
    _texts(peripheral, name=registers.name.upper(), baseAddress="0x0")
    block = SubElement(peripheral, "addressBlock")
    _texts(block, offset="0x0", size=hex(_WORD_BYTES << ADDRESS_BITS), usage="registers")
    parent = SubElement(peripheral, "registers")
    for register in registers:
        for outer in product(*map(range, register.count[:-1])):
            _svd_register(parent, register, outer)
    indent(device)
    return tostring(device, encoding="unicode", xml_declaration=True) + "\n"


def to_c_header(registers: RegisterMap, /) -> str:
    """Return a register map as a C header of macros; addresses are in words.

    Parameters
    ----------
    registers : RegisterMap
        The map.

    Returns
    -------
    str
        For each register ``_ADDRESS`` (with indices for arrays), and for each field ``_SHIFT``,
        ``_MASK`` and its named values.
    """
    prefix = f"HUEFLIGHT_{registers.name.upper()}"
    lines = [
        f"/* Registers of the Hueflight {registers.name}: word addresses, shifts and masks. */",
        f"#ifndef {prefix}_H",
        f"#define {prefix}_H",
        "",
        f"#define {prefix}_FINGERPRINT {registers.fingerprint:#010x}u",
    ]
    for register in registers:
        name = f"{prefix}_{register.name.upper()}"
        lines += ["", f"/* {register.doc} ({register.access.value}) */"]
        lines.append(f"#define {name}_ADDRESS{_c_address(register)}")
        for field, place in register.fields.items():
            suffix = "u" if place.shift + place.field.width <= WORD_BITS else "ull"
            mask = ((1 << place.field.width) - 1) << place.shift
            lines.append(f"#define {name}_{field.upper()}_SHIFT {place.shift}")
            lines.append(f"#define {name}_{field.upper()}_MASK {mask:#x}{suffix}")
            lines += [
                f"#define {name}_{field.upper()}_{choice} {value}u"
                for choice, value in _choices(register, field).items()
            ]
    return "\n".join([*lines, "", "#endif", ""])


FORMATS: Mapping[str, Callable[[RegisterMap], str]] = {
    "json": to_json,
    "svd": to_svd,
    "c": to_c_header,
}
"""Functions that write a register map, by format."""


def _choices(register: Register, name: str) -> dict[str, int]:
    """Return the named values of a field."""
    choices = register.fields[name].field.choices
    return {} if choices is None else {choice.name: int(choice) for choice in choices}


def _texts(parent: Element, **texts: object) -> None:
    for name, text in texts.items():
        SubElement(parent, name).text = str(text)


def _svd_register(parent: Element, register: Register, outer: tuple[int, ...]) -> None:
    """Add a register, or an array along its last axis."""
    element = SubElement(parent, "register")
    name = "_".join([register.name, *map(str, outer)])
    first = register.address_of(*outer, 0) if register.count else register.address
    if register.count:
        _texts(element, dim=register.count[-1])
        _texts(element, dimIncrement=hex(_WORD_BYTES * register.strides[-1]))
    _texts(
        element,
        name=f"{name}[%s]" if register.count else name,
        description=register.doc,
        addressOffset=hex(_WORD_BYTES * first),
        size=WORD_BITS * register.words,
        access=_SVD_ACCESS[register.access],
        resetValue=hex(register.reset),
    )
    if register.access is Access.W1C:
        _texts(element, modifiedWriteValues="oneToClear")
    fields = SubElement(element, "fields")
    for field, place in register.fields.items():
        entry = SubElement(fields, "field")
        unit = f"in {place.field.unit}" if place.field.unit else ""
        text = ", ".join(filter(None, (place.field.doc, unit)))
        _texts(entry, name=field, description=text or register.doc)
        _texts(entry, bitOffset=place.shift, bitWidth=place.field.width)
        if choices := _choices(register, field):
            values = SubElement(entry, "enumeratedValues")
            for choice, value in choices.items():
                _texts(SubElement(values, "enumeratedValue"), name=choice, value=value)


def _c_address(register: Register) -> str:
    """Return the arguments and the value of a register's address macro."""
    if not register.count:
        return f" {register.address:#05x}u"
    names = "ijkl"[: len(register.count)]
    terms = [f"{stride}u * ({name})" for name, stride in zip(names, register.strides, strict=True)]
    return f"({', '.join(names)}) ({register.address:#05x}u + {' + '.join(terms)})"
