# SPDX-License-Identifier: Apache-2.0
"""Readouts of the project and of another package pass the checks; faulty ones fail them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("amaranth", reason="the extra 'hdl' is not installed")

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from hueflight.testing import SensorPortChecks
from hueflight.testing.sensor_port import ReadoutExample, record
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.port import SensorPort
from hueflight_hdl.camera.sensor.synthetic import SyntheticSensor
from hueflight_protocol.camera_map import SyntheticSource

PACKAGE = Path(__file__).resolve().parents[2] / "support" / "example_package"
ONE_LANE = FrameFormat(rows=3, cols=5, lanes=1, run=8)


@pytest.fixture(autouse=True)
def installed() -> Iterator[None]:
    """The example package is on the path, as if it were installed."""
    sys.path.insert(0, str(PACKAGE))
    yield
    sys.path.remove(str(PACKAGE))


class TestSyntheticSensor(SensorPortChecks):
    @pytest.fixture(params=[(9, 3, 8), (16, 24, 4), (2, 9, 1)])
    def example(self, request: pytest.FixtureRequest) -> ReadoutExample:
        rows, cols, lanes = request.param
        form = FrameFormat(rows=rows, cols=cols, lanes=lanes, run=8)
        settings = {"settings": {"source": SyntheticSource.RANDOM, "occupancy": 30000, "seed": 1}}
        return ReadoutExample(SyntheticSensor(form), rows, cols, lanes, settings=settings)


class TestReadoutOfAnotherPackage(SensorPortChecks):
    @pytest.fixture
    def example(self) -> ReadoutExample:
        return example_of(ONE_LANE)


def example_of(form: FrameFormat, /, **faults: Any) -> ReadoutExample:
    from example_readout import ExampleReadout

    made = Faulty(form, **faults) if faults else ExampleReadout(form)
    return ReadoutExample(made, form.rows, form.cols, form.lanes, patience=64)


class Faulty(wiring.Component):
    """The example with a fault: what it wrongly does to the port."""

    def __init__(self, form: FrameFormat, /, **faults: Any) -> None:
        self.form, self.faults = form, faults
        super().__init__({"port": In(SensorPort(form))})

    def elaborate(self, platform: object) -> Module:
        from example_readout import ExampleReadout

        m = Module()
        m.submodules.inner = inner = ExampleReadout(self.faults.get("form", self.form))
        wiring.connect(m, wiring.flipped(self.port), inner.port)
        if self.faults.get("unasked"):
            m.d.comb += inner.port.read.eq(1)
        if self.faults.get("mark"):
            m.d.comb += self.port.beats.payload.row.eq(0)
        return m


def test_codes_are_recorded_as_they_come() -> None:
    beats = record(example_of(ONE_LANE), frames=2)
    assert beats.codes[:, 0].tolist() == [1] * 15 + [2] * 15


@pytest.mark.parametrize(
    ("faults", "check", "words"),
    [
        ({"mark": True}, "test_marks_are_in_the_right_beats", "mark 'row' is wrong in beats"),
        ({"unasked": True}, "test_nothing_comes_unless_it_is_asked_for", "beats for one request"),
        (
            {"form": FrameFormat(rows=2, cols=5, lanes=1, run=8)},
            "test_each_request_brings_one_frame",
            "45",  # beats wanted
        ),
    ],
)
def test_faults_are_found(faults: dict[str, Any], check: str, words: str) -> None:
    with pytest.raises(AssertionError, match=words):
        getattr(SensorPortChecks(), check)(example_of(ONE_LANE, **faults))
