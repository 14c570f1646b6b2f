# SPDX-License-Identifier: Apache-2.0
"""Effects of real scenes, sensors and days that an ideal model leaves out, each off by default.

>>> Effects(pane_share=0.3).replace(pane_depth=0.5).pane_depth
0.5
"""

from hueflight.simulator.effects.registry import EFFECTS, NamedEffect
from hueflight.simulator.effects.settings import Effects

__all__ = ["EFFECTS", "Effects", "NamedEffect"]
