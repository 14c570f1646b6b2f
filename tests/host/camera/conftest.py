"""A small, fast instrument and a rig for it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import hueflight as hf

sys.path.insert(0, str(Path(__file__).parent))

from faulty_rig import FaultyRig

Small = Callable[..., hf.Instrument]


@pytest.fixture(scope="session")
def fast(small: Small) -> hf.Instrument:
    """Few pixels, two thousand frames a second."""
    return small(rows=6, cols=8, frame_rate_hz=2000.0, exposure_ms=0.2)


@pytest.fixture
def rig(fast: hf.Instrument) -> FaultyRig:
    return FaultyRig(fast)
