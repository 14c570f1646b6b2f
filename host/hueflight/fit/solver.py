# SPDX-License-Identifier: Apache-2.0
"""The joint fit behind one function, compiled where possible: arguments are checked here.

The compiled kernel is used where it was built and has room for the bands; see `hueflight.backend`.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight import backend
from hueflight.backend.fit import (
    CHANGE_REFERENCE,
    CHANGE_SIGNIFICANCE,
    FIT,
    MOST_BANDS,
    REFERENCE_MULTIPLE,
    SUMS,
)
from hueflight.errors import HueflightError, KernelError
from hueflight.fit import assessment, change_detection
from hueflight.fit import reference as definition
from hueflight.fit.packing import PackedDelays, PackedSearch, PackedTables, pack, rules, sizes
from hueflight.fit.reference import DEFAULT, Fit, FitOptions, no_fit
from hueflight.fit.tables import ModelTables
from hueflight.model.pileup import NEGLIGIBLE, coates_correction

TILE_PIXELS = 2048  #: pixels that the NumPy definition takes at a time

COUNT_TYPES = (np.uint16, np.uint32, np.float32)  #: that the compiled kernel reads

#: tables as the kernel reads them
_packed: WeakKeyDictionary[ModelTables, PackedTables] = WeakKeyDictionary()


class _Kernel(Protocol):
    def fit(self, *buffers: NDArray[Any]) -> None: ...

    def change_reference(self, *buffers: NDArray[Any]) -> None: ...

    def change_significance(self, *buffers: NDArray[Any]) -> None: ...

    def sums(self, *buffers: NDArray[Any]) -> None: ...

    def correlations(self, *buffers: NDArray[Any]) -> None: ...


def compiled_kernel(bands: int = 1) -> _Kernel | None:
    """Return the compiled fit to use, or None for the NumPy definition.

    Parameters
    ----------
    bands : int
        Number of bands that are fitted together.

    Returns
    -------
    module or None
        See `hueflight.backend.compiled`.

    Raises
    ------
    KernelError
        If the compiled fit was asked for and is not there, or has no room for so many bands.
    """
    if bands > MOST_BANDS:
        if backend.requested() == "c":
            raise KernelError(
                f"HUEFLIGHT_KERNELS = 'c', but the compiled fit has room for {MOST_BANDS} bands "
                f"and there are {bands}: leave the choice open, so that the NumPy definition runs"
            )
        return None
    return cast("_Kernel | None", backend.compiled("fit"))


def fit_pixels(
    light: NDArray[Any],
    offsets_ns: NDArray[np.float64],
    tables: ModelTables,
    options: FitOptions = DEFAULT,
    *,
    pixels: NDArray[np.int64] | None = None,
    per_period: NDArray[np.float64] | None = None,
    threads: int = 1,
) -> Fit:
    """Fit pixels with the compiled kernel or its NumPy definition; see `reference.fit`.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order.
    offsets_ns : ndarray of float, shape (fitted,)
        Delay of each pixel that is fitted.
    tables : ModelTables
        Tables of the fit.
    options : FitOptions
        Steps that may be left out.
    pixels : ndarray of int64, shape (fitted,), optional
        Rows of `light` to fit; by default all.
    per_period : ndarray of float, shape (fitted,), optional
        Photons per period. A sensor that keeps the first photon of an exposure hides some of them,
        which is undone before the fit; see `pileup.coates_correction`.
    threads : int
        Threads that share the pixels, tile by tile; the result does not depend on it.

    Returns
    -------
    Fit
        Result for each pixel that is fitted.

    Raises
    ------
    HueflightError
        If the arrays do not fit the tables.
    """
    bins = sum(view.bins.count for view in tables.views)
    which = np.arange(len(light)) if pixels is None else np.ascontiguousarray(pixels, np.int64)
    if light.ndim != 2 or light.shape[1] != bins or offsets_ns.shape != which.shape:
        raise HueflightError(
            f"light has shape {light.shape} and offsets {offsets_ns.shape}: the tables needs "
            f"(pixel, {bins}) and ({which.size},)"
        )
    if per_period is not None and float(np.max(per_period, initial=0.0)) < NEGLIGIBLE:
        per_period = None
    kernel = compiled_kernel(tables.bands)
    if kernel is not None and light.dtype not in COUNT_TYPES:
        light = light.astype(np.float32)

    found = no_fit(which.size, tables.bands)

    def fit_tile(tile: slice) -> None:
        rates = None if per_period is None else per_period[tile]
        into = found.take(tile)  # a view
        if kernel is not None:
            _fit_compiled(
                kernel, light, which[tile], offsets_ns[tile], rates, tables, options, into
            )
            return
        seen = light if pixels is None and len(which) <= TILE_PIXELS else light[which[tile]]
        found.put(
            tile, definition.fit(coates_correction(seen, rates), offsets_ns[tile], tables, options)
        )

    # the compiled fit divides its pixels itself: each thread calls it once
    size = TILE_PIXELS if kernel is None else -(-max(len(which), 1) // max(threads, 1))
    tiles = [slice(start, start + size) for start in range(0, max(len(which), 1), size)]
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(fit_tile, tiles))
    else:
        for tile in tiles:
            fit_tile(tile)
    if per_period is not None:
        leave_unassessed(found, per_period)
    return found


def leave_unassessed(found: Fit, per_period: NDArray[np.float64]) -> None:
    """Remove the test results of pixels whose corrected counts scatter more than Poisson counts.

    Parameters
    ----------
    found : Fit
        Fit, which is changed.
    per_period : ndarray of float, shape (pixel,)
        Photons per period.
    """
    corrected = per_period > assessment.LARGEST_LOSS
    found.chi_square[corrected] = found.misfit[corrected] = np.nan


def photon_sums(light: NDArray[Any]) -> NDArray[np.float64]:
    """Return the counts of each pixel.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Sums over bins.
    """
    return survey(light)[0]


def survey(
    counts: NDArray[Any], lit: slice = slice(None)
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Count the photons of each pixel in one pass, and look for full counters.

    Parameters
    ----------
    counts : ndarray, shape (pixel, code)
        Counts.
    lit : slice
        Codes of photons.

    Returns
    -------
    sums : ndarray of float, shape (pixel,)
        Counts of all codes.
    inside : ndarray of float, shape (pixel,)
        Counts of the codes in `lit`.
    full : ndarray of bool, shape (pixel,)
        True where a counter is at the end of its integer type.
    """
    kernel = compiled_kernel()
    if kernel is None or counts.dtype not in COUNT_TYPES:
        full = np.zeros(len(counts), bool)
        if counts.dtype.kind in "ui":
            full = (counts == np.iinfo(counts.dtype).max).any(axis=-1)
        sums = counts.sum(axis=-1, dtype=np.float64)
        return sums, counts[:, lit].sum(axis=-1, dtype=np.float64), full
    sums, inside = np.empty((2, len(counts)))
    full = np.empty(len(counts), np.uint8)
    span = np.array(lit.indices(counts.shape[1])[:2], np.int64)
    pixels = np.arange(len(counts), dtype=np.int64)
    kernel.sums(
        *SUMS.arguments(counts=counts, pixels=pixels, span=span, all=sums, inside=inside, full=full)
    )
    return sums, inside, full.astype(bool)


def change_reference(
    light: NDArray[Any],
    pixels: NDArray[np.int64],
    found: Fit,
    offsets_ns: NDArray[np.float64],
    tables: ModelTables,
) -> NDArray[np.float32]:
    """Return what later counts are compared with; see `change_detection.change_reference`.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts behind `found`.
    pixels : ndarray of int64, shape (fitted,)
        Rows of `light` that `found` is the fit of.
    found : Fit
        Their fit.
    offsets_ns : ndarray of float, shape (fitted,)
        Delay that belongs to the pixel itself.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray of float32, shape (fitted, 2, room)
        Counts and derivatives.
    """
    kernel = compiled_kernel(tables.bands)
    if kernel is None or light.dtype not in COUNT_TYPES:
        return change_detection.change_reference(light[pixels], found, offsets_ns, tables)
    packed = _packed_for(tables)
    room = -(-tables.search.starts.size // REFERENCE_MULTIPLE) * REFERENCE_MULTIPLE
    memory = np.empty((len(pixels), 2, room), np.float32)
    kernel.change_reference(
        *CHANGE_REFERENCE.arguments(
            counts=light,
            pixels=np.ascontiguousarray(pixels, np.int64),
            **_table_buffers(tables, packed, DEFAULT),
            delays=(found.delay_ns + offsets_ns).astype(np.float32),
            amplitudes=np.ascontiguousarray(found.amplitudes, np.float32),
            background=found.background.astype(np.float32),
            reference=memory,
        )
    )
    return memory


def change_significance(
    now: NDArray[Any],
    memory: NDArray[np.float32],
    pixels: NDArray[np.int64],
    scales: NDArray[np.float64],
    delays_ns: NDArray[np.float64],
    tables: ModelTables,
) -> NDArray[np.float64]:
    """Return how much pixels have changed; see `change_detection.change_significance`.

    Parameters
    ----------
    now : ndarray, shape (pixel, bin)
        New counts of all pixels.
    memory : ndarray of float32, shape (pixel, 2, room)
        What `change_reference` gave for all pixels.
    pixels : ndarray of int64, shape (chosen,)
        Pixels to compare.
    scales : ndarray of float, shape (chosen,)
        Exposures now per exposure then.
    delays_ns : ndarray of float, shape (chosen,)
        Delays that were found, including those of the pixels themselves.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray of float, shape (chosen,)
        Greatest difference in standard deviations.
    """
    kernel = compiled_kernel(tables.bands)
    if kernel is None or now.dtype not in COUNT_TYPES:
        return change_detection.change_significance(
            now[pixels], memory[pixels], scales, delays_ns, tables
        )
    packed = _packed_for(tables)
    result = np.empty(len(pixels), np.float32)
    kernel.change_significance(
        *CHANGE_SIGNIFICANCE.arguments(
            counts=now,
            pixels=np.ascontiguousarray(pixels, np.int64),
            **_table_buffers(tables, packed, DEFAULT),
            delays=delays_ns.astype(np.float32),
            scales=scales.astype(np.float32),
            reference=memory,
            significance=result,
        )
    )
    return result.astype(np.float64)


def _packed_for(tables: ModelTables) -> PackedTables:
    if tables not in _packed:
        _packed[tables] = pack(tables)
    return _packed[tables]


def _fit_compiled(
    kernel: _Kernel,
    light: NDArray[Any],
    pixels: NDArray[np.int64],
    offsets_ns: NDArray[np.float64],
    per_period: NDArray[np.float64] | None,
    tables: ModelTables,
    options: FitOptions,
    into: Fit,
) -> None:
    packed = _packed_for(tables)
    rates = np.empty(0) if per_period is None else per_period
    kernel.fit(
        *FIT.arguments(
            counts=light,
            pixels=pixels,
            **_table_buffers(tables, packed, options),
            offsets=offsets_ns.astype(np.float32),
            rates=rates.astype(np.float32),
            **_assessment_buffers(tables),
            **into.arrays(),
        )
    )


def _table_buffers(
    tables: ModelTables, packed: PackedTables, options: FitOptions
) -> dict[str, NDArray[Any]]:
    return {
        "sizes": sizes(tables, packed),
        "rules": rules(tables, options),
        "view_bins": np.array([view.bins.count for view in tables.views], np.int32),
        **_buffers("fine", packed.fine),
        **_buffers("wide", packed.wide),
        **_buffers("search", packed.search),
    }


def _assessment_buffers(tables: ModelTables) -> dict[str, NDArray[Any]]:
    _, means, variances = assessment.deviance_table()
    return {
        "contrasts": np.ascontiguousarray(tables.contrasts, np.float32),
        "curvatures": assessment.curvature_ratios(tables.wide).astype(np.float32),
        "moments": np.stack([means, variances], axis=1).astype(np.float32),
    }


def _buffers(prefix: str, tables: PackedDelays | PackedSearch) -> dict[str, NDArray[Any]]:
    return {f"{prefix}_{name}": array for name, array in tables.arrays().items()}
