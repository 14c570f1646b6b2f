# SPDX-License-Identifier: Apache-2.0
"""The example package is on the path, as if it were installed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

import hueflight as hf

PACKAGE = Path(__file__).resolve().parents[2] / "support" / "example_package"


@pytest.fixture(scope="session", autouse=True)
def installed() -> Iterator[None]:
    sys.path.insert(0, str(PACKAGE))
    yield
    sys.path.remove(str(PACKAGE))


@pytest.fixture(scope="session")
def small() -> hf.Instrument:
    """The paper's instrument with few pixels, at a rate at which runs are short."""
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(
        paper.sensor, rows=6, cols=8, frame_rate_hz=2000.0, exposure_ms=0.2
    )
    return paper.replace(sensor=sensor)
