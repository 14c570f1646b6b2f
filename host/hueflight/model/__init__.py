# SPDX-License-Identifier: Apache-2.0
"""Physics of the measurement: instrument, pulses, time bins, waveforms, spectra and pile-up."""

from hueflight.model.background_shape import BackgroundShape
from hueflight.model.emission import Emission
from hueflight.model.instrument import (
    SPEED_OF_LIGHT_M_PER_NS,
    Band,
    Instrument,
    Lens,
    Sensor,
    Timing,
)
from hueflight.model.pulses import Pulse
from hueflight.model.schedules import (
    Schedule,
    ambiguity,
    design_schedules,
    unambiguous_range,
)
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates

__all__ = [
    "SPEED_OF_LIGHT_M_PER_NS",
    "BackgroundShape",
    "Band",
    "Emission",
    "Instrument",
    "Lens",
    "Pulse",
    "Schedule",
    "Sensor",
    "Templates",
    "TimeBins",
    "Timing",
    "ambiguity",
    "design_schedules",
    "unambiguous_range",
]
