# SPDX-License-Identifier: Apache-2.0
"""Small instruments and photons drawn from continuous-time pulses, for all host tests."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

import hueflight as hf
from hueflight import backend
from hueflight.reconstruction.bounds import expected_shares
from support.faulty_rig import FaultyRig

Draw = Callable[..., NDArray[np.uint32]]


@pytest.fixture(scope="session")
def small() -> Callable[..., hf.Instrument]:
    """Function that cuts a preset down to a few pixels: small("paper", rows=4, cols=5)."""

    def cut(preset: str = "paper", *, rows: int = 8, cols: int = 8, **sensor: Any) -> hf.Instrument:
        instrument = hf.Instrument.load(preset)
        smaller = msgspec.structs.replace(instrument.sensor, rows=rows, cols=cols, **sensor)
        return instrument.replace(sensor=smaller, lens=None)

    return cut


@pytest.fixture(scope="session")
def draw() -> Draw:
    """Function that draws counts (row, col, code) from the instrument's pulses themselves.

    Every pixel sees the same: `photons` of signal and `background` photons expected in all,
    `reflectance` per band, at `depth`; code 0 fills up to `frames`.
    """

    def counts(
        instrument: hf.Instrument,
        *,
        depth: float = 0.5,
        photons: float = 1000.0,
        reflectance: Any = 1.0,
        background: float = 0.0,
        frames: int = 1_000_000,
        seed: int = 0,
    ) -> NDArray[np.uint32]:
        shares, _, widths = expected_shares(instrument, depth)
        amplitudes = instrument.band_brightness() * reflectance
        total = amplitudes.sum()
        amplitudes = amplitudes * (photons / total if total else 0.0)
        bins = instrument.time_bins()
        mean = amplitudes @ shares + background * widths
        drawn = np.random.default_rng(seed).poisson(mean, (*instrument.image_shape, bins.count))
        histogram = np.zeros(instrument.histogram_shape, np.uint32)
        histogram[..., bins.codes] = drawn
        if instrument.sensor.reports_empty:
            histogram[..., 0] = np.maximum(frames - drawn.sum(axis=-1), 0)
        return histogram

    return counts


@pytest.fixture
def compiled_fit() -> None:
    """The compiled fit is there, or the test is skipped."""
    if not backend.available("fit"):
        pytest.skip("no compiled fit was built")


@pytest.fixture(params=backend.KERNELS["fit"].builds)
def fit_build(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Every build of the compiled fit that this processor runs, in use."""
    builds = backend.KERNELS["fit"].builds
    base = pytest.importorskip(builds[-1])
    if builds.index(request.param) < len(builds) - 1 - base.processor():
        pytest.skip(f"this processor can't run {request.param}")
    build = pytest.importorskip(request.param)
    monkeypatch.setattr(backend, "compiled", lambda *_: build)
    return build


@pytest.fixture(scope="session")
def fast(small: Callable[..., hf.Instrument]) -> hf.Instrument:
    """Few pixels, two thousand frames a second."""
    return small(rows=6, cols=8, frame_rate_hz=2000.0, exposure_ms=0.2)


@pytest.fixture
def rig(fast: hf.Instrument) -> FaultyRig:
    """A simulated rig whose faults a test switches on."""
    return FaultyRig(fast)


@pytest.fixture(scope="session")
def paper() -> hf.Instrument:
    """The published instrument."""
    return hf.Instrument.load("paper")
