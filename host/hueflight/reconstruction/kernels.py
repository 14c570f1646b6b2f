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
from hueflight.reconstruction import fit as definition
from hueflight.reconstruction.fit import DEFAULT, Fit, Switches
from hueflight.reconstruction.packing import MOST_BANDS, PackedLevel, PackedPlan, pack, rules
from hueflight.reconstruction.plan import Plan

TILE_PIXELS = 2048  #: pixels that one thread takes at a time

#: the same kernel for AVX-512, for AVX2, and for any processor, the best first
BUILDS = ("_kernels_v4", "_kernels_v3", "_kernels")

_packed: WeakKeyDictionary[Plan, PackedPlan] = WeakKeyDictionary()


class _Kernel(Protocol):
    LANES: int

    def fit(self, *buffers: Any) -> None: ...


@cache
def compiled_kernel() -> _Kernel | None:
    """The best compiled fit that this processor can run, or None where there is none."""
    try:
        able: int = import_module("hueflight.reconstruction._kernels").processor()
    except ImportError:
        return None
    for name in BUILDS[2 - able :]:
        with suppress(ImportError):  # its compiler may not have known that processor
            return cast(_Kernel, import_module(f"hueflight.reconstruction.{name}"))
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
    plan: Plan,
    switches: Switches = DEFAULT,
    *,
    threads: int = 1,
) -> Fit:
    """Fit pixels side by side; see `fit.fit`.

    Parameters
    ----------
    threads : that share the pixels, tile by tile; the result does not depend on it.
    """
    bins = sum(view.bins.count for view in plan.views)
    if light.ndim != 2 or light.shape[1] != bins or offsets_ns.shape != light.shape[:1]:
        raise HueflightError(
            f"light has shape {light.shape} and offsets {offsets_ns.shape}: the plan needs "
            f"(pixel, {bins}) and (pixel,)"
        )
    compiled = chosen_backend(plan.bands) == "c"
    if compiled and light.dtype not in (np.uint16, np.uint32, np.float32):
        light = light.astype(np.float32)

    def fit_tile(tile: tuple[NDArray[Any], NDArray[np.float64]]) -> Fit:
        return (_fit_compiled if compiled else definition.fit)(*tile, plan, switches)

    tiles = [
        (light[start : start + TILE_PIXELS], offsets_ns[start : start + TILE_PIXELS])
        for start in range(0, len(light), TILE_PIXELS)
    ] or [(light, offsets_ns)]
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            fits = list(pool.map(fit_tile, tiles))
    else:
        fits = [fit_tile(tile) for tile in tiles]
    return Fit(
        **{
            name: np.concatenate([getattr(part, name) for part in fits])
            for name in Fit.__dataclass_fields__
        }
    )


def _fit_compiled(
    light: NDArray[Any], offsets_ns: NDArray[np.float64], plan: Plan, switches: Switches
) -> Fit:
    kernel = compiled_kernel()
    assert kernel is not None  # chosen_backend has seen to it
    if plan not in _packed:
        _packed[plan] = pack(plan, kernel.LANES)
    packed = _packed[plan]
    integers, reals = rules(plan, packed, switches)
    sizes = np.array([view.bins.count for view in plan.views], np.int32)
    pixels, bands = len(light), plan.bands
    planes = [np.empty(pixels, np.float32) for _ in range(4)]
    amplitudes, amplitude_std = (np.empty((pixels, bands), np.float32) for _ in range(2))
    steps = np.empty(pixels, np.uint8)
    delay, deviation, other, background = planes
    fine, rough, coarse = packed.fine, packed.rough, packed.coarse
    kernel.fit(
        light,
        offsets_ns.astype(np.float32),
        *(integers, reals, sizes),
        *_buffers(fine),
        *_buffers(rough),
        *(coarse.spans, coarse.gains, coarse.costs),
        *(coarse.places, coarse.runs, coarse.widths, coarse.shares),
        *(delay, deviation, other, amplitudes, amplitude_std, background, steps),
    )
    wide = [
        values.astype(np.float64)
        for values in (delay, deviation, other, amplitudes, amplitude_std, background)
    ]
    return Fit(*wide, steps=steps)


def _buffers(level: PackedLevel) -> tuple[NDArray[Any], ...]:
    tables = level.widths, level.places, level.runs, level.data
    return *tables, level.pairs, level.meets, level.meetings
