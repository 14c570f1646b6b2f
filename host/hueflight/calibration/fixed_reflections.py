# SPDX-License-Identifier: Apache-2.0
"""Light of a reference that comes from the camera itself, as from a cover glass.

It stays in place while the target moves, so that it must not become part of the waveforms, nor be
taken for the target.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration.windows import PulseWindow
from hueflight.errors import CalibrationError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.model.time_bins import TimeBins

REFLECTION_MARGIN = 8.0  #: standard deviations by which a weak reflection stands out,
LEAST_REFLECTION = 0.003  #: and its share of the target's light, below which it is harmless
LEAST_PULSES = 0.5  #: share of the pulses that must tell: one may be misled by wings of others
LEAST_SEEN = 0.6  #: of a reflected pulse, outside the windows of the target's own pulses
REMEDY = (
    "Block it, or capture the same without a target and subtract those counts from reference and "
    "scene"
)


def require_pulses_where_due(
    visible: NDArray[np.float64],
    found: NDArray[np.integer],
    due: Sequence[tuple[int, float, int]],
    near: int,
    bins: TimeBins,
) -> None:
    """Refuse a reference whose pulses were found elsewhere than where they are due and seen.

    Parameters
    ----------
    visible : ndarray of float, shape (bin,)
        Light above the noise, in time order.
    found : ndarray of int, shape (pulse,)
        Bins that are taken for the pulses.
    due : sequence of tuple of int, float, int
        Band, time (ns) and bin of each pulse as the description has it.
    near : int
        Bins by which a pulse may miss its place.
    bins : TimeBins
        Bins of the counts.

    Raises
    ------
    CalibrationError
        If there are pulses where they are due, and others were found.
    """
    alone = False
    for _, _, middle in due:
        around = np.arange(middle - 2 * near, middle + 2 * near + 1)
        beside = around[0] - 2 * near - 1, around[-1] + 2 * near + 1
        if bins.period_ns is None and not (beside[0] >= 0 and beside[1] < bins.count):
            return
        top = around[np.argmax(visible[around % bins.count])]
        sides = visible[[(top + step) % bins.count for step in (-2 * near - 1, 2 * near + 1)]]
        if visible[top % bins.count] <= 2 * sides.max():
            return  # no pulse there: the latency differs from the description
        off = found - top
        if bins.period_ns is not None:
            off = (off + bins.count // 2) % bins.count - bins.count // 2
        alone |= bool(np.abs(off).min() > near)
    if not alone:
        return  # equally spaced pulses: those of other bands stand there
    strongest = bins.centers_ns[found[0] % bins.count]
    raise CalibrationError(
        f"the reference shows pulses where they are due, the first at {due[0][1]:.1f} ns, and "
        f"stronger light at {strongest:.1f} ns: a fixed reflection, as of a cover glass. It would "
        f"be taken for the target. {REMEDY}"
    )


def require_no_earlier_pulses(
    counts: NDArray[np.float64],
    windows: tuple[PulseWindow, ...],
    bins: TimeBins,
    distance: float,
) -> None:
    """Refuse a reference with pulses from the camera itself that are weaker than the target's.

    They have the shape of the target's pulses and come earlier by the time to the target and back.
    Nothing is concluded of a pulse where most of its reflection would lie within the windows of the
    target's own pulses, nor of all where that is so of more than half of them.

    Parameters
    ----------
    counts : ndarray of float, shape (bin,)
        Counts of the reference, in time order.
    windows : tuple of PulseWindow
        Windows of the target's pulses.
    bins : TimeBins
        Bins of the counts.
    distance : float
        Distance of the reference target, m.

    Raises
    ------
    CalibrationError
        If there are such pulses.
    """
    inside = np.zeros(bins.count, bool)
    for window in windows:
        inside[np.arange(window.start, window.stop) % bins.count] = True
    if inside.all():
        return
    level = float(np.median((counts / bins.widths_ns)[~inside]))
    early = round(2 * distance / SPEED_OF_LIGHT_M_PER_NS / (bins.span_ns / bins.count))
    found = [_reflected(counts, window, inside, level, early, bins) for window in windows]
    shares, deviations = np.array([one for one in found if one is not None]).reshape(-1, 2).T
    if shares.size < LEAST_PULSES * len(windows):
        return
    weights = 1 / deviations**2
    share = float(weights @ shares / weights.sum())
    certain = share > max(REFLECTION_MARGIN / np.sqrt(weights.sum()), LEAST_REFLECTION)
    if certain and (shares + 3 * deviations > share / 3).all():
        raise CalibrationError(
            f"the reference shows light from the camera itself, {share:.1%} as strong as "
            "the target's, where pulses from a distance of 0 are due: a fixed reflection, as of a "
            f"cover glass. It stays in place while the target moves. {REMEDY}"
        )


def _reflected(
    counts: NDArray[np.float64],
    window: PulseWindow,
    inside: NDArray[np.bool_],
    level: float,
    early: int,
    bins: TimeBins,
) -> tuple[float, float] | None:
    """Fit an earlier pulse of the same shape as the one in a window.

    Returns
    -------
    share, deviation : float
        Its light as a share of the pulse, and the standard deviation of that share; None where too
        little of it would lie outside the windows.
    """
    own = np.arange(window.start, window.stop) % bins.count
    pulse = np.maximum(counts[own] - level * bins.widths_ns[own], 0)
    margin = own.size // 2
    place = np.arange(window.start - margin, window.stop + margin) - early
    shape = np.pad(pulse, margin)
    if bins.period_ns is None:
        recorded = (place >= 0) & (place < bins.count)
        place, shape = place[recorded], shape[recorded]
    place %= bins.count
    free = ~inside[place]
    if place.size > bins.count or shape[free].sum() < LEAST_SEEN * pulse.sum():
        return None
    place, shape = place[free], shape[free]
    along = np.linspace(-1, 1, place.size)
    widths = bins.widths_ns[place]
    deviation = np.sqrt(np.maximum(counts[place], 1))
    design = np.column_stack([shape, widths, widths * along]) / deviation[:, None]
    amounts, misfit, rank, _ = np.linalg.lstsq(design, counts[place] / deviation)
    if rank < design.shape[1] or place.size <= rank:
        return None
    variance = np.linalg.inv(design.T @ design)[0, 0]
    # uneven bins, and backgrounds that no line describes
    variance *= max(float(misfit[0]) / (place.size - rank), 1.0)
    return float(amounts[0]), float(np.sqrt(variance))
