# SPDX-License-Identifier: Apache-2.0
"""Tables of the reduction, designed from a calibration.

The information that sums Σ_i h_i G_ki keep depends only on the functions of the code that their
tables span. The best estimate of a parameter near given values is such a sum, whose table is the
parameter's *efficient score*: the score of the parameter, freed of what the other parameters
explain, Σ_b [I⁻¹]_ab ∂_b μ_i / μ_i (Kay, Estimation Theory, 1993, ch. 3). The design collects the
efficient scores of delay and amplitudes over delays, backgrounds and colors that may occur, and
takes the principal components that keep most of their variance. The first table is 1 for each code,
so that the first sum is the number of photons, and every other table can be moved to positive
values without loss.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, log2

import numpy as np
from numpy.typing import NDArray

from hueflight.arguments import NUMBER, POSITIVE, RANGE, takes
from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.bounds import fisher_information
from hueflight.reconstruction.joint import search_range_ns
from hueflight.reconstruction.sums.coarse_tables import HEADROOM, Light, TableSearch
from hueflight_protocol.reduction import MOST_ENTRY_BITS, MOST_SUM_BITS, MOST_SUMS, ReductionTables

REACH_NS = 6.0  #: delays either way that tables are designed for
MARGIN_NS = 2.0  #: delays beyond that are still searched
STEP_NS = 1.0  #: between delays of the design
BACKGROUNDS = (0.1, 0.3, 1.0)  #: photons of background per photon of signal
DARK = 0.1  #: reflectance of the other bands where a third of the bands is bright
AMPLITUDE_WEIGHT = 1 / 3  #: of an amplitude's score against that of the delay
MORE_SUMS = 6  #: than bands
ENTRY_BITS = 8  #: of an entry of the tables
COARSE_DELAYS = np.array([-1.0, -0.5, -0.22, 0.02, 0.23, 0.52, 1.0])
"""Delays of the search for coarse tables, by how far tables reach: close where most depths are."""
COARSE_BACKGROUNDS = (0.1, 1.0)
TYPICAL_BACKGROUND = 0.3  #: photons per photon of signal in the scores that the search begins at
NEAR_NS, CLOSE_NS = 2.0, 0.5  #: delays over which scores are averaged, and for differences


@dataclass(frozen=True, eq=False)
class SumsDesign:
    """Tables, and the delays that they are for.

    Attributes
    ----------
    tables : ReductionTables
        Tables of the reduction.
    middle_ns : float
        Delay against the reference, in a pixel without offset, about which the tables tell most.
    reach_ns : float
        Delays either way that they are designed for.
    """

    tables: ReductionTables
    middle_ns: float = 0.0
    reach_ns: float = REACH_NS

    @property
    def search_ns(self) -> tuple[float, float]:
        """Least and greatest delay against the middle that is searched."""
        return -self.reach_ns - MARGIN_NS, self.reach_ns + MARGIN_NS


@takes(
    calibration=Calibration,
    sums=POSITIVE,
    entry_bits=POSITIVE,
    depth_range=RANGE,
    most_photons=NUMBER,
)
def design_sums(
    calibration: Calibration,
    /,
    *,
    sums: int | None = None,
    entry_bits: int = ENTRY_BITS,
    depth_range: tuple[float, float] | None = None,
    most_photons: float = 2000.0,
    most_widths: Sequence[int] | None = None,
) -> SumsDesign:
    """Design tables that keep as much information as so many sums can.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    sums : int, optional
        Sums per pixel: at least 3 more than there are bands, by default 6 more.
    entry_bits : int, optional
        Bits of a table entry.
    depth_range : tuple of float, optional
        Nearest and farthest depth, m, at most the spacing of two pulses apart; by default 6 ns
        either way of the reference.
    most_photons : float, optional
        Photons of a pixel and picture, of which no sum saturates; it decides their widths.
    most_widths : sequence of int, optional
        Bits that there is room for, of each sum. If sums would not fit, tables of smaller entries
        are searched for (see `coarse_tables`), which takes some seconds; a pixel must then never
        have more than `most_photons`.

    Returns
    -------
    SumsDesign
        The tables and the delays that they are for.

    Raises
    ------
    HueflightError
        If a number is out of range, or there are too few bits.
    """
    bands = calibration.templates.bands
    sums = min(bands + MORE_SUMS, MOST_SUMS) if sums is None else sums
    if not bands + 3 <= sums <= MOST_SUMS:
        raise HueflightError(
            f"sums = {sums}: must be from {bands + 3} to {MOST_SUMS} for {bands} bands"
        )
    if not 1 <= entry_bits <= MOST_ENTRY_BITS:
        raise HueflightError(f"entry_bits = {entry_bits}: must be from 1 to {MOST_ENTRY_BITS}")
    if not 1 <= most_photons <= 2**30:
        raise HueflightError(f"most_photons = {most_photons!r}: must be from 1 to {2**30}")
    middle_ns, reach_ns = _range_of(calibration, depth_range)
    rounded = _rounded(_principal_scores(calibration, middle_ns, reach_ns, sums), entry_bits)
    widths = _widths(rounded, calibration, middle_ns, reach_ns, most_photons)
    if most_widths is not None:
        if len(most_widths) != sums:
            raise HueflightError(f"most_widths = {most_widths!r}: must be {sums} numbers")
        if any(width > most for width, most in zip(widths, most_widths, strict=True)):
            rounded, widths = _coarse(
                calibration, middle_ns, reach_ns, entry_bits, most_photons, most_widths
            )
    codes = calibration.bins.codes
    entries = np.zeros((sums, 1 << calibration.instrument.sensor.code_bits), np.uint16)
    entries[:, codes] = rounded
    return SumsDesign(
        ReductionTables(
            entries,
            widths,
            int(codes.min()),
            int(codes.max()),
        ),
        middle_ns,
        reach_ns,
    )


def _range_of(
    calibration: Calibration, depth_range: tuple[float, float] | None
) -> tuple[float, float]:
    """Middle of the delays and how far they reach, ns."""
    if depth_range is None:
        return 0.0, REACH_NS
    low_ns, high_ns = search_range_ns(calibration, depth_range)
    reach_ns = (high_ns - low_ns) / 2
    most_ns = calibration.instrument.half_spacing_ns() - MARGIN_NS
    if reach_ns > most_ns:
        raise HueflightError(
            f"depth_range = {depth_range!r} spans {np.ptp(depth_range):.3g} m: sums tell depths "
            f"within {most_ns * SPEED_OF_LIGHT_M_PER_NS:.3g} m of each other; narrow it, or let "
            "offsets follow the depth"
        )
    return (low_ns + high_ns) / 2, reach_ns


def _colors(bands: int) -> list[NDArray[np.float64]]:
    """White, and surfaces that are bright in a third of the bands."""
    colors = [np.ones(bands)]
    for third in np.array_split(np.arange(bands), min(3, bands)):
        color = np.full(bands, DARK)
        color[third] = 1.0
        colors.append(color)
    return colors


def _all_conditions(
    calibration: Calibration, middle_ns: float, reach_ns: float
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Conditions at all delays and backgrounds of the design."""
    steps = max(1, ceil(reach_ns / STEP_NS))
    delays_ns = middle_ns + np.linspace(-reach_ns, reach_ns, 2 * steps + 1)
    return _conditions(calibration, delays_ns, BACKGROUNDS)


def _conditions(
    calibration: Calibration, delays_ns: NDArray[np.float64], backgrounds: Sequence[float]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Expected light of one photon (bin,), and derivatives by the parameters (parameter, bin)."""
    widths = calibration.bins.widths_ns / calibration.bins.span_ns
    for delay_ns in delays_ns:
        shares = calibration.templates.shares(calibration.bins.edges_ns, delay_ns)
        slopes = calibration.templates.slopes(calibration.bins.edges_ns, delay_ns)
        for color in _colors(len(shares)):
            signal = calibration.brightness * color
            signal = signal / signal.sum()
            for background in backgrounds:
                total = 1 + background
                mean = (signal @ shares + background * widths) / total
                yield mean, np.vstack([signal @ slopes, shares, widths]) / total


def _principal_scores(
    calibration: Calibration, middle_ns: float, reach_ns: float, sums: int
) -> NDArray[np.float64]:
    """Ones, and the principal components of the efficient scores, (sum, bin)."""
    widths = calibration.bins.widths_ns / calibration.bins.span_ns
    conditions = list(_all_conditions(calibration, middle_ns, reach_ns))
    # bins that nothing reaches count as the background does
    metric = np.maximum(np.mean([mean for mean, _ in conditions], axis=0), 1e-3 * widths)
    root = np.sqrt(metric)
    spread = np.zeros((root.size, root.size))
    for mean, derivatives in conditions:
        scores = derivatives / mean
        inverse = np.linalg.inv(scores @ derivatives.T)
        efficient = (inverse @ scores)[:-1] / np.sqrt(np.diag(inverse)[:-1, None])
        efficient[1:] *= AMPLITUDE_WEIGHT
        weighted = efficient * root
        spread += weighted.T @ weighted
    one = root / np.linalg.norm(root)
    spread -= np.outer(one, one @ spread)
    spread -= np.outer(spread @ one, one)
    _, vectors = np.linalg.eigh(spread)
    return np.vstack([np.ones(root.size), vectors[:, :-sums:-1].T / root])


def _rounded(rows: NDArray[np.float64], entry_bits: int) -> NDArray[np.uint16]:
    """Rows as whole numbers; all but the first are moved and scaled to the whole range."""
    low = rows.min(axis=1, keepdims=True)
    span = rows.max(axis=1, keepdims=True) - low
    span[0] = 1.0
    low[0] = 0.0
    most = np.full((len(rows), 1), (1 << entry_bits) - 1.0)
    most[0] = 1.0
    return np.rint((rows - low) / span * most).astype(np.uint16)


def _coarse(
    calibration: Calibration,
    middle_ns: float,
    reach_ns: float,
    entry_bits: int,
    photons: float,
    widths: Sequence[int],
) -> tuple[NDArray[np.uint16], tuple[int, ...]]:
    """Tables whose sums fit their widths, and the bits that they need."""
    sums = len(widths)
    if photons + 2 > 1 << widths[0]:
        raise HueflightError(
            f"most_widths = {widths!r}: the first must be at least {ceil(log2(photons + 2))} bits, "
            f"to count {photons:g} photons"
        )
    chosen = _conditions(calibration, middle_ns + reach_ns * COARSE_DELAYS, COARSE_BACKGROUNDS)
    means, derivatives = (np.array(each) for each in zip(*chosen, strict=True))
    delays_ns = middle_ns + np.linspace(-reach_ns, reach_ns, COARSE_DELAYS.size)
    bright = _conditions(calibration, delays_ns, COARSE_BACKGROUNDS)
    greatest = np.array([mean for mean, _ in bright])
    light = Light(means, derivatives, greatest)
    search = TableSearch(light, photons, widths, (1 << entry_bits) - 1)
    entries = search.run(_local_scores(calibration, middle_ns, sums))
    return entries, tuple(
        min(width, max(1, ceil(log2(value + 2))))
        for width, value in zip(widths, search.greatest_sums(entries * 1.0), strict=True)
    )


def _local_scores(calibration: Calibration, middle_ns: float, sums: int) -> NDArray[np.float64]:
    """Ones, scores of the delay, and those of each band, which are 0 but for its light.

    There are two or more of the delay: the first derivative, for groups of bands if there are more,
    and the second one.
    """
    bins, white = calibration.bins, calibration.brightness / calibration.brightness.sum()

    def light(delay_ns: float) -> NDArray[np.float64]:
        return calibration.templates.shares(bins.edges_ns, middle_ns + delay_ns)

    dark = TYPICAL_BACKGROUND * bins.widths_ns / bins.span_ns
    shares = light(0.0)
    slopes = calibration.templates.slopes(bins.edges_ns, middle_ns)
    mean = white @ shares + dark
    groups = np.array_split(np.arange(len(shares)), max(1, sums - len(shares) - 2))
    first = [white[group] @ slopes[group] / mean for group in groups]
    second = white @ (light(CLOSE_NS) + light(-CLOSE_NS) - 2 * shares) / mean
    near = [light(delay_ns) for delay_ns in np.linspace(-NEAR_NS, NEAR_NS, 5)]
    bands = sum(each / (white @ each + dark) for each in near)
    rows = np.vstack([*first, second, bands])
    return np.vstack([np.ones_like(mean), rows - rows.min(axis=1, keepdims=True)])


def _widths(
    rounded: NDArray[np.uint16],
    calibration: Calibration,
    middle_ns: float,
    reach_ns: float,
    most_photons: float,
) -> tuple[int, ...]:
    """Bits that hold each sum of so many photons under every condition."""
    entries = rounded.astype(np.float64)
    most = np.zeros(len(entries))
    for mean, _ in _all_conditions(calibration, middle_ns, reach_ns):
        sum_mean = most_photons * entries @ mean
        most = np.maximum(most, sum_mean + HEADROOM * np.sqrt(most_photons * entries**2 @ mean))
    return tuple(min(MOST_SUM_BITS, ceil(log2(value + 2))) for value in most)


def link_bytes(design: SumsDesign, pixels: int, /) -> int:
    """Return the bytes that the sums of one picture take, without headers of packets.

    Parameters
    ----------
    design : SumsDesign
        The design.
    pixels : int
        Pixels of a picture.

    Returns
    -------
    int
        Bytes.
    """
    return ceil(pixels * sum(design.tables.widths) / 8)


def information_kept(
    design: SumsDesign,
    calibration: Calibration,
    /,
    *,
    photons: float,
    background: float,
    reflectance: NDArray[np.float64] | None = None,
    delay_ns: float = 0.0,
) -> NDArray[np.float64]:
    """Return the bound of each parameter from the sums, divided by that from the histogram.

    Parameters
    ----------
    design : SumsDesign
        The design.
    calibration : Calibration
        Calibration of the same instrument.
    photons, background : float
        Expected photons of all bands, and of the background.
    reflectance : ndarray of float, shape (band,), optional
        Relative reflectance; by default white.
    delay_ns : float, optional
        Delay against the middle of the design.

    Returns
    -------
    ndarray of float, shape (band + 1,)
        Ratios of standard deviations: of the delay, and of the amplitude of each band.
    """
    shares = calibration.templates.shares(calibration.bins.edges_ns, design.middle_ns + delay_ns)
    slopes = calibration.templates.slopes(calibration.bins.edges_ns, design.middle_ns + delay_ns)
    widths = calibration.bins.widths_ns / calibration.bins.span_ns
    signal = calibration.brightness * (1.0 if reflectance is None else reflectance)
    signal = signal * photons / signal.sum()
    mean = signal @ shares + background * widths
    entries = design.tables.entries[:, calibration.bins.codes].astype(np.float64)
    derivatives = np.vstack([signal @ slopes, shares, widths])
    means = entries @ derivatives.T
    kept = means.T @ np.linalg.solve((entries * mean) @ entries.T, means)
    whole = fisher_information(shares, slopes, widths, signal, background)
    ratio = np.diag(np.linalg.inv(kept)) / np.diag(np.linalg.inv(whole))
    return np.sqrt(np.maximum(ratio[:-1], 0.0))
