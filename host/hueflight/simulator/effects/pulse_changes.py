# SPDX-License-Identifier: Apache-2.0
"""LED pulses that are later, longer or drawn out compared with those of the description."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hueflight.model.instrument import Instrument
from hueflight.model.pulses import SHORT_TAIL, Pulse
from hueflight.simulator.effects.settings import Effects

# Two exponential decays of equal length follow each other as the limit of unequal ones; at this
# relative distance the shape differs from the limit by its square, 1e-8.
_APART = 1e-4


def pulse_trains(instrument: Instrument, effects: Effects) -> tuple[tuple[Pulse, ...], ...]:
    """Return the pulses of each band with drift and exponential tail.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose pulses are changed.
    effects : Effects
        Drift of delay and width per band, share and mean of the additional exponential delay.

    Returns
    -------
    tuple of tuple of Pulse
        Pulses of each band as they would arrive from distance 0. Their areas sum to 1; a pulse
        may have a negative area, as a convolution of two exponential decays is a difference.
    """
    bands = len(instrument.bands)
    drift_ns = 1e-3 * effects.delay_change_ps(bands)
    factor = effects.width_change(bands)
    trains = []
    for band in range(bands):
        train: list[Pulse] = []
        for pulse in instrument.pulses(band):
            drifted = replace(
                pulse,
                center_ns=pulse.center_ns + float(drift_ns[band]),
                sigma_ns=pulse.sigma_ns * float(factor[band]),
                tail_ns=pulse.tail_ns * float(factor[band]),
            )
            train += _with_tail(drifted, effects.tail_share, effects.tail_ns)
        trains.append(tuple(train))
    return tuple(trains)


def _with_tail(pulse: Pulse, share: float, tail_ns: float) -> list[Pulse]:
    """Pulses whose sum is a pulse of which a share went through an exponential delay."""
    if share == 0:
        return [pulse]
    direct = [replace(pulse, area=(1 - share) * pulse.area)] if share < 1 else []
    delayed = share * pulse.area
    own_ns = pulse.tail_ns
    if own_ns <= SHORT_TAIL * pulse.sigma_ns:
        return [*direct, replace(pulse, tail_ns=tail_ns, area=delayed)]
    if np.isclose(own_ns, tail_ns, rtol=_APART, atol=0):
        middle_ns = (own_ns + tail_ns) / 2
        own_ns, tail_ns = middle_ns * (1 - _APART), middle_ns * (1 + _APART)
    # density of the sum of two exponential delays: (e^(-t/a) - e^(-t/b)) / (a - b)
    weight = tail_ns / (tail_ns - own_ns)
    return [
        *direct,
        replace(pulse, tail_ns=tail_ns, area=delayed * weight),
        replace(pulse, tail_ns=own_ns, area=delayed * (1 - weight)),
    ]
