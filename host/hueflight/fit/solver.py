"""The joint fit, compiled where it could be: one function, checked here, the same either way.

The compiled kernel is taken where it was built and has room for the plan's bands;
``HUEFLIGHT_KERNELS=numpy`` or ``=c`` chooses by hand.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from importlib import import_module
from typing import Any, Protocol, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import HueflightError
from hueflight.fit import change_detection as changes
from hueflight.fit import reference as definition
from hueflight.fit.packing import MOST_BANDS, PackedLevel, PackedTables, pack, rules
from hueflight.fit.reference import DEFAULT, Fit, FitOptions, no_fit
from hueflight.fit.tables import ModelTables
from hueflight.model.pileup import NEGLIGIBLE, coates_correction

TILE_PIXELS = 2048  #: pixels that one thread takes at a time

COUNT_TYPES = (np.uint16, np.uint32, np.float32)  #: that the compiled kernel reads

#: the same kernel for AVX-512, for AVX2, and for any processor, the best first
BUILDS = ("_kernels_v4", "_kernels_v3", "_kernels")

_packed: WeakKeyDictionary[ModelTables, PackedTables] = WeakKeyDictionary()


class _Kernel(Protocol):
    LANES: int

    def fit(self, *buffers: Any) -> None: ...

    def contrasts(self, *buffers: Any) -> None: ...

    def remember(self, *buffers: Any) -> None: ...

    def sums(self, *buffers: Any) -> None: ...

    def correlations(self, *buffers: Any) -> None: ...


@cache
def compiled_kernel() -> _Kernel | None:
    """The best compiled fit that this processor can run, or None where there is none."""
    try:
        able: int = import_module("hueflight.fit._kernels").processor()
    except ImportError:
        return None
    for name in BUILDS[2 - able :]:
        with suppress(ImportError):  # its compiler may not have known that processor
            return cast(_Kernel, import_module(f"hueflight.fit.{name}"))
    return None


def chosen_backend(bands: int) -> str:
    """``"c"`` or ``"numpy"``.

    Raises
    ------
    HueflightError
        If HUEFLIGHT_KERNELS asks for what is not there.
    """
    wish = os.environ.get("HUEFLIGHT_KERNELS", "")
    if wish not in ("", "c", "numpy"):
        raise HueflightError(f"HUEFLIGHT_KERNELS = {wish!r}: must be 'c' or 'numpy'")
    able = compiled_kernel() is not None and bands <= MOST_BANDS
    if wish == "c" and not able:
        raise HueflightError(
            f"HUEFLIGHT_KERNELS = 'c', but there is no compiled fit for {bands} bands: install "
            "with a C compiler, or leave the choice open"
        )
    return "c" if able and wish != "numpy" else "numpy"


def fit_pixels(
    light: NDArray[Any],
    offsets_ns: NDArray[np.float64],
    plan: ModelTables,
    switches: FitOptions = DEFAULT,
    *,
    pixels: NDArray[np.int64] | None = None,
    per_period: NDArray[np.float64] | None = None,
    threads: int = 1,
) -> Fit:
    """Fit pixels side by side; see `fit.fit`.

    Parameters
    ----------
    light : (pixel, bin) counts in time order.
    offsets_ns : (fitted,) delay of each pixel that is fitted.
    pixels : (fitted,) rows of `light` to fit; default all.
    per_period : (fitted,) photons per period, of which a sensor that keeps the first photon of an
        exposure hides some: undone on the way, see `pileup.coates_correction`.
    threads : that share the pixels, tile by tile; the result does not depend on it.
    """
    bins = sum(view.bins.count for view in plan.views)
    which = np.arange(len(light)) if pixels is None else np.ascontiguousarray(pixels, np.int64)
    if light.ndim != 2 or light.shape[1] != bins or offsets_ns.shape != which.shape:
        raise HueflightError(
            f"light has shape {light.shape} and offsets {offsets_ns.shape}: the plan needs "
            f"(pixel, {bins}) and ({which.size},)"
        )
    if per_period is not None and float(np.max(per_period, initial=0.0)) < NEGLIGIBLE:
        per_period = None
    compiled = chosen_backend(plan.bands) == "c"
    if compiled and light.dtype not in COUNT_TYPES:
        light = light.astype(np.float32)

    found = no_fit(which.size, plan.bands)

    def fit_tile(tile: slice) -> None:
        rates = None if per_period is None else per_period[tile]
        into = found.take(tile)  # a view
        if compiled:
            _fit_compiled(light, which[tile], offsets_ns[tile], rates, plan, switches, into)
            return
        seen = light if pixels is None and len(which) <= TILE_PIXELS else light[which[tile]]
        found.put(
            tile, definition.fit(coates_correction(seen, rates), offsets_ns[tile], plan, switches)
        )

    starts = range(0, max(len(which), 1), TILE_PIXELS)
    tiles = [slice(start, start + TILE_PIXELS) for start in starts]
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(fit_tile, tiles))
    else:
        for tile in tiles:
            fit_tile(tile)
    return found


def photon_sums(light: NDArray[Any]) -> NDArray[np.float64]:
    """Counts (pixel,) of (pixel, bin)."""
    return survey(light)[0]


def survey(
    counts: NDArray[Any], lit: slice = slice(None)
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Counts (pixel,) of (pixel, code), those of `lit` codes, and where a counter is full.

    A counter is full at the end of its integer type.
    """
    kernel = compiled_kernel()
    wish = os.environ.get("HUEFLIGHT_KERNELS", "")
    if kernel is None or wish == "numpy" or counts.dtype not in COUNT_TYPES:
        full = np.zeros(len(counts), bool)
        if counts.dtype.kind in "ui":
            full = (counts == np.iinfo(counts.dtype).max).any(axis=-1)
        sums = counts.sum(axis=-1, dtype=np.float64)
        return sums, counts[:, lit].sum(axis=-1, dtype=np.float64), full
    sums, inside = np.empty((2, len(counts)))
    full = np.empty(len(counts), np.uint8)
    span = np.array(lit.indices(counts.shape[1])[:2], np.int64)
    kernel.sums(counts, np.arange(len(counts)), span, sums, inside, full)
    return sums, inside, full.astype(bool)


def remembered(
    light: NDArray[Any],
    pixels: NDArray[np.int64],
    found: Fit,
    offsets_ns: NDArray[np.float64],
    plan: ModelTables,
) -> NDArray[np.float32]:
    """What changes of pixels are told by, `found` being their fit; see `changes.remembered`."""
    if chosen_backend(plan.bands) == "numpy" or light.dtype not in COUNT_TYPES:
        return changes.remembered(light[pixels], found, offsets_ns, plan)
    kernel, packed = _packed_for(plan)
    room = -(-plan.coarse.starts.size // changes.ROOM) * changes.ROOM
    memory = np.empty((len(pixels), 2, room), np.float32)
    kernel.remember(
        light,
        np.ascontiguousarray(pixels, np.int64),
        (found.delay_ns + offsets_ns).astype(np.float32),
        np.empty(0, np.float32),
        *_plan_buffers(plan, packed, DEFAULT),
        np.ascontiguousarray(found.amplitudes, np.float32),
        found.background.astype(np.float32),
        memory,
    )
    return memory


def contrasts(
    now: NDArray[Any],
    memory: NDArray[np.float32],
    pixels: NDArray[np.int64],
    scales: NDArray[np.float64],
    delays_ns: NDArray[np.float64],
    plan: ModelTables,
) -> NDArray[np.float64]:
    """How much some pixels have changed, `memory` being of all; see `changes.contrasts`."""
    if chosen_backend(plan.bands) == "numpy" or now.dtype not in COUNT_TYPES:
        return changes.contrasts(now[pixels], memory[pixels], scales, delays_ns, plan)
    kernel, packed = _packed_for(plan)
    result = np.empty(len(pixels), np.float32)
    kernel.contrasts(
        now,
        np.ascontiguousarray(pixels, np.int64),
        delays_ns.astype(np.float32),
        scales.astype(np.float32),
        *_plan_buffers(plan, packed, DEFAULT),
        memory,
        result,
    )
    return result.astype(np.float64)


def _packed_for(plan: ModelTables) -> tuple[_Kernel, PackedTables]:
    kernel = compiled_kernel()
    assert kernel is not None  # chosen_backend has seen to it
    if plan not in _packed:
        _packed[plan] = pack(plan, kernel.LANES)
    return kernel, _packed[plan]


def _fit_compiled(
    light: NDArray[Any],
    pixels: NDArray[np.int64],
    offsets_ns: NDArray[np.float64],
    per_period: NDArray[np.float64] | None,
    plan: ModelTables,
    switches: FitOptions,
    into: Fit,
) -> None:
    kernel, packed = _packed_for(plan)
    rates = np.empty(0) if per_period is None else per_period
    kernel.fit(
        light,
        pixels,
        offsets_ns.astype(np.float32),
        rates.astype(np.float32),
        *_plan_buffers(plan, packed, switches),
        *(into.delay_ns, into.delay_std_ns, into.other_ns),
        *(into.amplitudes, into.amplitude_std, into.background, into.steps),
    )


def _plan_buffers(
    plan: ModelTables, packed: PackedTables, switches: FitOptions
) -> list[NDArray[Any]]:
    integers, reals = rules(plan, packed, switches)
    sizes = np.array([view.bins.count for view in plan.views], np.int32)
    coarse = packed.coarse
    return [
        *(integers, reals, sizes),
        *_buffers(packed.fine),
        *_buffers(packed.rough),
        *(coarse.spans, coarse.gains, coarse.costs),
        *(coarse.places, coarse.runs, coarse.widths, coarse.shares),
    ]


def _buffers(level: PackedLevel) -> tuple[NDArray[Any], ...]:
    tables = level.widths, level.places, level.runs, level.data
    return *tables, level.pairs, level.meets, level.meetings
