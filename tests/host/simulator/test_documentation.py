# SPDX-License-Identifier: Apache-2.0
"""What docs/simulator.md says runs, and its numbers hold."""

import re
from pathlib import Path

import numpy as np
import pytest

from hueflight import Instrument
from hueflight.simulator import (
    SCENES,
    Effects,
    EffectTruth,
    SimulationSettings,
    radiometric_detections,
)

PAGE = (Path(__file__).parents[3] / "docs" / "simulator.md").read_text("utf-8")


def test_the_example_runs():
    example, with_effects = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    names = {}
    exec(example, names)
    assert names["histogram"].shape == (192, 128, 512)
    assert isinstance(names["packet"], bytes)
    exec(with_effects, names)
    assert names["truth"].shares.sum(axis=0) == pytest.approx(1)


def test_effects_and_defaults_are_those_of_the_code():
    section = PAGE.partition("## Effects of real scenes and sensors")[2].partition("\n## ")[0]
    shown = dict(re.findall(r"\b([a-z_]+)=([0-9.]+)[,`]", section.partition("\n- **")[0]))
    described = {name: value for name, value in shown.items() if name in vars(Effects())}
    # the example comes first, the table last
    assert {name: float(value) for name, value in described.items()} == vars(Effects())
    for name in re.findall(r"`([a-z_]+)(?:\(\))?`(?=[^|]*\|$)", section, flags=re.MULTILINE):
        assert hasattr(EffectTruth, name) or name in EffectTruth.__dataclass_fields__, name


def test_options_and_defaults_are_those_of_the_code():
    for name, entry in SCENES.items():
        (row,) = re.findall(rf"^\| `{name}` \|.*$", PAGE, flags=re.MULTILINE)
        for option, default in entry.options.items():
            shown = f'"{default}"' if isinstance(default, str) else f"{default:g}"
            assert re.search(rf"{option}={shown}\b|{option}={shown}", row.replace("1.0", "1")), row
    settings = SimulationSettings()
    for names, values in re.findall(
        r"^\| (`[a-z_`, ]+) \| ([0-9., ]+) \|", PAGE, flags=re.MULTILINE
    ):
        for name, value in zip(re.findall("[a-z_]+", names), values.split(","), strict=True):
            assert getattr(settings, name) == float(value)


@pytest.mark.parametrize(
    ("preset", "f_number"), [("paper", 8.2), ("fullrate", 1.9), ("spad512", 2.4), ("line1024", 3.5)]
)
def test_apertures(preset, f_number):
    instrument = Instrument.load(preset)
    equivalent = 1.4 * np.sqrt(radiometric_detections(instrument) / 0.35)
    assert equivalent == pytest.approx(f_number, abs=0.06)
