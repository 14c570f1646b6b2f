# SPDX-License-Identifier: Apache-2.0
"""The compiled conversion of fits to results, whose definition is `conversion`."""

from __future__ import annotations

from typing import Any, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit_results import LUCK_CELLS, PICTURE, PICTURE_RULES, VERDICTS
from hueflight.calibration import Calibration
from hueflight.calibration.calibration import FEWEST_EXPOSURES
from hueflight.fit.assessment import MISFIT, SCORE_STEP, tails
from hueflight.fit.reference import Fit
from hueflight.fit.solver import compiled_kernel, pixel_numbers
from hueflight.model.pileup import lost_photons_factor, periods_per_exposure
from hueflight.reconstruction.conversion_rules import UNTOLD, Conversion, base_flags
from hueflight.reconstruction.deviations import (
    LEAST_BIAS,
    LEAST_EMPTY,
    LEAST_OPEN,
    MOST_BIAS,
    PLAIN_MISFIT,
    RATIO_SCALE,
    brightness_variance,
    common_misfit,
    information_for,
    luck,
    may_share_misfit,
    placement_variance,
)
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.result_planes import ResultPlanes

_Arrays = dict[str, NDArray[Any]]
_kept: WeakKeyDictionary[Calibration, dict[tuple[Any, ...], _Arrays]] = WeakKeyDictionary()


def put(
    planes: ResultPlanes,
    found: Fit,
    changed: NDArray[np.bool_],
    chosen: NDArray[np.bool_],
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    conversion: Conversion,
) -> None:
    """Put results of some pixels in a picture; see `conversion.put_results`.

    Parameters
    ----------
    planes : ResultPlanes
        The picture, which is changed.
    found : Fit
        Fit of the chosen pixels, in order.
    changed : ndarray of bool, shape (row, col)
        Pixels whose results are put.
    chosen : ndarray of bool, shape (row, col)
        Those of them that were fitted; the others get none.
    photons : ndarray of float, shape (row, col)
        Counts of each pixel.
    frames : ndarray of float, shape (row, col), or None
        Exposures behind them.
    conversion : Conversion
        How fits become results.
    """
    kernel = cast("Any", compiled_kernel(conversion.calibration.brightness.size))
    given = _arguments(conversion)
    places = pixel_numbers(changed)
    fitted = chosen[changed]
    if fitted.all():
        numbers = np.arange(fitted.size)
    else:
        numbers = np.cumsum(fitted)
        numbers -= 1
        numbers[~fitted] = -1
    fits = {
        name: np.ascontiguousarray(values, np.float64)
        for name, values in found.arrays().items()
        if name != "steps"
    }
    delays = {name: fits.pop(name) for name in _DELAYS}
    flags, tally = np.empty(found.delay_ns.size, np.uint16), np.empty(3, np.int64)
    rules = given["rules"].copy()
    kernel.verdicts(
        *VERDICTS.arguments(
            rules=rules,
            **delays,
            meters_per_ns=given["meters_per_ns"].reshape(chosen.shape)[changed & chosen],
            flags=flags,
            tally=tally,
        )
    )
    if may_share_misfit(*tally.tolist()):
        rules["misfit"] = common_misfit(found.chi_square[flags & int(UNTOLD) == 0])
    rules["counted"] = frames is not None
    exposures = conversion.calibration.frames if frames is None else frames
    kernel.picture(
        *PICTURE.arguments(
            **(given | {"rules": rules}),
            **delays,
            **fits,
            flags=flags,
            places=places,
            fits=numbers,
            photons=np.ascontiguousarray(photons, np.float64),
            exposures=np.ascontiguousarray(0.0 if exposures is None else exposures, np.float64),
            numbers=planes.numbers,
            reflectances=planes.reflectances,
            quality=planes.quality,
        )
    )


_DELAYS = ("delay_ns", "delay_std_ns", "other_ns", "detection", "chi_square", "misfit")


def _arguments(conversion: Conversion) -> _Arrays:
    """What does not depend on the counts, kept as long as the calibration lives."""
    kept = _kept.setdefault(conversion.calibration, {})
    key = conversion.search_ns, conversion.range_correction, conversion.pileup_correction
    if key not in kept:
        kept[key] = {"rules": _rules(conversion), **_facts(conversion)}
    return kept[key]


def _rules(conversion: Conversion) -> NDArray[np.void]:
    calibration = conversion.calibration
    scores, _ = tails()
    periods = periods_per_exposure(calibration.instrument)
    low_ns, high_ns = conversion.limits_ns
    return PICTURE_RULES.pack(
        distance=calibration.distance,
        blind_ns=conversion.blind_ns,
        least_detection=conversion.least_detection,
        low_ns=low_ns,
        high_ns=high_ns,
        misfit_limit=MISFIT,
        plain_misfit=PLAIN_MISFIT,
        misfit=1.0,
        brightness=calibration.brightness.sum(),
        background_scale=calibration.bin_width_ns / calibration.bins.span_ns,
        periods=periods,
        fewest_exposures=FEWEST_EXPOSURES,
        most_closed=1 - LEAST_OPEN**periods,
        least_empty=LEAST_EMPTY,
        least_bias=LEAST_BIAS,
        most_bias=MOST_BIAS,
        cells_per_height=LUCK_CELLS / np.ptp(luck()[0]),
        first_tail=scores[0],
        tail_step=SCORE_STEP,
        last_tail=scores[-1],
        pixels=calibration.usable.size,
        counted=False,
        scaled=calibration.frames is not None,
        pileup_correction=conversion.pileup_correction,
        range_correction=conversion.range_correction,
        low_signal=Quality.LOW_SIGNAL,
        saturated=Quality.SATURATED,
        ambiguous=Quality.AMBIGUOUS_LAG,
        no_return=Quality.NO_RETURN,
        out_of_range=Quality.OUT_OF_RANGE,
        misfit_flag=Quality.MISFIT,
        piled_up=Quality.PILED_UP,
    )


def _facts(conversion: Conversion) -> _Arrays:
    """What is known of each place and each band."""
    calibration = conversion.calibration
    by_pixel, by_band = brightness_variance(calibration)
    loss = np.empty(0)
    if calibration.frames is not None and not conversion.pileup_correction:
        loss = lost_photons_factor(calibration.reference_photons, calibration.frames)
    beyond = luck()[0]
    cells = np.linspace(beyond[0], beyond[-1], LUCK_CELLS, endpoint=False)
    doubles = {
        "meters_per_ns": calibration.meters_per_ns.reshape(-1),
        "delay_variance": calibration.pixel_delay_std_ns**2,
        "brightness_variance": by_pixel,
        "flat_field": calibration.flat_field,
        "reference_loss": loss,
        "inverse": 1 / calibration.brightness,
        "uncertainty": by_band,
        "luck": np.stack(luck()),
        "tails": tails()[1],
    }
    return {
        "base": base_flags(calibration),
        "scale": RATIO_SCALE,
        "table": np.ascontiguousarray(information_for(calibration).table),
        "placement": placement_variance(calibration).astype(np.float32),
        "luck_cells": (np.searchsorted(beyond, cells, side="right") - 1).astype(np.int32),
        **{name: np.ascontiguousarray(values, np.float64) for name, values in doubles.items()},
    }
