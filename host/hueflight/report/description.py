# SPDX-License-Identifier: Apache-2.0
"""The picture of a description's check: a capture, and the pulses that were described."""

from __future__ import annotations

from matplotlib.figure import Figure

from hueflight.calibration.description_check import DescriptionCheck
from hueflight.model.instrument import Instrument
from hueflight.report.style import label_lines, panels


def draw_description_check(found: DescriptionCheck, instrument: Instrument) -> Figure:
    """Draw the counts of a capture with the described pulses of each band.

    Parameters
    ----------
    found : DescriptionCheck
        The check.
    instrument : Instrument
        The description.

    Returns
    -------
    Figure
        The drawing.
    """
    figure, axes = panels(width=9.0, height=3.6)
    place = axes[0, 0]
    place.step(found.time_ns, found.counts, where="mid", color="0.35", label="capture")
    for band, curve in zip(instrument.bands, found.expected, strict=True):
        place.plot(found.time_ns, curve, lw=1.2, label=f"{band.name}, described")
    place.set_title("; ".join(found.problems)[:110] or f"{instrument.name}: everything fits")
    label_lines(place, "time (ns)", "counts of all good pixels")
    return figure
