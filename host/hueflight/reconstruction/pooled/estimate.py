# SPDX-License-Identifier: Apache-2.0
"""Images from a few photons per pixel: neighbors contribute photons where a pixel has too few.

1. *Pilot*: the delay of each pixel from the likelihood of a white pulse train over a square that
   holds enough photons; then over neighbors of the same color, so that depth steps are not blurred.
2. *Pooling*: in circles that grow from round to round, a pixel collects the photons of neighbors
   that its pool so far does not contradict, in brightness and color or in depth. A pool is closed
   as soon as it holds enough. Pools that lack photons take their depth from a wider circle,
   compared by all depths found.
3. *Estimate*: delay by one step of scoring over the pool, amplitudes from its photons in the
windows
   of the bands. A pixel that has enough photons of its own gets the joint fit.

Every pixel reports how many pixels its estimate rests on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.reconstruction import joint
from hueflight.reconstruction.conversion_rules import BLIND, LIMIT_NS
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.options import EstimatorOptions
from hueflight.reconstruction.pooled.adaptive_weights import (
    LIMITS,
    TINY,
    Pools,
    first_pools,
    grown,
    likeness,
    unmixed_of,
    windows_of,
)
from hueflight.reconstruction.pooled.detection import without_return
from hueflight.reconstruction.pooled.empty_edges import settled
from hueflight.reconstruction.pooled.kernels import (
    Floats,
    Photons,
    in_parts,
    lag_likelihood,
    list_photons,
    pool,
)
from hueflight.reconstruction.pooled.pool_check import OwnPhotons, pulled, refuted
from hueflight.reconstruction.pooled.tables import Tables, tables_for
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import relative_range, widened

LAG_PER_FWHM = 0.28  #: between delays of the pilot, in pulses of the shortest band
PILOT_PHOTONS = 300.0  #: in the square of the pilot
PILOT_REACHES = (1, 2, 3, 4, 6, 9, 13)  #: squares of 2·reach + 1 pixels
SIGHT_PHOTONS = 150.0  #: that neighbors of the same color must hold to be better
SIGHT_RADII = (3.0, 6.0)  #: of the rounds by color alone, in pixels
FINE_REACH = 2  #: squares of the pilot no wider than this blur no more than such neighbors
ENOUGH = 1000.0  #: photons that a pool is closed with

#: options that change the result and that the method takes into account
honors = joint.honors - {"background", "mixed"}


def estimate(
    prepared: PreparedHistogram,
    calibration: Calibration,
    options: EstimatorOptions,
    /,
    *,
    enough: float = ENOUGH,
) -> Estimates:
    """Estimate depth and reflectance of every pixel with the help of its neighbors.

    Parameters
    ----------
    prepared : PreparedHistogram
        The histogram, checked and in time order.
    calibration : Calibration
        Calibration of the same instrument.
    options : EstimatorOptions
        What was asked for.
    enough : float
        Photons that suffice: a pixel that has them is estimated alone.

    Returns
    -------
    Estimates
        Results of all pixels.

    Raises
    ------
    HueflightError
        If the instrument has no period, or `enough` is not above 0.
    """
    if not enough > 0:
        raise HueflightError(f"enough = {enough!r}: must be above 0 photons")
    counts, threads = prepared.counts, options.threads
    search_ns = joint.search_range_ns(calibration, options.depth_range)
    tables = tables_for(calibration, search_ns)
    seen = photons_of(counts, calibration, tables, threads=threads)
    shape = counts.shape[:2]
    own = seen.sums(seen.weights).reshape(shape)
    sight = _sight(seen, shape, tables, search_ns, threads)
    reach = _pilot_reach(own)

    def over_squares(stretch: tuple[int, int]) -> NDArray[np.float64]:
        return _square_sums(_corner_sums(sight.likelihood[..., slice(*stretch)]), reach)

    squares = in_parts(over_squares, sight.lags_ns.size, threads, threads)
    pilot = sight.delays(np.concatenate(squares, axis=-1))
    coarse = reach > FINE_REACH
    if coarse.any():
        sharp = _sharpened(seen, pilot, sight, coarse, calibration.usable, tables, threads)
        pilot = np.where(coarse, sharp, pilot)
    pools = grown(seen, pilot, calibration.usable, tables, search_ns, enough, threads)
    usable = calibration.usable
    absent = without_return(seen, pools, reach, tables, search_ns, threads)
    absent = settled(seen, pools, absent, usable, tables)
    pools, doubt = pulled(seen, pools, usable, usable & ~absent, tables, search_ns, threads)
    pools, contradicted = refuted(pools, sight, tables, search_ns)
    pooled = _in_metres(
        pools,
        np.where(contradicted, 0, doubt),
        {
            Quality.NO_RETURN: absent & ~contradicted,
            Quality.CONTRADICTED: contradicted,
        },
        own,
        prepared.exposures,
        calibration,
        tables,
        search_ns=search_ns,
        range_correction=options.range_correction,
        pileup_correction=options.pileup_correction,
    )
    sufficient = calibration.usable & (own >= enough)
    if not sufficient.any():
        return pooled
    alone = joint.estimate(prepared, calibration, replace(options, region=sufficient))
    merged = {
        field.name: np.where(sufficient, getattr(alone, field.name), getattr(pooled, field.name))
        for field in fields(Estimates)
        if getattr(alone, field.name) is not None and getattr(pooled, field.name) is not None
    }
    resolution = pooled.resolution
    assert resolution is not None
    return replace(pooled, **merged, resolution=np.where(sufficient, 1.0, resolution))


def photons_of(
    counts: NDArray[np.generic], calibration: Calibration, tables: Tables, *, threads: int = 1
) -> Photons:
    """List the photons of all usable pixels; the others have none.

    Parameters
    ----------
    counts : ndarray, shape (row, col, code)
        Counts, raw codes on the last axis.
    calibration : Calibration
        Calibration of the same instrument.
    tables : Tables
        Waveforms of the instrument.
    threads : int
        Threads that share the pixels.

    Returns
    -------
    Photons
        Arrival times.
    """
    bins = calibration.bins
    times_ns = np.full(counts.shape[-1], -1.0, np.float32)
    times_ns[bins.codes] = bins.centers_ns
    offsets_ns = np.where(calibration.usable, calibration.pixel_delay_ns, 0).astype(np.float32)
    flat = counts.reshape(-1, counts.shape[-1])
    offsets_ns = offsets_ns.ravel()

    def listed(stretch: tuple[int, int]) -> Photons:
        part = slice(*stretch)
        return list_photons(flat[part], times_ns, offsets_ns[part], tables.period_ns)

    seen = Photons.joined(in_parts(listed, len(flat), threads, threads))
    unusable = ~calibration.usable.ravel()
    if unusable.any():
        seen.weights[unusable[seen.owners]] = 0
    return seen


# -- pilot ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Sight(OwnPhotons):
    """Likelihood of each pixel's own photons, for estimates over neighbors."""

    def delays(self, sums: NDArray[np.floating]) -> Floats:
        """Delay (row, col) of the highest of sums (row, col, lag), freed of strays."""
        spacing_ns = self.lags_ns[1] - self.lags_ns[0]
        delays = self.lags_ns[0] + _peak(sums) * spacing_ns
        return _median_of_nine(delays.astype(np.float32))


def _sight(
    seen: Photons,
    shape: tuple[int, ...],
    tables: Tables,
    search_ns: tuple[float, float],
    threads: int,
) -> _Sight:
    """Likelihood of delays over the search, each pixel for itself."""
    background = 0.1
    if tables.quiet.mean() > 0.05:
        cell = np.floor(seen.times_ns * np.float32(tables.cells_per_ns)).astype(np.intp)
        dark = seen.weights[tables.quiet[cell % tables.quiet.size]].sum() / tables.quiet.mean()
        background = float(np.clip(dark / max(seen.weights.sum(), 1), 0.02, 0.9))
    model = (tables.shares @ tables.white) * (1 - background) + background / tables.period_ns
    table = np.log(model * tables.period_ns).astype(np.float32)
    stride = max(1, round(LAG_PER_FWHM * tables.fwhm_ns * tables.cells_per_ns))
    first, last = (bound * tables.cells_per_ns / stride for bound in search_ns)
    lags = (np.arange(np.floor(first), np.ceil(last) + 1) * stride).astype(np.int32)

    def seen_from(stretch: tuple[int, int]) -> Floats:
        return lag_likelihood(seen.part(stretch), table, tables.cells_per_ns, lags)

    likelihood = np.concatenate(in_parts(seen_from, seen.pixels, threads, threads))
    return _Sight(likelihood.reshape(*shape, lags.size), lags / tables.cells_per_ns)


def _pilot_reach(own: Floats) -> NDArray[np.intp]:
    """Reach (row, col) of the least square that holds enough photons."""
    photons = _corner_sums(own[..., None])
    reach = np.full(own.shape, PILOT_REACHES[-1])
    for tried in reversed(PILOT_REACHES):
        reach[_square_sums(photons, tried)[..., 0] >= PILOT_PHOTONS] = tried
    return reach


def _sharpened(
    seen: Photons,
    pilot: Floats,
    sight: _Sight,
    active: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    tables: Tables,
    threads: int,
) -> Floats:
    """Delay (row, col) of active pixels over neighbors of the same color, not over squares."""
    windows = windows_of(seen, pilot, tables)
    pools = first_pools(windows, pilot, np.zeros_like(pilot), usable, threads)
    planes = np.concatenate(
        [np.moveaxis(sight.likelihood, -1, 0), windows.sum(axis=0, keepdims=True)]
    )
    *earlier, widest = SIGHT_RADII
    for radius in earlier:
        like = likeness(pools, windows, usable, tables)
        found = pool(windows, len(windows), usable, active, like, radius, LIMITS, threads=threads)
        pools = replace(
            pools,
            windows=np.where(active, found.sums / np.maximum(found.weight, TINY), pools.windows),
            pixels=np.where(
                active, found.weight**2 / np.maximum(found.squares, TINY), pools.pixels
            ),
        )
    like = likeness(pools, windows, usable, tables)
    found = pool(planes, 0, usable, active, like, widest, LIMITS, threads=threads)
    sharp = sight.delays(np.moveaxis(found.sums[:-1], 0, -1))
    return np.where(found.sums[-1] >= SIGHT_PHOTONS, sharp, pilot)


def _median_of_nine(values: Floats) -> Floats:
    """Median (row, col) of squares of three, as scipy.ndimage.median_filter, many times faster.

    Of three columns sorted each: the median of the highest low, the middle middle and the lowest
    high.
    """
    edged = np.pad(values, 1, mode="edge")
    columns = _sorted(edged[:-2], edged[1:-1], edged[2:])
    low, middle, high = ((part[:, :-2], part[:, 1:-1], part[:, 2:]) for part in columns)
    least = np.maximum(np.maximum(*low[:2]), low[2])
    most = np.minimum(np.minimum(*high[:2]), high[2])
    return _sorted(least, _sorted(*middle)[1], most)[1]


def _sorted(a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats, Floats]:
    """Three arrays, at every place in order."""
    a, b = np.minimum(a, b), np.maximum(a, b)
    b, c = np.minimum(b, c), np.maximum(b, c)
    return np.minimum(a, b), np.maximum(a, b), c


def _peak(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Place (…) of the highest value along the last axis, by a parabola through three."""
    count = values.shape[-1]
    best = values.argmax(axis=-1)
    inner = np.clip(best, 1, count - 2)[..., None]
    left, here, right = (
        np.take_along_axis(values, inner + step, axis=-1)[..., 0] for step in (-1, 0, 1)
    )
    bend = left - 2 * here + right
    shift = np.divide(left - right, 2 * bend, out=np.zeros_like(bend), where=bend < 0)
    return inner[..., 0] + np.clip(shift, -1, 1)


def _corner_sums(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Sums (row + 1, col + 1, …) of all values above and to the left."""
    corners = np.zeros((values.shape[0] + 1, values.shape[1] + 1, values.shape[2]))
    np.cumsum(values, axis=0, out=corners[1:, 1:])
    np.cumsum(corners[1:, 1:], axis=1, out=corners[1:, 1:])
    return corners


def _square_sums(
    corners: NDArray[np.float64], reach: NDArray[np.intp] | int
) -> NDArray[np.float64]:
    """Sums (row, col, …) over squares of each pixel's own size."""
    rows, cols = corners.shape[0] - 1, corners.shape[1] - 1
    row, col = np.arange(rows)[:, None], np.arange(cols)
    top, bottom = np.maximum(row - reach, 0), np.minimum(row + reach + 1, rows)
    left, right = np.maximum(col - reach, 0), np.minimum(col + reach + 1, cols)
    flat = corners.reshape(-1, corners.shape[-1])
    sums = flat.take(bottom * (cols + 1) + right, axis=0)
    sums -= flat.take(top * (cols + 1) + right, axis=0)
    sums -= flat.take(bottom * (cols + 1) + left, axis=0)
    sums += flat.take(top * (cols + 1) + left, axis=0)
    return sums


# -- image ------------------------------------------------------------------------------------


def _in_metres(
    pools: Pools,
    doubt: Floats,
    flags: Mapping[Quality, NDArray[np.bool_]],
    own: Floats,
    frames: NDArray[np.float64] | None,
    calibration: Calibration,
    tables: Tables,
    *,
    search_ns: tuple[float, float],
    range_correction: bool,
    pileup_correction: bool,
) -> Estimates:
    along_axis = calibration.meters_per_ns
    depth = calibration.distance + pools.delays_ns * along_axis
    deviation_ns = np.sqrt(pools.variances)
    known_ns = calibration.pixel_delay_std_ns / np.sqrt(np.maximum(pools.depth_pixels, 1))
    depth_std = np.sqrt(pools.variances + doubt + known_ns**2) * along_axis
    unmixed = unmixed_of(pools.windows, tables.unmixing)
    variance = unmixed_of(pools.windows, tables.unmixing**2) / np.maximum(pools.pixels, 1e-12)
    photons = pools.windows.sum(axis=0).astype(np.float64)
    scale = calibration.photon_scale(photons, frames, pileup_correction=pileup_correction)
    if range_correction:
        scale = scale * relative_range(depth, calibration) ** 2
    gain = scale / calibration.brightness[:, None, None]
    reflectance, reflectance_std = gain * unmixed[:-1], gain * np.sqrt(variance[:-1])
    if range_correction:
        reflectance_std = widened(reflectance_std, reflectance, depth, depth_std)

    quality = np.zeros(own.shape, np.uint16)
    quality[calibration.dead] |= int(Quality.DEAD)
    quality[calibration.hot] |= int(Quality.HOT)
    blind_ns = BLIND * (search_ns[1] - search_ns[0]) / np.sqrt(12)
    low_ns, high_ns = search_ns[0] + LIMIT_NS, search_ns[1] - LIMIT_NS
    outside = (pools.delays_ns <= low_ns) | (pools.delays_ns >= high_ns)
    # a reference at the distance 0 does not tell where the camera is
    outside |= (calibration.distance > 0) & (depth <= 0)
    low_signal = ~(deviation_ns < blind_ns)
    outside &= ~flags[Quality.NO_RETURN]
    flags = {Quality.LOW_SIGNAL: low_signal, Quality.OUT_OF_RANGE: outside, **flags}
    for flag, flagged in flags.items():
        quality[calibration.usable & flagged] |= int(flag)
    unknown = (quality & ~np.uint16(Quality.CONTRADICTED)) != 0
    background = unmixed[-1] * calibration.bin_width_ns / calibration.bins.span_ns
    resolution = np.sqrt(pools.depth_pixels).astype(np.float64)
    background[~calibration.usable | (photons == 0)] = np.nan
    for values in (depth, depth_std, resolution, *reflectance, *reflectance_std):
        values[unknown] = np.nan
    return Estimates(
        depth=depth,
        depth_std=depth_std,
        reflectance=reflectance,
        reflectance_std=reflectance_std,
        background=background,
        photons=own.astype(np.float64),
        quality=quality,
        resolution=resolution,
    )
