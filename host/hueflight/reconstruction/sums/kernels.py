# SPDX-License-Identifier: Apache-2.0
"""The estimator from sums, compiled where possible: `estimator` defines the same in NumPy."""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight import backend
from hueflight.backend.sums import ESTIMATE, LANES, MOST_BANDS, MOST_LAGS, SIZES
from hueflight.reconstruction.sums.delay_tables import LAG_PHASES, SumTables
from hueflight.reconstruction.sums.estimator import (
    FLOOR_PHOTONS,
    FLOOR_SHARE,
    RIDGE,
    SumsFit,
    estimate_reference,
)

_packed: WeakKeyDictionary[SumTables, dict[str, NDArray[Any]]] = WeakKeyDictionary()


def estimate_pixels(sums: NDArray[Any], number: NDArray[np.intp], tables: SumTables) -> SumsFit:
    """Estimate delay, amplitudes and background of every pixel.

    Parameters
    ----------
    sums : ndarray of float, shape (pixel, sum)
        Sums; the first is the number of photons, above 0.
    number : ndarray of int, shape (pixel,)
        Place of each pixel's offset in the tables.
    tables : SumTables
        Tables of the estimator.

    Returns
    -------
    SumsFit
        Results.
    """
    native = backend.compiled("sums")
    if native is None or tables.bands > MOST_BANDS or tables.lags > MOST_LAGS:
        return estimate_reference(sums, number, tables)
    if tables not in _packed:
        _packed[tables] = _pack(tables)
    found = SumsFit.empty(len(sums), tables.bands)
    native.estimate(
        *ESTIMATE.arguments(
            sums=np.ascontiguousarray(sums, np.float32),
            number=np.ascontiguousarray(number, np.int32),
            **_packed[tables],
            delay=found.delay_ns,
            delay_std=found.delay_std_ns,
            amplitudes=found.amplitudes,
            amplitude_std=found.amplitude_std,
            background=found.background,
            distance=found.distance,
            dark_distance=found.dark_distance,
        )
    )
    return found


def _pack(tables: SumTables) -> dict[str, NDArray[Any]]:
    """Tables as the compiled estimator takes them."""
    return {
        "whiten": np.ascontiguousarray(tables.whiten, np.float32),
        "dark_test": np.ascontiguousarray(tables.dark_test, np.float32),
        "sizes": SIZES.pack(
            bands=tables.bands,
            sums=tables.sums,
            lags=tables.lags,
            lag_phases=LAG_PHASES,
            rest=tables.rest,
            first_ns=tables.first_ns,
            phase_ns=tables.phase_ns,
            floor_share=FLOOR_SHARE,
            floor_photons=FLOOR_PHOTONS,
            ridge=RIDGE,
        ),
        "separate": _made_up(np.swapaxes(tables.separate, -1, -2)),
        "slopes": _made_up(tables.slopes),
        "dark": _made_up(tables.dark),
        "covariances": _made_up(tables.covariances),
        "nulls": np.ascontiguousarray(tables.nulls, np.float32),
    }


def _made_up(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """Rows with zeros up to a multiple of the lanes."""
    more = [(0, 0)] * (values.ndim - 1) + [(0, -values.shape[-1] % LANES)]
    return np.pad(values, more).astype(np.float32)
