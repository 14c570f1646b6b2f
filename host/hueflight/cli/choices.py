# SPDX-License-Identifier: Apache-2.0
"""Choices that the help of several commands lists."""

from __future__ import annotations

from hueflight.model.instrument import Instrument
from hueflight.reconstruction.entry_point import METHODS
from hueflight.simulator import scenes

PRESETS = ", ".join(Instrument.presets())
METHOD_NAMES = ", ".join(METHODS)
SCENE_NAMES = ", ".join(scenes())
