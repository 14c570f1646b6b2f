# SPDX-License-Identifier: Apache-2.0
"""Register maps in other formats say the same as the maps themselves."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hueflight_protocol import camera_map, illuminator_map
from hueflight_protocol.register_formats import to_c_header, to_json, to_svd
from hueflight_protocol.registers import Access, RegisterMap

MAPS = pytest.mark.parametrize(
    "registers",
    [illuminator_map(), illuminator_map(channels=2, pulses=1, steps=3), camera_map()],
    ids=["illuminator", "small illuminator", "camera"],
)
Found = dict[tuple[int, str], tuple[int, int]]


def places(registers: RegisterMap) -> Found:
    """Word address of every element and field: its shift and width."""
    return {
        (register.address_of(*indices), name): (place.shift, place.field.width)
        for register in registers
        for indices in register.elements()
        for name, place in register.fields.items()
    }


@MAPS
def test_json(registers: RegisterMap):
    content = json.loads(to_json(registers))
    assert content["fingerprint"] == registers.fingerprint
    found: Found = {}
    for entry in content["registers"]:
        offsets = [0]
        for count, stride in zip(entry["count"], entry["strides"], strict=True):
            offsets = [offset + stride * i for offset in offsets for i in range(count)]
        for offset in offsets:
            for field in entry["fields"]:
                place = field["shift"], field["width"]
                found[entry["address"] + offset, field["name"]] = place
    assert found == places(registers)


@MAPS
def test_svd(registers: RegisterMap):
    root = ElementTree.fromstring(to_svd(registers))
    found: Found = {}
    names = []
    for entry in root.iter("register"):
        name = entry.findtext("name")
        names.append(name)
        assert (entry.find("dim") is None) == ("%s" not in name)
        count = int(entry.findtext("dim", "1"))
        step = int(entry.findtext("dimIncrement", "0"), 16)
        for i in range(count):
            address = int(entry.findtext("addressOffset"), 16) + i * step
            assert address % 4 == 0
            for field in entry.iter("field"):
                place = int(field.findtext("bitOffset")), int(field.findtext("bitWidth"))
                found[address // 4, field.findtext("name")] = place
    assert found == places(registers)
    assert len(names) == len(set(names))
    cleared = {
        e.findtext("name")
        for e in root.iter("register")
        if e.find("modifiedWriteValues") is not None
    }
    assert cleared == {r.name for r in registers if r.access is Access.W1C}


@MAPS
def test_c_header(registers: RegisterMap, tmp_path: Path):
    """The macros, as a C compiler understands them."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    prefix = f"HUEFLIGHT_{registers.name.upper()}"
    prints, wanted = [], []
    for register in registers:
        macro = f"{prefix}_{register.name.upper()}"
        for indices in register.elements():
            arguments = f"({', '.join(map(str, indices))})" if indices else ""
            prints.append(f"{macro}_ADDRESS{arguments}")
            wanted.append(register.address_of(*indices))
        for name, place in register.fields.items():
            prints += [f"{macro}_{name.upper()}_SHIFT", f"{macro}_{name.upper()}_MASK"]
            wanted += [place.shift, ((1 << place.field.width) - 1) << place.shift]
    (tmp_path / "registers.h").write_text(to_c_header(registers))
    body = "".join(f'printf("%llu\\n", (unsigned long long)({text}));' for text in prints)
    source = tmp_path / "main.c"
    source.write_text(f'#include <stdio.h>\n#include "registers.h"\nint main(void) {{{body}}}\n')
    program = tmp_path / "main"
    command = [compiler, "-std=c99", "-pedantic", "-Wall", "-Werror", "-o", program, source]
    subprocess.run(command, check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    assert [int(line) for line in done.stdout.split()] == wanted
