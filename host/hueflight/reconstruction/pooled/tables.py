# SPDX-License-Identifier: Apache-2.0
"""Waveforms over the period, and the window in it that each band has to itself."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.reconstruction.pooled.kernels import Floats

CELLS_PER_FWHM = 90  #: of the shortest pulse
COLORS = 2  #: groups of bands by wavelength that tell neighbors apart
LIT = 0.02  #: of its peak: where a pulse is weaker, the window is background's


@dataclass(frozen=True, eq=False)
class Tables:
    """Waveforms on the cells of the period, as they arrive from the reference.

    Attributes
    ----------
    period_ns, cells_per_ns : float
        The period, and cells per ns.
    fwhm_ns : float
        Width of the shortest pulse at half its maximum.
    shares, slopes : ndarray of float32, shape (cell, band)
        Light per ns, and its derivative by time.
    white : ndarray of float, shape (band,)
        Share of each band in the light of a white target.
    windows : ndarray of int8, shape (cell,)
        Band whose pulse is strongest in the cell, or one more for the background.
    mixing : ndarray of float, shape (window, band + 1)
        Share of the light of each band, and of background, that falls into each window.
    unmixing : ndarray of float32, shape (band + 1, window)
        Conversion from photons in windows to amplitudes and background.
    groups : ndarray of float32, shape (window, group)
        1 where a window belongs to a group of bands.
    quiet : ndarray of bool, shape (cell,)
        True where no delay within the search brings light.
    """

    period_ns: float
    cells_per_ns: float
    fwhm_ns: float
    shares: Floats
    slopes: Floats
    white: NDArray[np.float64]
    windows: NDArray[np.int8]
    mixing: NDArray[np.float64]
    unmixing: Floats
    groups: Floats
    quiet: NDArray[np.bool_]

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.white.size


_tables: WeakKeyDictionary[Calibration, dict[tuple[float, float], Tables]] = WeakKeyDictionary()


def tables_for(calibration: Calibration, search_ns: tuple[float, float]) -> Tables:
    """Return the tables for a calibration, which are kept as long as it lives.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    search_ns : tuple of float
        Least and greatest delay.

    Returns
    -------
    Tables
        Waveforms of the instrument.
    """
    made = _tables.setdefault(calibration, {})
    if search_ns not in made:
        made[search_ns] = _make_tables(calibration, search_ns)
    return made[search_ns]


def _make_tables(calibration: Calibration, search_ns: tuple[float, float]) -> Tables:
    period_ns = calibration.bins.period_ns
    if period_ns is None:
        raise HueflightError(
            f"instrument {calibration.instrument.name!r} has no period: pooling of photons is "
            "for trains of pulses; use method='joint'"
        )
    fwhm_ns = min(band.pulse_fwhm_ns for band in calibration.instrument.bands)
    cells = int(np.ceil(CELLS_PER_FWHM * period_ns / fwhm_ns))
    cell_ns = period_ns / cells
    middles_ns = (np.arange(cells) + 0.5) * cell_ns
    shares = calibration.templates.density(middles_ns).T
    edges_ns = np.arange(cells + 1) * cell_ns
    slopes = np.diff(calibration.templates.density(edges_ns)).T / cell_ns
    bands = shares.shape[1]
    white = calibration.brightness / calibration.brightness.sum()
    strongest = (shares * white).argmax(axis=1)
    relative = (shares / shares.max(axis=0))[np.arange(cells), strongest]
    windows = np.where(relative > LIT, strongest, bands)
    inside = np.eye(bands + 1)[windows]  # cell, window
    mixing = np.column_stack([inside.T @ shares * cell_ns, inside.sum(axis=0) / cells])
    order = np.argsort(np.argsort(calibration.instrument.wavelengths_nm))
    groups = np.zeros((bands + 1, COLORS + 1))
    # more light at long waves is common to LEDs, detectors and paints: split where a third is left
    groups[np.arange(bands), np.where(order < bands / 3, 0, 1)] = 1
    groups[bands, COLORS] = 1
    reach = int(np.ceil(max(abs(bound) for bound in search_ns) / cell_ns))
    lit = np.append(windows, windows) < bands
    near = np.convolve(np.tile(lit, 2).astype(float), np.ones(2 * reach + 1), mode="same") > 0
    return Tables(
        period_ns=period_ns,
        cells_per_ns=1 / cell_ns,
        fwhm_ns=fwhm_ns,
        shares=shares.astype(np.float32, order="C"),
        slopes=slopes.astype(np.float32, order="C"),
        white=white,
        windows=windows.astype(np.int8),
        mixing=mixing,
        unmixing=np.linalg.pinv(mixing).astype(np.float32, order="C"),
        groups=groups.astype(np.float32),
        quiet=~near[cells : 2 * cells],
    )
