# SPDX-License-Identifier: Apache-2.0
"""A model of the whole pulse train, fitted to a reference to separate overlapping pulses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration.windows import PulseWindow
from hueflight.errors import CalibrationError, OverlappingBandsError
from hueflight.model.instrument import Instrument
from hueflight.model.pulses import Pulse
from hueflight.model.time_bins import TimeBins

STEP = 1e-5  #: of the numerical derivative, in the fit's own units
MOST_STEPS = 15
SETTLED = 1e-4  #: share of the squares that a step must take off to be followed by another
OVERLAPPING_SHARE = 0.5  #: of the recorded time in pulses, above which bands overlap widely
LARGEST_DEVIATION = 0.2  #: share of a band's light to which it must then be known


@dataclass(frozen=True)
class _Start:
    """First guess of every pulse; the fit's parameters are changes from it.

    Times change in units of sigma, all else in logarithms, so that all are of like size.
    """

    center_ns: NDArray[np.float64]
    sigma_ns: NDArray[np.float64]
    tail_ns: NDArray[np.float64]
    area: NDArray[np.float64]
    dark: float

    def pulse(self, index: int, change: NDArray[np.float64]) -> Pulse:
        """Pulse `index` after a change (shift, sigma, tail, area)."""
        shift, sigma, tail, area = change
        return Pulse(
            center_ns=float(self.center_ns[index] + shift * self.sigma_ns[index]),
            sigma_ns=float(self.sigma_ns[index] * np.exp(sigma)),
            tail_ns=float(self.tail_ns[index] * np.exp(tail)),
            area=float(self.area[index] * np.exp(area)),
        )


def fit_pulse_train(
    counts: NDArray[np.float64],
    windows: tuple[PulseWindow, ...],
    instrument: Instrument,
    bins: TimeBins,
) -> tuple[list[tuple[int, Pulse]], float]:
    """Fit exponentially modified Gaussians and a constant background to a pulse train.

    Parameters
    ----------
    counts : ndarray of float, shape (bin,)
        Counts in time order.
    windows : tuple of PulseWindow
        One window for each pulse.
    instrument : Instrument
        Instrument whose pulses are the first guess.
    bins : TimeBins
        Bins of the counts.

    Returns
    -------
    pulses : list of (int, Pulse)
        Band and fitted pulse for each window.
    background : float
        Background, counts per ns.

    Raises
    ------
    CalibrationError
        If counts are unknown, because pixels recorded a photon in each of their exposures.
    OverlappingBandsError
        If pulses overlap so widely that the light of a band is not known to 20 %.
    """
    if not np.isfinite(counts).all():
        raise CalibrationError(
            "some pixels of the reference hold a photon in every exposure: how many they lost "
            "can't be known. Take more frames than that, all different, dim the LEDs or shorten "
            "the exposure"
        )
    start = _first_guess(counts, windows, instrument, bins)
    size = len(windows)
    scale = 1 / np.sqrt(np.maximum(counts, 1.0))

    def share(index: int, change: NDArray[np.float64]) -> NDArray[np.float64]:
        return start.pulse(index, change).share(bins.edges_ns, bins.period_ns)

    def model(changes: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Weighted residual, and its derivative by every change."""
        slopes = np.empty((counts.size, changes.size))
        dark = start.dark * np.exp(changes[-1]) * bins.widths_ns
        total = dark - counts
        for i, change in enumerate(changes[:-1].reshape(size, 4)):
            here = share(i, change)
            total = total + here
            for j in range(4):
                slopes[:, 4 * i + j] = (share(i, change + STEP * np.eye(4)[j]) - here) / STEP
        slopes[:, -1] = dark
        return total * scale, slopes * scale[:, None]

    # within what a real pulse may do
    reach = np.append(np.tile([3.0, 2.5, 2.5, 2.5], size), 5.0)
    found = _least_squares(model, reach)
    pulses = [start.pulse(i, change) for i, change in enumerate(found[:-1].reshape(size, 4))]
    bands = [window.band for window in windows]
    if overlap_widely(instrument):
        _require_known(*model(found), np.array([pulse.area for pulse in pulses]), bands, instrument)
    return list(zip(bands, pulses, strict=True)), start.dark * float(np.exp(found[-1]))


def overlap_widely(instrument: Instrument) -> bool:
    """Say whether the pulses of the bands fill more than half of the recorded time.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose pulses and period are compared.

    Returns
    -------
    bool
        True where they do.
    """
    together_ns = sum(len(b.delays_ns) * b.pulse_fwhm_ns for b in instrument.bands)
    return together_ns > OVERLAPPING_SHARE * instrument.time_bins().span_ns


def _require_known(
    residual: NDArray[np.float64],
    slopes: NDArray[np.float64],
    area: NDArray[np.float64],
    bands: list[int],
    instrument: Instrument,
) -> None:
    """Refuse a fit that leaves the light of a band unknown.

    Where the model does not explain the counts, deviations are as much wider as the residual is
    (Birge, Phys. Rev. 40, 207, 1932).
    """
    misfit = max(1.0, float(residual @ residual) / max(1, residual.size - slopes.shape[1]))
    length = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    unit = slopes / length
    # of parameters that the counts leave free, the deviation becomes large, not infinite
    covariance = np.linalg.inv(unit.T @ unit + 1e-12 * np.eye(length.size)) * misfit
    covariance /= np.outer(length, length)
    of_areas = covariance[3:-1:4, 3:-1:4] * np.outer(area, area)
    owner = np.array(bands)
    for index, band in enumerate(instrument.bands):
        mine = owner == index
        deviation = float(np.sqrt(of_areas[np.ix_(mine, mine)].sum()) / area[mine].sum())
        if deviation > LARGEST_DEVIATION:
            raise OverlappingBandsError(
                f"the reference does not tell the light of band {band.name!r} from that of its "
                f"neighbors: its brightness is known to {deviation:.0%} only, and "
                f"{LARGEST_DEVIATION:.0%} are required. Pulses overlap widely: shorten them, "
                "lengthen the period, capture more frames, or give one capture per LED (bands)"
            )


def _least_squares(
    model: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]],
    reach: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Parameters within ±reach with the least squares, by Levenberg's and Marquardt's steps."""
    best = np.zeros(reach.size)
    residual, slopes = model(best)
    damping = 1e-3
    for _ in range(MOST_STEPS):
        normal, right = slopes.T @ slopes, slopes.T @ residual
        scale = np.diag(np.maximum(np.diag(normal), 1e-12 * normal.trace()))
        tried = np.clip(best - np.linalg.solve(normal + damping * scale, right), -reach, reach)
        new_residual, new_slopes = model(tried)
        gain = 1 - (new_residual @ new_residual) / (residual @ residual)
        if gain > 0:
            best, residual, slopes = tried, new_residual, new_slopes
            damping /= 10
            if gain < SETTLED:
                break
        else:
            damping *= 10
    return best


def _first_guess(
    counts: NDArray[np.float64],
    windows: tuple[PulseWindow, ...],
    instrument: Instrument,
    bins: TimeBins,
) -> _Start:
    """Centres and areas from the windows, shapes from the instrument."""
    shapes = [instrument.pulses(window.band)[0] for window in windows]
    tail_ns = np.array([shape.tail_ns for shape in shapes])
    sigma_ns = np.array([shape.sigma_ns for shape in shapes])
    mass, moment = np.empty(len(windows)), np.empty(len(windows))
    for index, window in enumerate(windows):
        turns, place = np.divmod(np.arange(window.start, window.stop), bins.count)
        mass[index] = counts[place].sum()
        moment[index] = counts[place] @ (bins.centers_ns[place] + turns * bins.span_ns)
    area = np.maximum(mass, 1e-3 * counts.sum())
    return _Start(
        center_ns=moment / np.maximum(mass, 1e-300) - tail_ns,
        sigma_ns=sigma_ns,
        tail_ns=np.maximum(tail_ns, 0.3 * sigma_ns),  # none at all would have no derivative
        area=area,
        dark=max(float(np.quantile(counts / bins.widths_ns, 0.05)), 1e-6 * area.max()),
    )
