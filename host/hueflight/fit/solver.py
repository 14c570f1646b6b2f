# SPDX-License-Identifier: Apache-2.0
"""The joint fit behind one function, compiled where possible: arguments are checked here.

The compiled kernel is used where it was built and has room for the bands; see `hueflight.backend`.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from hueflight import backend
from hueflight.backend.fit import (
    CHANGE_REFERENCE,
    CHANGES,
    FIT,
    MOST_BANDS,
    SUMS,
)
from hueflight.errors import HueflightError, KernelError
from hueflight.fit import assessment, change_detection
from hueflight.fit import reference as definition
from hueflight.fit.change_detection import ChangeReference, no_reference
from hueflight.fit.kernel_arguments import assessment_arguments, table_arguments
from hueflight.fit.reference import DEFAULT, Fit, FitOptions, no_fit
from hueflight.fit.tables import ModelTables
from hueflight.model.pileup import NEGLIGIBLE, coates_correction

TILE_PIXELS = 2048  #: pixels that the NumPy definition takes at a time

#: pixels of a thread, at least: fewer rarely share a tabulated delay and leave lanes empty
LEAST_PER_THREAD = 2048

#: bytes of a block whose release makes the C library keep memory for the next picture
KEPT_BYTES = 1 << 24

COUNT_TYPES = (np.uint16, np.uint32, np.float32)  #: that the compiled kernel reads


class _Kernel(Protocol):
    def fit(self, *buffers: NDArray[Any]) -> None: ...

    def change_reference(self, *buffers: NDArray[Any]) -> None: ...

    def changes(self, *buffers: NDArray[Any]) -> None: ...

    def sums(self, *buffers: NDArray[Any]) -> None: ...

    def correlations(self, *buffers: NDArray[Any]) -> None: ...

    def verdicts(self, *buffers: NDArray[Any]) -> None: ...

    def picture(self, *buffers: NDArray[Any]) -> None: ...

    def surface_starts(self, *buffers: NDArray[Any]) -> None: ...


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

    _keep_memory()
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
    size = (
        TILE_PIXELS if kernel is None else max(-(-len(which) // max(threads, 1)), LEAST_PER_THREAD)
    )
    tiles = [slice(start, start + size) for start in range(0, max(len(which), 1), size)]
    if threads > 1 and len(tiles) > 1:
        list(_workers(threads).map(fit_tile, tiles))
    else:
        for tile in tiles:
            fit_tile(tile)
    if per_period is not None:
        leave_unassessed(found, per_period)
    return found


@cache
def _keep_memory() -> None:
    """Have the memory of a picture kept for the next one, where the C library is glibc.

    It returns free memory to the system beyond twice the largest block that was freed so far; every
    picture would then take two thousand page faults, a tenth of its time.
    """
    np.empty(KEPT_BYTES, np.uint8)  # is not touched, and freed at once


@cache
def _workers(threads: int) -> ThreadPoolExecutor:
    """Threads that wait for pixels: starting them anew takes as long as fitting a hundred."""
    return ThreadPoolExecutor(threads, thread_name_prefix="fit")


if hasattr(os, "register_at_fork"):  # a forked process has the pool but not its threads
    os.register_at_fork(after_in_child=_workers.cache_clear)


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


def pixel_numbers(chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the numbers of the pixels that are chosen.

    Parameters
    ----------
    chosen : ndarray of bool, any shape
        True where a pixel is chosen.

    Returns
    -------
    ndarray of int64, shape (chosen,)
        Their places in the array, ascending.
    """
    if chosen.all():  # numbering them takes a tenth of the time of looking for them
        return np.arange(chosen.size, dtype=np.int64)
    return np.flatnonzero(chosen)


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


#: what `survey` returns
Survey = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]


def survey(
    counts: NDArray[Any],
    lit: slice = slice(None),
    /,
    *,
    pixels: NDArray[np.int64] | None = None,
) -> Survey:
    """Count the photons of each pixel in one pass, and look for full counters.

    Parameters
    ----------
    counts : ndarray, shape (pixel, code)
        Counts.
    lit : slice
        Codes of photons.
    pixels : ndarray of int64, shape (chosen,), optional
        Pixels to look at; by default all of them.

    Returns
    -------
    sums : ndarray of float, shape (chosen,)
        Counts of all codes.
    inside : ndarray of float, shape (chosen,)
        Counts of the codes in `lit`.
    full : ndarray of bool, shape (chosen,)
        True where a counter is at the end of its integer type.
    """
    kernel = compiled_kernel()
    if kernel is None or counts.dtype not in COUNT_TYPES:
        chosen = counts if pixels is None else counts[pixels]
        full = np.zeros(len(chosen), bool)
        if counts.dtype.kind in "ui":
            full = (chosen == np.iinfo(counts.dtype).max).any(axis=-1)
        sums = chosen.sum(axis=-1, dtype=np.float64)
        return sums, chosen[:, lit].sum(axis=-1, dtype=np.float64), full
    if pixels is None:
        pixels = np.arange(len(counts), dtype=np.int64)
    sums, inside = np.empty((2, pixels.size))
    full = np.empty(pixels.size, np.uint8)
    span = np.array(lit.indices(counts.shape[1])[:2], np.int64)
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
) -> ChangeReference:
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
    ChangeReference
        References of the pixels that were fitted.
    """
    kernel = compiled_kernel(tables.bands)
    if kernel is None or light.dtype not in COUNT_TYPES:
        return change_detection.change_reference(light[pixels], found, offsets_ns, tables)
    made = no_reference(len(pixels), tables)
    made.delays_ns[:] = found.delay_ns + offsets_ns
    kernel.change_reference(
        *CHANGE_REFERENCE.arguments(
            counts=light,
            pixels=np.ascontiguousarray(pixels, np.int64),
            **table_arguments(tables, DEFAULT),
            delays=made.delays_ns,
            amplitudes=np.ascontiguousarray(found.amplitudes, np.float32),
            background=found.background.astype(np.float32),
            weights=made.weights,
            sums=made.sums,
        )
    )
    return made


def survey_changes(
    counts: NDArray[Any],
    lit: slice,
    reference: ChangeReference,
    tables: ModelTables,
    *,
    backwards: bool = False,
    exposures: NDArray[np.float64] | None = None,
    earlier: NDArray[np.float64] | None = None,
) -> tuple[Survey, NDArray[np.floating]]:
    """Return what `survey` finds, and how much pixels have changed, in one pass.

    Parameters
    ----------
    counts : ndarray, shape (pixel, code)
        New counts.
    lit : slice
        Codes of photons.
    reference : ChangeReference
        The same pixels at their last fit.
    tables : ModelTables
        Tables of the fit.
    backwards : bool
        The last code of photons is that of the first bin.
    exposures : ndarray of float, shape (pixel,), optional
        Exposures behind the counts; by default the counts of all codes.
    earlier : ndarray of float, shape (pixel,), optional
        Exposures behind the last fit; by default as many as now.

    Returns
    -------
    found : tuple of ndarray
        What `survey` returns.
    significance : ndarray of float, shape (pixel,)
        Greatest difference in standard deviations; see `change_detection.change_significance`.
        It means nothing where a pixel has no reference.
    """
    kernel = compiled_kernel(tables.bands)
    if kernel is None or counts.dtype not in COUNT_TYPES:
        found = survey(counts, lit)
        now = found[0] if exposures is None else exposures
        scales = np.ones(len(counts)) if earlier is None else now / earlier
        light = counts[:, lit][:, ::-1] if backwards else counts[:, lit]
        return found, change_detection.change_significance(light, reference, scales, tables)
    sums, inside = np.empty((2, len(counts)))
    full, significance = np.empty(len(counts), np.uint8), np.empty(len(counts), np.float32)
    nothing = np.empty(0)
    kernel.changes(
        *CHANGES.arguments(
            counts=counts,
            pixels=np.arange(len(counts), dtype=np.int64),
            **table_arguments(tables, DEFAULT),
            span=np.array([*lit.indices(counts.shape[1])[:2], backwards], np.int64),
            exposures=nothing if exposures is None else exposures,
            earlier=nothing if earlier is None else earlier,
            delays=reference.delays_ns,
            weights=reference.weights,
            kept=reference.sums,
            all=sums,
            inside=inside,
            full=full,
            significance=significance,
        )
    )
    return (sums, inside, full.astype(bool)), significance


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
    rates = np.empty(0) if per_period is None else per_period
    kernel.fit(
        *FIT.arguments(
            counts=light,
            pixels=pixels,
            **table_arguments(tables, options),
            offsets=offsets_ns.astype(np.float32),
            rates=rates.astype(np.float32),
            **assessment_arguments(tables),
            **into.arrays(),
        )
    )
