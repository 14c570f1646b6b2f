# SPDX-License-Identifier: Apache-2.0
"""Whether a calibration still holds, from a new capture of the reference target.

All pixels together tell how the pulse of each band has moved, brightened and widened: the counts
are fitted with each waveform, its first and its second derivative, and a flat background. Each
pixel alone tells whether its delay and its brightness are still those of the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration.calibration import Calibration
from hueflight.calibration.defects import find_dead
from hueflight.calibration.delays import align
from hueflight.calibration.noise import correction_noise
from hueflight.calibration.pooled_changes import pooled_changes
from hueflight.calibration.suspects import FOUND, Suspect, normal_score
from hueflight.errors import CalibrationError
from hueflight.fit.reference import FitOptions
from hueflight.fit.solver import fit_pixels
from hueflight.fit.tables import ScheduleView, make_tables
from hueflight.model.histograms import check_histogram, frames_per_pixel
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.model.pileup import coates_correction, lost_photons_factor, photons_per_period

SIGNIFICANT = FOUND  #: standard deviations from which a change is no chance
DELAY_LIMIT_NS = 0.05  #: change of a delay that is harmless: 7.5 mm where one band dominates
WIDTH_LIMIT = 0.02  #: relative change of a pulse's width that is harmless
WIDTH_KNOWN = 0.0075  #: deviation of a width in a calibration, from separating and smoothing pulses
BRIGHTNESS_LIMIT = 0.05  #: relative change of a band's brightness that is harmless
PIXEL_SHARE = 1e-3  #: share of the pixels that may differ significantly
OTHER_TARGET = 0.2  #: share of the pixels that differ if the target is not flat, or another one

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """What has changed since a calibration.

    Attributes
    ----------
    bands : tuple of str
        Names of the bands.
    common_delay_ns, common_delay_std_ns : float
        How much later the light of all bands arrives, and its standard deviation.
    delay_ns, delay_std_ns : ndarray of float, shape (band,)
        How much later each band arrives beside that, and its standard deviation.
    brightness, brightness_std : ndarray of float, shape (band,)
        Brightness relative to the calibration. Without the number of exposures, relative to the
        mean of all bands.
    width, width_std : ndarray of float, shape (band,)
        Width of the pulse (root of its variance) relative to the calibration.
    pixel_z : ndarray of float, shape (row, col)
        Change of each pixel's delay in standard deviations; NaN for dead and hot pixels.
    brightness_z : ndarray of float, shape (row, col)
        Change of each pixel's brightness against that of all, likewise.
    new_dead, new_hot : ndarray of bool, shape (row, col)
        Pixels that were usable and are no longer.
    findings : tuple of str
        What is beyond its limit, in words; empty if the calibration holds.
    """

    bands: tuple[str, ...]
    common_delay_ns: float
    common_delay_std_ns: float
    delay_ns: _Floats
    delay_std_ns: _Floats
    brightness: _Floats
    brightness_std: _Floats
    width: _Floats
    width_std: _Floats
    pixel_z: _Floats
    brightness_z: _Floats
    new_dead: NDArray[np.bool_]
    new_hot: NDArray[np.bool_]
    findings: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether the calibration still holds."""
        return not self.findings

    @property
    def suspects(self) -> tuple[Suspect, ...]:
        """The bands' changes in the terms of `check_image`, delays beside their plain mean."""
        common = (self.common_delay_ns,), (self.common_delay_std_ns,)
        return (
            _suspect("common delay", "ps", ("",), *common, factor=1e3),
            _suspect(
                "delay", "ps", self.bands, self.delay_ns - self.delay_ns.mean(),
                self.delay_std_ns, factor=1e3,
            ),
            _suspect("width", "1", self.bands, self.width - 1, self.width_std),
            _suspect("brightness", "1", self.bands, self.brightness - 1, self.brightness_std),
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain values, ready for JSON.

        Returns
        -------
        dict
            All numbers of the bands, counts of pixels, and findings.
        """
        by_band = ("delay_ns", "delay_std_ns", "brightness", "brightness_std", "width", "width_std")
        return {
            "holds": self.holds,
            "findings": list(self.findings),
            "bands": list(self.bands),
            "common_delay_ns": self.common_delay_ns,
            "common_delay_std_ns": self.common_delay_std_ns,
            **{name: getattr(self, name).tolist() for name in by_band},
            "pixels_with_another_delay": _beyond(self.pixel_z),
            "pixels_with_another_brightness": _beyond(self.brightness_z),
            "new_dead_pixels": int(self.new_dead.sum()),
            "new_hot_pixels": int(self.new_hot.sum()),
        }


def _suspect(
    name: str,
    unit: str,
    labels: tuple[str, ...],
    sizes: ArrayLike,
    deviations: ArrayLike,
    *,
    factor: float = 1.0,
) -> Suspect:
    """Sizes with deviations that are independent of each other."""
    values, spread = factor * np.asarray(sizes, np.float64), factor * np.asarray(deviations)
    score = normal_score(float(((values / spread) ** 2).sum()), values.size)
    return Suspect(name, unit, labels, tuple(values.tolist()), tuple(spread.tolist()), score)


def check_calibration(
    calibration: Calibration,
    reference: ArrayLike,
    /,
    *,
    distance: float | None = None,
    frames: ArrayLike | None = None,
) -> CalibrationCheck:
    """Compare a new capture of the reference target with a calibration.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    reference : array_like, shape (row, col, code)
        Counts of the same target with all LEDs on.
    distance : float, optional
        Distance of the target now, m; by default that of the calibration.
    frames : array_like, optional
        Exposures behind the capture; by default the sum over codes where the sensor reports its
        empty exposures.

    Returns
    -------
    CalibrationCheck
        What has changed, and whether the calibration holds.

    Raises
    ------
    HistogramError
        If the capture does not fit the instrument, or is empty.
    CalibrationError
        If the capture has no light, or no pixel is usable in both.

    Examples
    --------
    >>> import hueflight as hf
    >>> from hueflight.calibration import check_calibration
    >>> from hueflight.simulator import simulate_capture
    >>> paper = hf.Instrument.load("paper")
    >>> first, later = (simulate_capture("reference", paper, frames=5000, seed=s) for s in (1, 2))
    >>> check_calibration(hf.calibrate(first, paper, distance=0.4), later).holds
    True
    """
    instrument, bins = calibration.instrument, calibration.bins
    counts = check_histogram(reference, instrument, name="reference")
    exposures = frames_per_pixel(counts, instrument, frames)
    light = bins.in_time_order(counts).astype(np.float32)
    photons = light.sum(axis=-1, dtype=np.float64)
    if not photons.any():
        raise CalibrationError(
            "the capture has no light: check that the LEDs were armed and the lens cap is off"
        )
    dead = find_dead(photons)
    hot = align(light, instrument, bins, dead)[2]
    usable = calibration.usable & ~dead & ~hot
    if not usable.any():
        raise CalibrationError("no pixel is usable in the calibration and in this capture")
    noise, total_noise = correction_noise(photons, exposures, instrument)
    arrived = light
    if exposures is not None:
        per_period = photons_per_period(photons, exposures, instrument)
        factor = lost_photons_factor(photons, exposures)[..., None]
        arrived = (coates_correction(light, per_period) * factor).astype(np.float32)
        usable &= np.isfinite(factor[..., 0])
        if not usable.any():
            raise CalibrationError(
                f"frames = {float(np.median(exposures)):g}: every exposure of the capture holds a "
                "photon, so that the number of those that were lost can't be known. State the "
                "number of exposures behind the capture, or dim the LEDs"
            )
    away = calibration.distance if distance is None else distance
    due_ns = 2 * (away - calibration.distance) / SPEED_OF_LIGHT_M_PER_NS

    moved_ns, variance = _pixel_delays(arrived, usable, calibration, due_ns)
    variance = variance * noise + calibration.pixel_delay_std_ns**2
    middle_ns = float(np.median(moved_ns[usable]))
    pixel_z = np.where(usable, (moved_ns - middle_ns) / np.sqrt(variance), np.nan)
    brightness_z = _pixel_brightness(photons, exposures, usable, calibration, total_noise)
    bands = pooled_changes(arrived, usable, calibration, due_ns + middle_ns)
    spread = float(noise[usable].mean())
    delay, brightness, width = (_Estimate(value, std * np.sqrt(spread)) for value, std in bands)

    known = _noise_of(calibration)
    share = known.delay_ns / np.maximum(delay.std, 1e-300)  # the width is known as well as this
    width_std = np.sqrt(width.std**2 * (1 + share**2) + WIDTH_KNOWN**2)
    delay_std = np.hypot(delay.std, known.delay_ns)
    shift = delay.value + middle_ns
    weight = 1 / delay_std**2
    common = float(weight @ shift / weight.sum())
    expected = calibration.brightness * (known.distance / away if away else 1.0) ** 2
    relative = brightness.value / np.count_nonzero(usable) / expected
    relative_std = relative * np.hypot(brightness.std / brightness.value, known.brightness)
    if exposures is not None and calibration.frames is not None:
        scale = exposures[usable].mean()
    else:
        scale = relative.mean()
    result = CalibrationCheck(
        bands=tuple(band.name for band in instrument.bands),
        common_delay_ns=common,
        common_delay_std_ns=float(1 / np.sqrt(weight.sum())),
        delay_ns=shift - common,
        delay_std_ns=delay_std,
        brightness=relative / scale,
        brightness_std=relative_std / scale,
        width=width.value,
        width_std=width_std,
        pixel_z=pixel_z,
        brightness_z=brightness_z,
        new_dead=dead & calibration.usable,
        new_hot=hot & calibration.usable,
    )
    return _with_findings(result)


@dataclass(frozen=True)
class _Estimate:
    """Values and standard deviations (band,)."""

    value: _Floats
    std: _Floats


@dataclass(frozen=True)
class _Known:
    """What the calibration leaves unknown, 0 where it does not say."""

    delay_ns: _Floats
    brightness: _Floats
    distance: float


def _noise_of(calibration: Calibration) -> _Known:
    nothing = np.zeros_like(calibration.brightness)
    delay, brightness = calibration.waveform_delay_std_ns, calibration.brightness_std
    return _Known(
        delay_ns=nothing if delay is None else delay,
        brightness=nothing if brightness is None else brightness / calibration.brightness,
        distance=calibration.distance,
    )


def _pixel_delays(
    light: NDArray[np.float32],
    usable: NDArray[np.bool_],
    calibration: Calibration,
    due_ns: float,
) -> tuple[_Floats, _Floats]:
    """How much later than due the light reaches each pixel, and the variance of it, ns."""
    own_ns = calibration.pixel_delay_ns
    shortest_ns = min(band.pulse_fwhm_ns for band in calibration.instrument.bands)
    tables = make_tables(
        [ScheduleView(calibration.bins, calibration.templates)],
        shortest_fwhm_ns=shortest_ns,
        brightness=calibration.brightness,
        search_ns=(due_ns - shortest_ns, due_ns + shortest_ns),
        offsets_ns=(float(own_ns[usable].min()), float(own_ns[usable].max())),
    )
    found = fit_pixels(light[usable], own_ns[usable], tables, FitOptions(assessment=False))
    moved, variance = np.zeros_like(own_ns), np.ones_like(own_ns)
    moved[usable] = found.delay_ns - due_ns
    variance[usable] = found.delay_std_ns**2
    return moved, variance


def _pixel_brightness(
    photons: _Floats,
    exposures: _Floats | None,
    usable: NDArray[np.bool_],
    calibration: Calibration,
    noise: _Floats,
) -> _Floats:
    """Change of each pixel's brightness against that of all, in standard deviations."""
    rate = photons if exposures is None else photons * lost_photons_factor(photons, exposures)
    rate = rate if exposures is None else rate / exposures
    relative = rate / calibration.flat_field
    middle = np.median(relative[usable])
    variance = noise / np.maximum(photons, 1.0)
    if calibration.flat_field_std is not None:
        variance = variance + (calibration.flat_field_std / calibration.flat_field) ** 2
    else:
        variance = variance + 1 / np.maximum(calibration.reference_photons, 1.0)
    return np.where(usable, (relative / middle - 1) / np.sqrt(variance), np.nan)


def _beyond(z: _Floats) -> int:
    return int(np.count_nonzero(np.abs(z) > SIGNIFICANT))


def _amount(value: float, digits: str, more: str, less: str) -> str:
    """A change as an amount and its direction in words."""
    return f"{abs(value):{digits}}{more if value > 0 else less}"


def _with_findings(check: CalibrationCheck) -> CalibrationCheck:
    """The check with what is beyond its limit, in words."""
    found = []

    def beyond(value: float, std: float, limit: float) -> bool:
        return abs(value) > limit and abs(value) > SIGNIFICANT * std

    if beyond(check.common_delay_ns, check.common_delay_std_ns, DELAY_LIMIT_NS):
        away = check.common_delay_ns * SPEED_OF_LIGHT_M_PER_NS / 2
        found.append(
            "all bands arrive "
            + _amount(check.common_delay_ns, ".3f", " ns later", " ns earlier")
            + ": the target is "
            + _amount(100 * away, ".1f", " cm farther", " cm nearer")
            + " than stated, or the latency has changed"
        )
    for k, name in enumerate(check.bands):
        if beyond(check.delay_ns[k], check.delay_std_ns[k], DELAY_LIMIT_NS):
            found.append(
                f"band {name!r} arrives "
                + _amount(1000 * check.delay_ns[k], ".0f", " ps later", " ps earlier")
                + f" than the others (± {1000 * check.delay_std_ns[k]:.0f} ps)"
            )
        if beyond(check.width[k] - 1, check.width_std[k], WIDTH_LIMIT):
            found.append(
                f"the pulse of band {name!r} is "
                + _amount(100 * (check.width[k] - 1), ".1f", " % wider", " % narrower")
                + f" (± {100 * check.width_std[k]:.1f} %)"
            )
        if beyond(check.brightness[k] - 1, check.brightness_std[k], BRIGHTNESS_LIMIT):
            found.append(
                f"band {name!r} is "
                + _amount(100 * (check.brightness[k] - 1), ".1f", " % brighter", " % dimmer")
                + f" (± {100 * check.brightness_std[k]:.1f} %)"
            )
    seen = np.count_nonzero(np.isfinite(check.pixel_z))
    for z, what in ((check.pixel_z, "delay"), (check.brightness_z, "brightness")):
        if (number := _beyond(z)) <= max(PIXEL_SHARE * seen, 1):
            continue
        text = f"{number} of {seen} pixels have another {what}"
        if number > OTHER_TARGET * seen:
            text += ": the capture does not show the flat target of the calibration, lit alike"
        found.append(text)
    for plane, what in ((check.new_dead, "dead"), (check.new_hot, "hot")):
        if plane.any():
            found.append(f"{int(plane.sum())} pixels have become {what}")
    return replace(check, findings=tuple(found))
