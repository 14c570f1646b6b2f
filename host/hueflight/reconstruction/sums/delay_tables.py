# SPDX-License-Identifier: Apache-2.0
"""Expected sums and their covariances over the delay, computed once per calibration and design.

Sums s_k = Σ_i h_i G_ki of Poisson counts with mean μ_i have the mean Σ_i G_ki μ_i and the
covariance Σ_i G_ki G_li μ_i. Both are linear in the amplitudes and the background, so that tables
of each band at each delay give them for any pixel. At each delay a matrix *separates* the sums into
photons of each band and of the background and into a *rest* that is 0 on average for any light.

All tables are for *whitened* sums: those times the matrix that makes the covariance of a white
surface at the middle of the design the unit matrix. Single precision suffices for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.reconstruction.sums.design import SumsDesign

PHASE_NS = 0.25  #: between tabulated delays; the fit is linear between them
LAG_PHASES = 4  #: tabulated delays per lag of the search
TABLES_KEPT = 4  #: of a calibration: offsets that follow the depth differ from picture to picture
TYPICAL_BACKGROUND = 0.3  #: photons per photon of signal in the covariance of the search

Floats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class SumTables:
    """Tables of the estimator.

    Attributes
    ----------
    first_ns, phase_ns : float
        First tabulated delay against the middle of the design, and the step between them.
    offsets : ndarray of int, shape (offset,)
        Offsets of pixels that the tables are for, in ascending order.
    separate : ndarray of float, shape (offset, phase, sum, sum)
        Matrix from whitened sums to photons of each band and of the background, and to the rest,
        each of which has the standard deviation 1 for one photon of a white surface.
    slopes : ndarray of float, shape (offset, phase, band, sum)
        Derivative of photons and rest by the delay for one photon of each band, per ns.
    dark : ndarray of float, shape (offset, sum)
        Expected sums of one photon of the background.
    whiten : ndarray of float, shape (sum, sum)
        Matrix from the sums as they are to whitened ones.
    dark_test : ndarray of float, shape (sum - 1, sum)
        Matrix that makes the covariance of the whitened sums of one photon of the background the
        unit matrix; one dimension less, because the number of photons is known.
    covariances : ndarray of float, shape (phase, band + 1, entry)
        Covariance of photons and rest that one photon of each band and of the background adds, as
        `unpack_covariance` reads it.
    nulls : ndarray of float, shape (lag, rest, sum)
        Rows of `separate` that give the rest, at every `LAG_PHASES`-th delay.
    """

    first_ns: float
    phase_ns: float
    offsets: NDArray[np.intp]
    separate: Floats
    slopes: Floats
    dark: Floats
    whiten: Floats
    dark_test: Floats
    covariances: Floats
    nulls: Floats

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.slopes.shape[2]

    @property
    def sums(self) -> int:
        """Number of sums."""
        return self.dark.shape[1]

    @property
    def rest(self) -> int:
        """Number of sums that any light leaves at 0."""
        return self.nulls.shape[1]

    @property
    def phases(self) -> int:
        """Number of tabulated delays."""
        return self.slopes.shape[1]

    @property
    def last_ns(self) -> float:
        """Last tabulated delay."""
        return self.first_ns + self.phase_ns * (self.phases - 1)

    @property
    def lags(self) -> int:
        """Number of delays that the search looks at."""
        return len(self.nulls)

    def number_of(self, offsets: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the place of offsets in the tables.

        Parameters
        ----------
        offsets : ndarray of int
            Offsets that the tables are for.

        Returns
        -------
        ndarray of int
            Places in `offsets` of the tables.
        """
        if self.offsets.size == 1:
            return np.zeros(offsets.shape, np.intp)
        return np.searchsorted(self.offsets, offsets)

    def phase_of(self, delay_ns: Floats) -> NDArray[np.intp]:
        """Return the nearest tabulated delay of each delay.

        Parameters
        ----------
        delay_ns : ndarray of float
            Delays against the middle of the design.

        Returns
        -------
        ndarray of int
            Numbers of tabulated delays.
        """
        nearest = np.rint((delay_ns - self.first_ns) / self.phase_ns)
        return np.clip(nearest, 0, self.phases - 1).astype(np.intp)


_kept: WeakKeyDictionary[Calibration, dict[tuple[int, float, float, bytes], SumTables]] = (
    WeakKeyDictionary()
)


def sum_tables(
    calibration: Calibration, design: SumsDesign, offsets: NDArray[np.intp]
) -> SumTables:
    """Return the tables for some offsets; the last few are kept as long as the calibration lives.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    design : SumsDesign
        The tables of the reduction.
    offsets : ndarray of int
        Offsets of pixels, codes.

    Returns
    -------
    SumTables
        The tables.
    """
    low = int(offsets.min())
    each = low + np.flatnonzero(np.bincount(offsets.ravel() - low))  # faster than to sort them
    kept = _kept.setdefault(calibration, {})
    key = design.tables.hash, design.middle_ns, design.reach_ns, each.tobytes()
    if key not in kept:
        if len(kept) == TABLES_KEPT:
            del kept[next(iter(kept))]  # the first that was made
        kept[key] = _make(calibration, design, each)
    return kept[key]


def code_offsets(
    calibration: Calibration, delays_ns: NDArray[np.floating] | float = 0.0
) -> NDArray[np.intp]:
    """Return the offsets that move pixels along the tables of the reduction.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    delays_ns : ndarray of float, shape (row, col), or float
        Delay against the reference to which the middle of the tables is moved; the delay that
        belongs to each pixel is added. NaN counts as 0.

    Returns
    -------
    ndarray of int, shape (row, col)
        Offsets in codes.
    """
    moved_ns = np.nan_to_num(delays_ns) + calibration.pixel_delay_ns
    return _later(calibration) * np.rint(moved_ns / calibration.bin_width_ns).astype(np.intp)


def offset_delay_ns(calibration: Calibration, offsets: NDArray[np.intp]) -> Floats:
    """Return by how much later offsets let the tables begin.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    offsets : ndarray of int
        Offsets in codes.

    Returns
    -------
    ndarray of float
        Delays, ns.
    """
    return np.asarray(_later(calibration) * offsets * calibration.bin_width_ns, np.float64)


def _later(calibration: Calibration) -> int:
    """Sign of the offsets that let the tables begin later: codes rise or fall with time."""
    codes = calibration.bins.codes
    return 1 if codes[0] > codes[-1] else -1


def _make(calibration: Calibration, design: SumsDesign, offsets: NDArray[np.intp]) -> SumTables:
    low_ns = design.search_ns[0]
    lags = ceil((design.search_ns[1] - low_ns) / (PHASE_NS * LAG_PHASES)) + 1
    delays_ns = low_ns + PHASE_NS * np.arange((lags - 1) * LAG_PHASES + 1)
    bins, bands = calibration.bins, calibration.templates.bands
    widths = bins.widths_ns / bins.span_ns
    whiten = _whitening(calibration, design)
    # covariances only weigh: those without offset do for all pixels
    plain = design.tables.entries[:, bins.codes].astype(np.float64)
    entries = whiten @ plain
    shares = _by_delay(calibration.templates.shares, calibration, design.middle_ns + delays_ns)
    added, white = _covariances(entries, shares, widths, calibration.brightness)
    means = _means(entries, shares, widths)
    nulls = _nulls(means, white)
    shape = (offsets.size, delays_ns.size, bands, design.tables.sums)
    separate, slopes = np.empty((*shape[:2], shape[3], shape[3])), np.empty(shape)
    dark = np.empty((offsets.size, shape[3]))
    for number, offset in enumerate(offsets):
        moved = whiten @ design.tables.of_offset(int(offset))[:, bins.codes]
        at_ns = design.middle_ns + offset_delay_ns(calibration, offset) + delays_ns
        there = _by_delay(calibration.templates.shares, calibration, at_ns)
        change = _by_delay(calibration.templates.slopes, calibration, at_ns)
        separate[number] = _separation(_means(moved, there, widths), white, nulls)
        slopes[number] = change @ moved.T @ np.swapaxes(separate[number], 1, 2)
        dark[number] = moved @ widths
    separated = _separation(means, white, nulls)[:, None]
    separated = separated @ added @ np.swapaxes(separated, -1, -2)
    rest = plain[1:] - (plain[1:] @ widths)[:, None]
    return SumTables(
        first_ns=low_ns,
        phase_ns=PHASE_NS,
        offsets=offsets,
        separate=separate,
        slopes=slopes,
        dark=dark,
        whiten=whiten,
        dark_test=_whitener((rest * widths) @ rest.T) @ np.linalg.inv(whiten)[1:],
        covariances=_packed_covariance(separated, bands + 1),
        nulls=nulls[::LAG_PHASES],
    )


def _covariances(
    entries: Floats, shares: Floats, widths: Floats, brightness: Floats
) -> tuple[Floats, Floats]:
    """Covariance of sums that bands and background add (phase, band + 1, sum, sum), and of white.

    The latter, (phase, sum, sum), is that of one photon of a white surface.
    """
    light = np.concatenate([shares, np.broadcast_to(widths, (len(shares), 1, widths.size))], axis=1)
    added = np.stack([(entries * share[:, None]) @ entries.T for share in light])
    white = np.append(brightness / brightness.sum(), TYPICAL_BACKGROUND)
    return added, np.tensordot(white, added, (0, 1)) / white.sum()


def _by_delay(
    function: Callable[[Floats, Floats], Floats], calibration: Calibration, delays_ns: Floats
) -> Floats:
    """Shares of bins or their derivatives at delays, (phase, band, bin)."""
    return np.moveaxis(function(calibration.bins.edges_ns, delays_ns[:, None]), 0, 1)


def _means(entries: Floats, shares: Floats, widths: Floats) -> Floats:
    """Sums of one photon of each band and of the background, (phase, sum, band + 1)."""
    dark = np.broadcast_to(entries @ widths, (len(shares), 1, len(entries)))
    return np.swapaxes(np.concatenate([shares @ entries.T, dark], axis=1), 1, 2)


def _nulls(means: Floats, covariance: Floats) -> Floats:
    """Rows (phase, rest, sum) that make 0 of any light, with the unit matrix as covariance."""
    lower = np.linalg.cholesky(covariance)
    basis = np.linalg.qr(np.linalg.solve(lower, means), mode="complete").Q
    return np.swapaxes(basis[:, :, means.shape[2] :], 1, 2) @ np.linalg.inv(lower)


def _separation(means: Floats, covariance: Floats, nulls: Floats) -> Floats:
    """Matrices (phase, sum, sum) to photons, by weighted least squares, and to the rest.

    The rest is that of `nulls`, less what these rows make of the light where they were computed for
    another offset.
    """
    lower = np.linalg.cholesky(covariance)
    basis, triangle = np.linalg.qr(np.linalg.solve(lower, means))
    photons = np.linalg.solve(triangle, np.swapaxes(basis, 1, 2) @ np.linalg.inv(lower))
    return np.concatenate([photons, nulls - nulls @ means @ photons], axis=1)


def _packed_covariance(full: Floats, light: int) -> Floats:
    """Entries of covariances that the estimate needs, (…, entry), as `unpack_covariance` reads."""
    lower = light + np.array(np.tril_indices(full.shape[-1] - light))
    variance = np.diagonal(full, axis1=-2, axis2=-1)[..., :light]
    common = full[..., light:, :light].reshape(*full.shape[:-2], -1)
    return np.concatenate([variance, common, full[..., lower[0], lower[1]]], axis=-1)


def unpack_covariance(packed: Floats, light: int, rest: int) -> tuple[Floats, Floats, Floats]:
    """Return the parts of packed covariances of photons and rest.

    Parameters
    ----------
    packed : ndarray of float, shape (pixel, entry)
        Variances of the photons; rows of their covariances with the rest; rows of the lower
        triangle of the covariance of the rest.
    light, rest : int
        Number of bands with the background, and of the rest.

    Returns
    -------
    variance : ndarray of float, shape (pixel, light)
        Variances of the photons.
    common : ndarray of float, shape (pixel, rest, light)
        Covariances of rest and photons.
    own : ndarray of float, shape (pixel, rest, rest)
        Covariance of the rest.
    """
    variance, common, triangle = np.split(packed, [light, light + rest * light], axis=1)
    lower = np.tril_indices(rest)
    own = np.empty((len(packed), rest, rest))
    own[:, lower[0], lower[1]] = triangle
    own[:, lower[1], lower[0]] = triangle
    return variance, common.reshape(-1, rest, light), own


def _whitener(covariance: Floats) -> Floats:
    """Matrix that makes a covariance the unit matrix."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)


def _whitening(calibration: Calibration, design: SumsDesign) -> Floats:
    """Matrix that makes the covariance of one photon of a white surface the unit matrix."""
    bins = calibration.bins
    white = calibration.brightness / calibration.brightness.sum()
    mean = white @ calibration.templates.shares(bins.edges_ns, design.middle_ns)
    mean = mean + TYPICAL_BACKGROUND * bins.widths_ns / bins.span_ns
    entries = design.tables.entries[:, bins.codes].astype(np.float64)
    return _whitener((entries * mean) @ entries.T / (1 + TYPICAL_BACKGROUND))
