# SPDX-License-Identifier: Apache-2.0
"""Registers as types are what the maps declare, and encode as the maps do."""

import subprocess
import sys
from pathlib import Path

import pytest

import hueflight_protocol as hp
from hueflight_protocol.typed_registers import camera, illuminator

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "protocol" / "hueflight_protocol" / "typed_registers"
MAPS = (
    (camera, hp.camera_map(rows=5, cols=7, reduction=hp.ReductionRoom(), external_clock=True)),
    (illuminator, hp.illuminator_map(channels=3, external_clock=True, fine_steps=128)),
)


def test_the_committed_modules_are_current(tmp_path: Path):
    subprocess.run([sys.executable, ROOT / "tools" / "typed_registers.py", tmp_path], check=True)
    for name in ("common.py", "camera.py", "illuminator.py"):
        made = (tmp_path / name).read_text()
        assert made == (FOLDER / name).read_text(), "run tools/typed_registers.py"


@pytest.mark.parametrize(("module", "registers"), MAPS)
def test_every_register_of_any_build_has_a_type(module, registers: hp.RegisterMap):
    types = {each.NAME: each for each in (getattr(module, name) for name in module.__all__)}
    assert set(types) == {register.name for register in registers}
    for register in registers:
        typed = types[register.name]
        assert register.address == typed.ADDRESS
        assert typed.field_names() == tuple(register.fields)
        for name, place in register.fields.items():
            most = getattr(typed, f"{name.upper()}_MAX", place.field.maximum)
            assert most == place.field.maximum


@pytest.mark.parametrize(("module", "registers"), MAPS)
def test_values_go_to_bits_and_back(module, registers: hp.RegisterMap):
    for typed in (getattr(module, name) for name in module.__all__):
        register = registers[typed.NAME]
        for choose in ("minimum", "maximum"):
            fields = {n: getattr(p.field, choose) for n, p in register.fields.items()}
            value = typed(**fields)
            assert value.encode(register) == register.encode(**fields)
            assert typed.decode(register, value.encode(register)) == value


def test_fields_that_are_not_given_keep_their_reset_value():
    register = hp.camera_map()["trigger"]
    assert camera.Trigger().encode(register) == register.reset
    with pytest.raises(TypeError, match="occupanzy"):
        camera.Synthetic(occupanzy=1)
    with pytest.raises(hp.RegisterError, match=r"trigger.width = 256: must be from 0 to 255"):
        camera.Trigger(width=256).encode(register)


def test_a_field_that_a_build_lacks_must_be_0():
    features = hp.camera_map()["features"]
    assert camera.Features(overlap=1).encode(features) == features.encode(overlap=1)
    with pytest.raises(hp.RegisterError, match="features has no field 'external_clock'"):
        camera.Features(external_clock=1).encode(features)
    board = hp.RegisterFile(hp.camera_map())
    board.store(camera.Features(overlap=1))
    assert board.load(camera.Features) == camera.Features(overlap=1)


def test_a_register_file_is_set_and_read_by_type():
    board = hp.RegisterFile(hp.illuminator_map())
    limit = illuminator.Limit(on_ticks=80, burst_ticks=81, duty_divisor=8)
    board.store(limit, 3)
    assert board.load(illuminator.Limit, 3) == limit
    assert board.load(illuminator.Limit, 2) != limit
    assert board.load(illuminator.Trigger).source is hp.illuminator_map()["trigger"].fields[
        "source"
    ].field.choices(0)
