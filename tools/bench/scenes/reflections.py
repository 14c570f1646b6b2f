# SPDX-License-Identifier: Apache-2.0
"""A fixed reflection of any strength, as of a cover glass: refused, or by how much depth is off.

    python3 tools/dev.py bench scenes --reflections [--write]

The simulator adds the same reflection to the reference and to what is seen afterwards: a white
plane at other distances. Strengths are relative to the light of the reference target.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

import hueflight as hf
from hueflight import simulator
from hueflight.errors import CalibrationError
from hueflight.simulator import CaptureKind, Effects, SimulationSettings

STRENGTHS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
SIZE = (16, 12)
PHOTONS = 10_000  #: of the reference target in a pixel, of which the plane returns its share


@dataclass(frozen=True)
class Setting:
    """An instrument and distances of its targets.

    Attributes
    ----------
    name : str
        For readers of the table.
    instrument : Instrument
        The instrument.
    reference_m : float
        Distance of the reference target.
    seen_m : tuple of float
        Distances of the plane that is seen.
    """

    name: str
    instrument: hf.Instrument
    reference_m: float
    seen_m: tuple[float, ...]


def lines() -> Iterator[list[str]]:
    """Measure one strength after another; yield cells of the table."""
    settings = _settings()
    for strength in STRENGTHS:
        yield [f"{strength:.1%}", *(_outcome(setting, strength) for setting in settings)]


def head() -> list[str]:
    """Return the heads of the columns."""
    return ["reflection", *(setting.name for setting in _settings())]


def _settings() -> list[Setting]:
    """Short pulses, then those of the paper at three distances of the reference."""
    cases = (
        ("pulses of 1.5 ns", _short_pulses(), 1.0, (0.7, 1.2, 2.0)),
        ("preset `paper`", _paper(), 0.4, (0.5, 1.2, 2.0)),
        ("preset `paper`", _paper(), 1.0, (0.5, 1.2, 2.0)),
        ("preset `paper`", _paper(), 2.5, (1.2, 2.0, 3.0)),
    )
    return [
        Setting(
            f"{name}, reference at {reference_m:g} m, plane at "
            + ", ".join(f"{distance:g}" for distance in seen_m) + " m",
            instrument, reference_m, seen_m,
        )
        for name, instrument, reference_m, seen_m in cases
    ]  # fmt: skip


def _paper() -> hf.Instrument:
    paper = hf.Instrument.load("paper")
    return paper.replace(sensor=msgspec.structs.replace(paper.sensor, rows=SIZE[0], cols=SIZE[1]))


def _short_pulses() -> hf.Instrument:
    """Return one band of short pulses on the sensor of the paper."""
    plain = _paper()
    sensor = msgspec.structs.replace(plain.sensor, code_bits=7, bin_width_ns=0.3)
    band = msgspec.structs.replace(
        plain.bands[0], delay_ns=2.0, pulse_fwhm_ns=1.5, pulse_tail_ns=0.0
    )
    timing = msgspec.structs.replace(plain.timing, period_ns=38.1, latency_ns=0.0)
    return plain.replace(sensor=sensor, bands=(band,), timing=timing)


def _outcome(setting: Setting, strength: float) -> str:
    relative = strength / setting.reference_m**2  # the simulator's is that of a plane at 1 m
    settings = SimulationSettings.ideal(
        white_detections=0.05, ambient=0.002, effects=Effects(reflection=relative)
    )
    frames = int(PHOTONS / 0.05 * setting.reference_m**2)

    def capture(kind: CaptureKind, distance: float, seed: int, share: float = 1.0):
        return simulator.simulate_capture(
            kind, setting.instrument, frames=int(share * frames), settings=settings,
            distance=distance, seed=seed,
        )  # fmt: skip

    several = len(setting.instrument.bands) > 1
    bands = capture("bands", setting.reference_m, 2, 0.2) if several else None
    try:
        calibration = hf.calibrate(
            capture("reference", setting.reference_m, 1), setting.instrument,
            distance=setting.reference_m, bands=bands,
        )  # fmt: skip
    except CalibrationError as error:
        if "fixed reflection" not in str(error):
            raise
        return "refused"
    biases, shares = [], []
    for distance in setting.seen_m:
        image = hf.reconstruct(capture("reference", distance, 3), calibration)
        error_m = np.array([image[name] - distance for name in ("depth", "second_depth")])
        nearest = np.nanargmin(np.abs(error_m), axis=0)  # of two surfaces, one is the reflection
        bias_mm = 1e3 * np.median(np.take_along_axis(error_m, nearest[None], axis=0))
        flagged = float((image["quality"] != 0).mean())
        biases.append(f"{bias_mm:+.0f}")
        shares.append(f"{100 * flagged:.0f}")
    return f"{', '.join(biases)} mm ({', '.join(shares)} %)"
