# SPDX-License-Identifier: Apache-2.0
"""Schedules that alternate frame by frame, fitted together from one histogram of each.

One schedule alone can't tell which LED was reflected by an object of a single color. Two can: the
object's echo moves from one frame to the next by the difference of the two delays of its LED. Delay
and amplitudes are common to all schedules, so that no precision is lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from hueflight.arguments import RANGE, SWITCH, Kind, listed, takes
from hueflight.calibration import Calibration
from hueflight.errors import CalibrationError, HistogramError
from hueflight.fit.assessment import wavelength_contrasts
from hueflight.fit.reference import DEFAULT, FitOptions
from hueflight.fit.solver import fit_pixels, leave_unassessed
from hueflight.fit.tables import ModelTables, ScheduleView, make_tables
from hueflight.model.histograms import check_histogram, counters_full
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.model.pileup import coates_correction, photons_per_period
from hueflight.model.time_bins import TimeBins
from hueflight.model.undersampling import smooth_undersampled
from hueflight.reconstruction.conversion import in_metres
from hueflight.reconstruction.conversion_rules import Conversion
from hueflight.reconstruction.image import as_image
from hueflight.reconstruction.inputs import assumed_exposures
from hueflight.reconstruction.joint import search_range_ns
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import resolve

_Key = tuple[object, ...]
_kept_tables: WeakKeyDictionary[Calibration, dict[_Key, tuple[Calibration, ModelTables]]] = (
    WeakKeyDictionary()
)

#: what `histograms` may be
HISTOGRAMS = Kind(
    "a list of histograms",
    lambda value: hasattr(value, "__len__") and not isinstance(value, str | bytes | Mapping),
)


@takes(
    histograms=HISTOGRAMS,
    calibrations=listed(Calibration, "a list of Calibrations"),
    depth_range=RANGE,
    range_correction=SWITCH,
    pileup_correction=SWITCH,
    switches=FitOptions,
)
def reconstruct_interleaved(
    histograms: Sequence[ArrayLike] | NDArray[np.generic],
    calibrations: Sequence[Calibration],
    /,
    *,
    depth_range: tuple[float, float] | None = None,
    frames: Sequence[ArrayLike] | None = None,
    range_correction: bool | None = None,
    pileup_correction: bool = True,
    switches: FitOptions = DEFAULT,
) -> xr.Dataset:
    """Reconstruct depth and reflectance from interleaved schedules by one joint fit.

    Parameters
    ----------
    histograms : sequence of array_like, shape (row, col, code) each
        Counts of each schedule, as ``read_capture(by_step=True)`` separates them by the step marker
        of the illuminator.
    calibrations : sequence of Calibration
        One for each schedule, of the same sensor and LEDs in front of a reference at the same
        distance; only the delays of the LEDs may differ.
    depth_range : tuple of float, optional
        Nearest and farthest depth to search, m; by default the whole circle of the period,
        beginning at the camera.
    frames : sequence of array_like, optional
        Exposures behind each histogram, numbers or arrays (row, col); by default the sum over codes
        where the sensor reports its empty exposures, else as many as each reference had.
    range_correction : bool, optional
        Correct reflectance for the distance; see `reconstruct`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure, where the number of exposures is known.
    switches : FitOptions
        Steps that the fit may leave out.

    Returns
    -------
    Dataset
        Image as `reconstruct` gives it. Pixels with two plausible depths are flagged ambiguous, and
        `other_depth` holds the second one.

    Raises
    ------
    HistogramError
        If a histogram does not fit its calibration's instrument, or is empty.
    CalibrationError
        If the calibrations differ in more than the delays of the LEDs.
    HueflightError
        If range correction is asked for and the distance of the reference is not known.
    """
    _check_calibrations(calibrations, len(histograms))
    given = [None] * len(histograms) if frames is None else list(frames)
    if len(given) != len(histograms):
        raise HistogramError(
            f"frames has {len(given)} entries for {len(histograms)} histograms: give one for each"
        )
    counts, exposures = [], []
    for index, (histogram, calibration) in enumerate(zip(histograms, calibrations, strict=True)):
        name = f"histograms[{index}]"
        counts.append(check_histogram(histogram, calibration.instrument, name=name))
        exposures.append(assumed_exposures(counts[-1], calibration, given[index]))
    common = _common(calibrations)
    weights = _weights(exposures)
    search_ns = _search_ns(calibrations[0], depth_range)
    common, tables = _tables_for(calibrations, common, weights, search_ns)

    lights = [
        calibration.bins.in_time_order(count).astype(np.float32)
        for calibration, count in zip(calibrations, counts, strict=True)
    ]
    photons = np.sum([light.sum(axis=-1, dtype=np.float64) for light in lights], axis=0)
    total = None
    if all(exposure is not None for exposure in exposures):
        total = np.sum([exposure for exposure in exposures if exposure is not None], axis=0)
    chosen = common.usable & (photons > 0)
    seen = [
        _seen(light[chosen], exposure, chosen, calibration, pileup_correction)
        for light, exposure, calibration in zip(lights, exposures, calibrations, strict=True)
    ]
    assessed = switches.assessment
    side_by_side = np.concatenate(seen, axis=-1)
    if not tables.resolved:
        switches = replace(switches, assessment=False)  # smoothed counts are no Poisson counts
    found = fit_pixels(side_by_side, common.pixel_delay_ns[chosen], tables, switches)
    if pileup_correction:
        for light, exposure in zip(lights, exposures, strict=True):
            hits = light.sum(axis=-1, dtype=np.float64)
            rates = photons_per_period(hits, exposure, common.instrument)
            if rates is not None:
                leave_unassessed(found, rates[chosen])
    corrected = resolve(range_correction, common)
    estimates = in_metres(
        found,
        chosen,
        photons,
        total,
        Conversion(common, search_ns, corrected, pileup_correction),
        assessed=assessed,
    )
    for count in counts:
        estimates.quality[counters_full(count)] |= int(Quality.SATURATED)
    image = as_image(
        estimates,
        common,
        method="joint",
        range_correction=corrected,
        exposures_known=common.instrument.sensor.reports_empty
        or all(each is not None for each in given),
    )
    return image.assign_attrs(schedules=len(calibrations))


def _check_calibrations(calibrations: Sequence[Calibration], histograms: int) -> None:
    if len(calibrations) != histograms or histograms < 2:
        raise CalibrationError(
            f"{histograms} histograms and {len(calibrations)} calibrations: give one of each for "
            "every schedule, two schedules at least"
        )
    first = calibrations[0]
    for index, other in enumerate(calibrations[1:], start=1):
        apart = [
            line
            for line in first.instrument.differences(other.instrument)
            if not line.split(":")[0].endswith("].delay_ns")
        ]
        if first.distance != other.distance:
            apart.append(f"reference distance: {first.distance} m != {other.distance} m")
        if apart:
            raise CalibrationError(
                f"calibrations[{index}] differs from calibrations[0] in more than the LEDs' "
                f"delays: {'; '.join(apart[:5])}. Calibrate both schedules with one instrument "
                "in front of one reference"
            )


def _weights(exposures: Sequence[NDArray[np.float64] | None]) -> tuple[float, ...]:
    """Share of each schedule in a pixel's exposures, to a thousandth: tables hang on it."""
    if any(exposure is None for exposure in exposures):
        return (1 / len(exposures),) * len(exposures)
    means = np.array([np.mean(exposure) for exposure in exposures if exposure is not None])
    return tuple(float(round(share, 3)) for share in means / means.sum())


def _search_ns(
    calibration: Calibration, depth_range: tuple[float, float] | None
) -> tuple[float, float]:
    period_ns = calibration.bins.period_ns
    if depth_range is not None or period_ns is None:
        return search_range_ns(calibration, depth_range)
    nearest = -2 * calibration.distance / SPEED_OF_LIGHT_M_PER_NS
    return nearest, nearest + period_ns


def _common(calibrations: Sequence[Calibration]) -> Calibration:
    """What is the sensor's own, from all calibrations together."""
    first = calibrations[0]
    usable = np.all([c.usable for c in calibrations], axis=0)
    if not usable.any():
        raise CalibrationError("no pixel is usable in all calibrations: nothing to reconstruct")
    precision = [1 / np.maximum(c.pixel_delay_std_ns, 1e-6) ** 2 for c in calibrations]
    delays = [
        c.pixel_delay_ns - gap for c, gap in zip(calibrations, _gaps_ns(calibrations), strict=True)
    ]
    weight = np.sum(precision, axis=0)
    delay = np.sum([p * d for p, d in zip(precision, delays, strict=True)], axis=0) / weight
    return replace(
        first,
        pixel_delay_ns=np.where(usable, delay, 0.0),
        pixel_delay_std_ns=1 / np.sqrt(weight),
        brightness=np.mean([c.brightness for c in calibrations], axis=0),
        flat_field=np.mean([c.flat_field for c in calibrations], axis=0),
        dead=np.any([c.dead for c in calibrations], axis=0),
        hot=np.any([c.hot for c in calibrations], axis=0),
    )


def _gaps_ns(calibrations: Sequence[Calibration]) -> list[float]:
    """How much later than in the first calibration each one counts its pixels' delays.

    A pixel's delay is against the mean of all: where that falls may differ a little.
    """
    usable = np.all([c.usable for c in calibrations], axis=0)
    first = calibrations[0].pixel_delay_ns[usable]
    return [float(np.median(c.pixel_delay_ns[usable] - first)) for c in calibrations]


def _tables_for(
    calibrations: Sequence[Calibration],
    common: Calibration,
    weights: tuple[float, ...],
    search_ns: tuple[float, float],
) -> tuple[Calibration, ModelTables]:
    """Tables for these schedules; made once and kept as long as the first calibration lives."""
    first = calibrations[0]
    kept = _kept_tables.setdefault(first, {})
    # other calibrations are held by the key, so that none else can take their identity
    key = (*calibrations[1:], weights, search_ns)
    if key not in kept:
        views = [
            ScheduleView(_earlier(c.bins, gap_ns), c.templates, weight)
            for c, gap_ns, weight in zip(calibrations, _gaps_ns(calibrations), weights, strict=True)
        ]
        offsets_ns = common.pixel_delay_ns[common.usable]
        tables = make_tables(
            views,
            shortest_fwhm_ns=min(band.pulse_fwhm_ns for band in first.instrument.bands),
            brightness=common.brightness,
            search_ns=search_ns,
            offsets_ns=(float(offsets_ns.min()), float(offsets_ns.max())),
            contrasts=wavelength_contrasts(first.instrument.wavelengths_nm),
        )
        kept[key] = common, tables
    return kept[key]


def _earlier(bins: TimeBins, gap_ns: float) -> TimeBins:
    """Bins against which light comes later by a gap: their edges lie that much earlier."""
    return TimeBins(bins.codes, bins.edges_ns - gap_ns, bins.period_ns)


def _seen(
    light: NDArray[np.float32],
    exposures: NDArray[np.float64] | None,
    chosen: NDArray[np.bool_],
    calibration: Calibration,
    pileup_correction: bool,
) -> NDArray[np.floating]:
    """Counts (pixel, bin) of one schedule as the fit takes them."""
    if pileup_correction and exposures is not None:
        hits = light.sum(axis=-1, dtype=np.float64)
        light = coates_correction(
            light, photons_per_period(hits, exposures[chosen], calibration.instrument)
        )
    return smooth_undersampled(light, calibration.instrument, calibration.bins)
