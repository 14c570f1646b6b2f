# SPDX-License-Identifier: Apache-2.0
"""Register maps: places, fields, fingerprints, and what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hueflight_protocol as hp
from hueflight_protocol import control
from hueflight_protocol.illuminator_map import Retrigger, TriggerSource

MAPS = [
    hp.illuminator_map(),
    hp.illuminator_map(channels=1, pulses=1, steps=1, lanes=1),
    hp.illuminator_map(channels=32, lanes=8),
    hp.camera_map(),
    hp.camera_map(rows=1, cols=1, code_bits=1),
    hp.camera_map(rows=1024, cols=1024, code_bits=16),
    hp.camera_map(reduction=hp.ReductionRoom()),
    hp.camera_map(external_clock=True, reference_hz=10_000_000),
]


@pytest.mark.parametrize("registers", MAPS, ids=lambda m: f"{m.name}-{m.fingerprint:08x}")
def test_every_address_leads_back_to_its_register(registers: hp.RegisterMap):
    for register in registers:
        for indices in list(register.elements())[:500]:
            address = register.address_of(*indices)
            for word in range(register.words):
                place = registers.at(address + word)
                assert (place.register, place.indices, place.word) == (register, indices, word)
                assert address + word in registers


@pytest.mark.parametrize("registers", MAPS, ids=lambda m: f"{m.name}-{m.fingerprint:08x}")
def test_identity_and_status_are_whole(registers: hp.RegisterMap):
    end = control.STATUS_ADDRESS + control.STATUS_WORDS
    assert all(address in registers for address in range(end))


def test_addresses_do_not_depend_on_the_build():
    small, large = hp.illuminator_map(channels=2, steps=2), hp.illuminator_map(channels=32)
    for register in small:
        for indices in register.elements():
            assert register.address_of(*indices) == large[register.name].address_of(*indices)
    assert small.fingerprint != large.fingerprint
    with pytest.raises(hp.RegisterError, match="index 2 is not below 2"):
        small["pulse"].address_of(0, 2, 0)


def test_the_fingerprint_knows_everything_but_prose():
    def a_map(name="a", address=0, width=8, access=hp.Access.RW, doc="", signed=False):
        field = hp.Field("value", width, doc, signed=signed)
        return hp.RegisterMap("board", [hp.Register(name, address, access, (field,), doc)])

    same = a_map()
    assert a_map(doc="prose").fingerprint == same.fingerprint
    for change in (
        {"name": "b"},
        {"address": 1},
        {"width": 9},
        {"access": hp.Access.RO},
        {"signed": True},
    ):
        assert a_map(**change).fingerprint != same.fingerprint


@given(st.data())
def test_decoding_inverts_encoding(data: st.DataObject):
    register = data.draw(st.sampled_from([r for m in MAPS for r in m if r.fields]))
    values = {
        name: data.draw(st.integers(place.field.minimum, place.field.maximum))
        for name, place in register.fields.items()
    }
    word = register.encode(**values)
    assert register.decode(word) == values
    assert word & ~register.mask == 0


def test_choices_come_by_name():
    trigger = hp.illuminator_map()["trigger"]
    word = trigger.encode(source=TriggerSource.SOFTWARE, retrigger=Retrigger.RESTART, falling=1)
    assert word == 0b1110
    assert trigger.decode(word)["source"] is TriggerSource.SOFTWARE
    assert trigger.decode(3)["source"] == 3  # a value without a name stays a number


def test_signed_fields():
    delay = hp.camera_map()["synthetic_delay"]
    assert delay.encode(start=1, step=-2) == 0xFFFE_0001
    assert delay.decode(0xFFFE_0001) == {"start": 1, "step": -2}


def test_a_pulse_is_eight_ticks_wide_at_tick_24():
    pulse = hp.illuminator_map()["pulse"]
    assert pulse.encode(delay=24, width=8) == 0x0008_0018
    assert pulse.address_of(1, 31 - 23, 3) == 0x100 + 128 + 32 + 3


def registers_of(*parts: hp.Field, **options) -> hp.Register:
    return hp.Register("r", 0, hp.Access.RW, parts, "", **options)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hp.illuminator_map()["nothing"], "the illuminator has no register 'nothing'"),
        (lambda: hp.illuminator_map().at(0xFFF), "the illuminator has no register at 0x0fff"),
        (lambda: hp.illuminator_map(channels=33), "channels = 33: must be from 1 to 32"),
        (lambda: hp.illuminator_map(pulses=0), "pulses = 0: must be from 1 to 4"),
        (lambda: hp.camera_map(rows=1025), "rows = 1025: must be from 1 to 1024"),
        (lambda: hp.ReductionRoom(sums=33), "sums = 33: must be from 1 to 32"),
        (lambda: hp.ReductionRoom(group=6), "group = 6: must be a multiple of 4"),
        (lambda: hp.illuminator_map()["trigger"].encode(colour=1), "no field 'colour'; it has so"),
        (lambda: hp.illuminator_map()["trigger"].encode(source=4), "source = 4: must be from 0 to"),
        (lambda: hp.illuminator_map()["pulse"].address_of(1), "pulse takes 3 indices, got"),
        (lambda: registers_of(hp.Field("a", 1, ""), hp.Field("a", 1, "")), "'a' stands twice"),
        (lambda: registers_of(hp.Field("a", 2, "", reset=4)), "r.a: 4 does not fit 2 bits"),
        (lambda: registers_of(hp.Field("a", 33, "")), "33 bits in 1 words"),
        (lambda: registers_of(count=(2,)), r"count \(2,\) and strides \(\) must be equally many"),
        (
            lambda: hp.RegisterMap("b", [registers_of(), registers_of()]),
            "b: register 'r' stands twice",
        ),
        (
            lambda: hp.RegisterMap("b", [registers_of(count=(2,), strides=(0,))]),
            "r and r share address 0x0000",
        ),
        (
            lambda: hp.RegisterMap("b", [registers_of(count=(2,), strides=(1 << 16,))]),
            "r needs address 0x10000",
        ),
        (lambda: hp.illuminator_map(fine_steps=1), "fine_steps = 1: must be 0, or from 2 to 128"),
        (lambda: hp.illuminator_map(fine_steps=129), "fine_steps = 129: must be 0, or from 2"),
    ],
)
def test_what_is_refused(make, message: str):
    with pytest.raises(hp.RegisterError, match=message):
        make()
