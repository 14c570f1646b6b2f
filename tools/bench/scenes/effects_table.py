# SPDX-License-Identifier: Apache-2.0
"""What each effect of the simulator does to the depth of every method.

    python3 tools/dev.py bench scenes --effects [--write]

The scene of Fig. 1 is simulated with one effect after another, at the strength of
`simulator.EFFECTS`, and reconstructed with a calibration that has the effect only if it belongs to
the instrument.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray

import hueflight as hf
from hueflight import simulator
from hueflight.reconstruction import with_floor
from hueflight.simulator import Effects, EffectTruth, SimulationSettings

METHODS = ("joint", "paper", "pooled")
SIZE = (96, 64)  #: of the sensor; its pixels see twice the angle of preset `paper`
FRAMES, REFERENCE_FRAMES = 40_000, 40_000
SETTINGS = SimulationSettings(white_detections=0.35, ambient=0.04)
LEAST_SHARE = 0.02  #: of a pixel's light, from which a surface counts as seen
#: what to do about each effect, for readers of the table
REMEDIES = {
    "footprint": "nothing: `joint` flags mixed pixels and gives both depths",
    "motion": "nothing: the same as at edges",
    "sky": "nothing: pixels without a surface are flagged",
    "pane": "`second_depth` where it can be told apart; else take the pane away",
    "foliage": "trust no depth in front of which leaves are: several returns blend",
    "fog": "`--check` names a tail; search beyond the near fog (`--depth-range`)",
    "bounce": "nothing: neither flagged nor corrected; avoid bright surfaces beside the scene",
    "tail": "`--check` widens deviations; the bias itself can't be corrected",
    "flare": "`--check` widens deviations; keep bright near objects out of the picture",
    "reflection": "block it, or subtract a capture without a target",
    "background ramp": "`--background sloped` or `--correct-drift`",
    "background decay": "`--background sloped` or `--correct-drift`",
    "delay drift": "`--correct-drift`; then calibrate again",
    "width drift": "`--correct-drift`; then calibrate again",
    "warming": "calibrate warm: a common delay looks like a distance",
    "bin widths": "a new `flat` capture; `--correct-drift` makes it worse",
    "hot pixels": "`hueflight check`, then a new dark capture",
    "crosstalk": "nothing at this strength",
    "afterpulses": "nothing with exposures of many periods",
}


@dataclass(frozen=True)
class Result:
    """What a method reports of a picture.

    Attributes
    ----------
    error_m : float
        What 68 % of the errors of unflagged pixels are below, m, each against the nearest surface
        that the pixel sees.
    flagged : float
        Share of the pixels that have no depth or a flag.
    wrong : float
        Share of the pixels that are unflagged and further than three stated deviations from every
        surface that they see.
    """

    error_m: float
    flagged: float
    wrong: float

    def cell(self) -> str:
        """Return the three figures as one cell of a table."""
        return f"{100 * self.error_m:.1f} cm · {self.flagged:.1%} · {self.wrong:.1%}"


def lines(names: list[str] | None = None) -> Iterator[list[str]]:
    """Measure effects, by default a picture without any and then all; yield cells of the table."""
    if not names:
        yield _line("none", simulator.NamedEffect("as calibrated"))
    for name in names or list(simulator.EFFECTS):
        yield _line(name, simulator.EFFECTS[name])


HEAD = [
    "effect", "strength", *(f"`{method}`: error · flagged · wrong" for method in METHODS),
    "`--check` names", "`joint` after `--correct-drift`", "what to do",
]  # fmt: skip


@cache
def instrument() -> hf.Instrument:
    """Return the instrument of the paper with fewer and larger pixels."""
    paper = hf.Instrument.load("paper")
    sensor = paper.sensor
    assert sensor.pixel_width_um is not None
    assert sensor.pixel_height_um is not None
    return paper.replace(
        sensor=msgspec.structs.replace(
            sensor,
            rows=SIZE[0],
            cols=SIZE[1],
            pixel_width_um=sensor.pixel_width_um * sensor.cols / SIZE[1],
            pixel_height_um=sensor.pixel_height_um * sensor.rows / SIZE[0],
        )
    )


@cache
def calibration(effects: Effects) -> hf.Calibration:
    """Return a calibration of the instrument with these effects."""
    settings = SETTINGS.replace(effects=effects)

    def capture(kind: simulator.CaptureKind, frames: int) -> NDArray[np.unsignedinteger]:
        return simulator.simulate_capture(
            kind, instrument(), frames=frames, settings=settings, distance=1.0
        )

    return hf.calibrate(
        capture("reference", REFERENCE_FRAMES),
        instrument(),
        distance=1.0,
        bands=capture("bands", REFERENCE_FRAMES),
        dark=capture("dark", REFERENCE_FRAMES),
        flat=capture("flat", 10 * REFERENCE_FRAMES),
    )


def captured(effect: simulator.NamedEffect) -> tuple[NDArray[np.unsignedinteger], EffectTruth]:
    """Return a histogram of the scene with an effect, and the truth."""
    settings = SETTINGS.replace(effects=effect.typical)
    layout: dict[str, Any] = dict(effect.layout)
    name = "skyline" if effect.typical.sky else "fig1"
    seen = simulator.scene(name, instrument(), **layout)
    counts = simulator.simulate_capture(
        "scene", instrument(), frames=FRAMES, settings=settings, scene=seen, seed=4
    )
    return counts, simulator.effect_truth(seen, instrument(), settings)


def _line(name: str, effect: simulator.NamedEffect) -> list[str]:
    counts, truth = captured(effect)
    known = calibration(effect.typical if effect.belongs_to == "instrument" else Effects())
    usable = known.usable
    images = {method: hf.reconstruct(counts, known, method=method) for method in METHODS}
    correction = hf.correct_drift(counts, known, images["joint"])
    named = ", ".join(suspect.name for suspect in correction.before.found) or "–"
    corrected = hf.reconstruct(counts, correction.calibration, background=correction.background)
    corrected = with_floor(corrected, counts, correction.calibration, correction.after)
    changes = {**effect.typical.active, **effect.layout}
    strength = ", ".join(f"`{key}={_short(value)}`" for key, value in changes.items())
    return [
        f"{name}: {effect.description}",
        strength or "–",
        *(_judged(images[method], truth, usable).cell() for method in METHODS),
        named,
        _judged(corrected, truth, usable).cell(),
        REMEDIES.get(name, ""),
    ]


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _judged(image: xr.Dataset, truth: EffectTruth, usable: NDArray[np.bool_]) -> Result:
    depth, std = image["depth"].values, image["depth_std"].values
    surfaces = np.where(truth.shares >= LEAST_SHARE, truth.depths, np.nan)
    off = np.full(depth.shape, np.inf)  # where nothing is, every depth is wrong
    for surface in surfaces:
        off = np.fmin(off, np.abs(depth - surface))
    unflagged = usable & np.isfinite(depth) & (image["quality"].values == 0)
    return Result(
        error_m=float(np.quantile(off[unflagged], 0.68)) if unflagged.any() else float("nan"),
        flagged=float((usable & ~unflagged).sum() / usable.sum()),
        wrong=float((unflagged & (off > 3 * std)).sum() / usable.sum()),
    )
