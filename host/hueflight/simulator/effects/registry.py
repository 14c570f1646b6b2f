# SPDX-License-Identifier: Apache-2.0
"""The effects by name, each with a strength that is typical of real scenes and sensors.

Documentation and benchmarks go through this table; a new effect gets an entry here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from hueflight.simulator.effects.settings import Effects


@dataclass(frozen=True)
class NamedEffect:
    """An effect of real scenes, sensors or days.

    Attributes
    ----------
    description : str
        What happens, in a few words.
    typical : Effects
        Settings with a typical strength.
    layout : mapping of str to Any
        Options of `simulator.scene` with a typical strength, for effects of the scene's geometry.
    belongs_to : {"scene", "day", "instrument"}
        Which captures have it: ``"scene"``, those of the scene; ``"day"``, those that are made
        after the calibration; ``"instrument"``, those of the calibration too.
    """

    description: str
    typical: Effects = field(default_factory=Effects)
    layout: Mapping[str, Any] = field(default_factory=dict)
    belongs_to: Literal["scene", "day", "instrument"] = "scene"


EFFECTS: dict[str, NamedEffect] = {
    "footprint": NamedEffect("pixels at edges see two surfaces", layout={"rays": 4}),
    "motion": NamedEffect(
        "the scene moves during the capture", layout={"motion": (0.02, 0.0, 0.0)}
    ),
    "sky": NamedEffect("light from where a ray meets nothing", Effects(sky=1.0)),
    "pane": NamedEffect(
        "pane, mesh or dusty window in front of the scene", Effects(pane_share=0.05)
    ),
    "foliage": NamedEffect("leaves at many depths", Effects(foliage_share=0.3)),
    "fog": NamedEffect("scattering on the way", Effects(fog_per_m=0.2)),
    "bounce": NamedEffect("multipath between surfaces", Effects(bounce_share=0.2)),
    "tail": NamedEffect(
        "exponential delay of a part of the light: much multipath", Effects(tail_share=0.2)
    ),
    "flare": NamedEffect("light that the lens scatters", Effects(flare_share=0.1)),
    "reflection": NamedEffect(
        "fixed reflection, as of a cover glass",
        Effects(reflection=0.2, reflection_delay_ns=0.5),
        belongs_to="instrument",
    ),
    "background ramp": NamedEffect("ambient light rises", Effects(background_ramp=0.5)),
    "background decay": NamedEffect("ambient light decays", Effects(background_decay_share=0.5)),
    "delay drift": NamedEffect(
        "LEDs fire later or earlier",
        Effects(delay_drift_ps=(-40.0, 150.0, 130.0, -120.0, -90.0, -120.0, 40.0, -40.0, 90.0)),
        belongs_to="day",
    ),
    "width drift": NamedEffect(
        "pulses last longer", Effects(pulse_width_factor=1.05), belongs_to="day"
    ),
    "warming": NamedEffect(
        "LEDs are warmer than at their calibration", Effects(warming=20.0), belongs_to="day"
    ),
    "bin widths": NamedEffect(
        "widths of time bins drift", Effects(bin_width_drift=0.02), belongs_to="day"
    ),
    "hot pixels": NamedEffect("pixels turn hot", Effects(new_hot_share=0.01), belongs_to="day"),
    "crosstalk": NamedEffect(
        "neighbors set off avalanches", Effects(crosstalk_share=0.01), belongs_to="instrument"
    ),
    "afterpulses": NamedEffect(
        "avalanches set off by those of the exposure before",
        Effects(afterpulse_share=0.02),
        belongs_to="instrument",
    ),
}
