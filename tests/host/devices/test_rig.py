# SPDX-License-Identifier: Apache-2.0
"""Rigs by address: the grammar, the registry, and what a part may bring."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType

import pytest

import hueflight as hf
from hueflight.devices import (
    DeviceNotFoundError,
    NoIllumination,
    RigAddress,
    RigAddressError,
    RigPart,
    choose_rig,
    register_rig,
    rig,
    rig_from_uri,
    rig_schemes,
)
from support.faulty_rig import FaultyRig


class ToyRig:
    """An opener that notes what it was asked for."""

    def __init__(self, instrument: hf.Instrument) -> None:
        self.addresses: list[RigAddress] = []
        self.bare = FaultyRig(instrument)

    def camera(self, address: RigAddress, instrument: hf.Instrument, /) -> RigPart:
        self.addresses.append(address)
        address.convert_options(gain=float)
        return RigPart(open_camera=lambda: self.bare.connect().camera)

    def lamp(self, address: RigAddress, instrument: hf.Instrument, /) -> RigPart:
        self.addresses.append(address)
        return RigPart(open_illumination=lambda: self.bare)


@pytest.fixture
def toy(fast: hf.Instrument, monkeypatch: pytest.MonkeyPatch) -> ToyRig:
    monkeypatch.setattr(rig, "_registered", {})
    made = ToyRig(fast)
    register_rig("toy", made.camera)
    register_rig("toy.lamp", made.lamp)
    return made


def test_a_registered_scheme_opens_a_rig(toy: ToyRig, fast: hf.Instrument) -> None:
    opened = rig_from_uri("toy:shelf/a%2Bb?gain=1.5", fast)()
    assert isinstance(opened.illumination, NoIllumination)
    assert opened.simulated
    assert (toy.addresses[0].path, toy.addresses[0].options) == ("shelf/a+b", {"gain": "1.5"})
    opened.close()


@pytest.mark.parametrize("uri", ["toy:1+2+toy.lamp:left", "toy.lamp:left+toy:1+2"])
def test_parts_are_joined_by_a_plus(toy: ToyRig, fast: hf.Instrument, uri: str) -> None:
    opened = rig_from_uri(uri, fast)()
    assert opened.illumination is toy.bare
    assert {address.path for address in toy.addresses} == {"1+2", "left"}
    opened.close()


def test_the_camera_is_closed_where_the_illumination_is_missing(
    toy: ToyRig, fast: hf.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[bool] = []
    monkeypatch.setattr("hueflight.devices.camera.Camera.close", lambda self: closed.append(True))
    with pytest.raises(DeviceNotFoundError, match="ttyNOT_THERE"):
        rig_from_uri("toy:+serial:/dev/ttyNOT_THERE", fast)()
    assert closed == [True]


@pytest.mark.parametrize(
    ("uri", "problem"),
    [
        ("", "write a scheme and a colon first"),
        ("0123ABCD", "the schemes are usb, serial, simulated, toy, toy.lamp"),
        ("yot:", r"no scheme 'yot'; the schemes are usb, serial, simulated, toy, toy\.lamp"),
        ("toy:?gain", "'gain' must be written name=value"),
        ("toy:?gain=1&gain=2", "'gain' is given twice"),
        ("toy:?gain=loud", "gain = 'loud' is not of type float"),
        ("toy:?colour=red", "no option 'colour'; its options: gain"),
        ("usb:?speed=3", "no option 'speed'; its options: none"),
        ("serial:/dev/ttyUSB0", r"names no camera.*usb:\+serial:/dev/ttyUSB0"),
        ("usb:+serial:", "names no port"),
        ("toy:1+toy:2", "2 cameras, toy:1 and toy:2"),
        ("toy:+toy.lamp:1+toy.lamp:2", "2 illuminations"),
        ("simulated:+toy.lamp:", "2 illuminations"),
        ("simulated:?frames=0", "frames = 0 must be 1 or more"),
    ],
)
def test_addresses_that_are_refused(
    toy: ToyRig, fast: hf.Instrument, uri: str, problem: str
) -> None:
    with pytest.raises(hf.HueflightError, match=problem):
        rig_from_uri(uri, fast)


@pytest.mark.parametrize("scheme", ["usb", "toy", "Toy", "1st", "a+b", ""])
def test_schemes_that_are_refused(toy: ToyRig, scheme: str) -> None:
    with pytest.raises(RigAddressError):
        register_rig(scheme, toy.camera)


def test_an_installed_package_brings_a_scheme(
    toy: ToyRig, fast: hf.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = ModuleType("toy_package")
    module.open_toy = toy.camera  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, "toy_package", module)
    installed = EntryPoints(
        EntryPoint(name, f"{place}:open_toy", rig.ENTRY_POINT_GROUP)
        for name, place in (("installed", "toy_package"), ("broken", "no_such_package"))
    )
    monkeypatch.setattr(rig, "entry_points", lambda group: installed)
    assert rig_schemes()[-2:] == ("broken", "installed")
    rig_from_uri("installed:", fast)().close()
    with pytest.raises(RigAddressError, match=r"can't be loaded from no_such_package:open_toy"):
        rig_from_uri("broken:", fast)


def test_the_simulated_instrument(fast: hf.Instrument) -> None:
    opened = rig_from_uri("simulated:fig1?frames=3&seed=7&distance=0.5", fast)()
    simulated = opened.illumination
    assert opened.simulated
    found = {name: getattr(simulated, name) for name in ("scene", "frames", "seed", "distance")}
    assert found == {"scene": "fig1", "frames": 3, "seed": 7, "distance": 0.5}
    opened.close()


def test_options_of_programs_become_an_address(
    toy: ToyRig, fast: hf.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    place = "hueflight.devices.built_in_rigs"
    monkeypatch.setattr(f"{place}.rig_from_uri", lambda uri, instrument: asked.append(uri))
    monkeypatch.setattr(f"{place}.camera_plugged_in", lambda: False)
    said: list[str] = []
    for options in (
        {},
        {"simulate": True, "scene": "fig6"},
        {"simulate": False},
        {"serial": "a+b"},
        {"illuminator": "/dev/ttyUSB0"},
        {"uri": "toy:"},
    ):
        choose_rig(fast, say=said.append, **options)
    assert asked == [
        "simulated:",
        "simulated:fig6",
        "usb:",
        "usb:a%2Bb",
        "usb:+serial:/dev/ttyUSB0",
        "toy:",
    ]
    assert len(said) == 1
    with pytest.raises(RigAddressError, match="leave out --simulate, --illuminator"):
        choose_rig(fast, uri="toy:", simulate=False, illuminator="/dev/x", say=said.append)
