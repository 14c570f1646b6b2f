# SPDX-License-Identifier: Apache-2.0
"""Whether a whole picture obeys its calibration, and what is off if it does not.

Drifts that one pixel can't show are plain in all pixels together. The check fits some of the
pixels and asks in which directions their residuals point: LEDs that fire later or longer than when
the calibration was made, background that is not flat, light that arrives through an exponential
delay (multipath, fog, a changed tail), lens flare, and time bins of another width. All suspects are
fitted together, because each alone would be blamed for the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from hueflight.arguments import COUNTS, NUMBERS, POSITIVE, RANGE, SWITCH, Kind, takes
from hueflight.calibration import Calibration
from hueflight.calibration.suspects import FOUND, Suspect, normal_score
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.reconstruction.inputs import prepare_histogram
from hueflight.reconstruction.sampled_pixels import (
    MOST_PIXELS,
    SampledPixels,
    background_of,
    sample_pixels,
    trusted_pixels,
)
from hueflight.reconstruction.shared_scores import (
    SharedModel,
    SharedScores,
    expected_sum,
    sum_scores,
)

SETTLED = 0.5  #: deviations by which a shape of the background may still be off
STEEPEST = 0.98  #: slope of the background that is looked for; at 1 it would reach 0
#: variance of what the waveforms of the calibration tell, relative to that of a picture of as many
#: photons as its reference: none of them is negative, which biases their feet
CALIBRATION_NOISE = 4.0
BINS_PER_FWHM = 8  #: bins on a pulse from which the widths of single bins can be judged
#: standard deviation of each kind of departure before anything is known: keeps what the picture
#: does not tell at 0
PRIOR = {"delay": 0.5, "width": 0.2, "background": 1.0, "tail": 0.5, "flare": 0.5}

#: arguments of a check of a picture
PICTURE: dict[str, type | Kind] = {
    "histogram": COUNTS,
    "calibration": Calibration,
    "image": xr.Dataset,
    "depth_range": RANGE,
    "frames": NUMBERS,
    "pileup_correction": SWITCH,
    "background": BackgroundShape,
    "pixels": POSITIVE,
    "threads": POSITIVE,
}

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ImageCheck:
    """Result of `check_image`.

    Attributes
    ----------
    suspects : tuple of Suspect
        All departures that were looked for.
    pixels : int
        Number of pixels that were fitted.
    photons : float
        Photons of these pixels.
    background : BackgroundShape
        Shape of the background against which they were checked.
    """

    suspects: tuple[Suspect, ...]
    pixels: int
    photons: float
    background: BackgroundShape = FLAT

    def __getitem__(self, name: str) -> Suspect:
        """Return a suspect by its name."""
        for suspect in self.suspects:
            if suspect.name == name:
                return suspect
        raise KeyError(name)

    @property
    def found(self) -> tuple[Suspect, ...]:
        """Suspects that chance does not explain."""
        return tuple(suspect for suspect in self.suspects if suspect.found)

    @property
    def holds(self) -> bool:
        """True if no suspect was found."""
        return not self.found

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain values.

        Returns
        -------
        dict
            The attributes, with ``found`` for each suspect.
        """
        plain = asdict(self)
        plain["suspects"] = [
            asdict(suspect) | {"found": bool(suspect.found)} for suspect in self.suspects
        ]
        return plain

    def __str__(self) -> str:
        verdict = "the picture obeys its calibration" if self.holds else "departures found"
        lines = [f"{verdict} ({self.pixels} pixels, {self.photons:.3g} photons)"]
        lines += [f"{'* ' if suspect.found else '  '}{suspect}" for suspect in self.suspects]
        return "\n".join(lines)


@takes(**PICTURE)
def check_image(
    histogram: ArrayLike,
    calibration: Calibration,
    image: xr.Dataset,
    /,
    *,
    depth_range: tuple[float, float] | None = None,
    frames: ArrayLike | None = None,
    pileup_correction: bool = True,
    background: BackgroundShape | None = None,
    pixels: int = MOST_PIXELS,
    threads: int = 1,
) -> ImageCheck:
    """Check whether a picture obeys its calibration, from the residuals of all pixels together.

    Parameters
    ----------
    histogram : array_like, shape (row, col, code)
        Counts, raw codes on the last axis.
    calibration : Calibration
        Calibration that the image was made with.
    image : Dataset
        Image, as `reconstruct` gives it. Its unflagged pixels are checked.
    depth_range : tuple of float, optional
        Nearest and farthest depth that was searched, m; as for `reconstruct`.
    frames : array_like, shape (row, col), or float, optional
        Exposures behind the histogram; as for `reconstruct`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    background : BackgroundShape, optional
        Shape of the background to check against; by default that which the image was made with.
    pixels : int
        Largest number of pixels to fit, evenly spaced over the picture.
    threads : int
        Threads that share the pixels.

    Returns
    -------
    ImageCheck
        Suspects with sizes, deviations and significance.

    Raises
    ------
    HistogramError
        If the histogram does not fit the calibration, or too few pixels are unflagged.
    HueflightError
        If the bins are too wide for the pulses, so that counts are no Poisson counts.

    Notes
    -----
    A delay that is common to all LEDs can't be told from a depth: the delays that are found have a
    mean of 0.
    """
    prepared = prepare_histogram(histogram, calibration, frames)
    sampled = sample_pixels(
        prepared,
        calibration,
        trusted_pixels(image),
        depth_range=depth_range,
        pileup_correction=pileup_correction,
        background=background_of(image) if background is None else background,
        pixels=pixels,
        threads=threads,
    )
    return check_pixels(sampled, calibration)


def check_pixels(sampled: SampledPixels, calibration: Calibration) -> ImageCheck:
    """Name what is off in fitted pixels.

    Parameters
    ----------
    sampled : SampledPixels
        Fitted pixels.
    calibration : Calibration
        Calibration that they were fitted with.

    Returns
    -------
    ImageCheck
        The suspects.
    """
    fitted, model = sampled.fitted, sampled.model
    scores = sum_scores(fitted, model)
    photons = float(fitted.counts.sum())
    reference = float(calibration.reference_photons.sum())
    noise = 1 + CALIBRATION_NOISE * photons / max(reference, 1.0)
    solution = _solve(scores, model, noise=noise)
    names = [band.name for band in calibration.instrument.bands]
    suspects = [*solution.suspects(names)]
    fwhm_ns = min(band.pulse_fwhm_ns for band in calibration.instrument.bands)
    widths_ns = np.diff(sampled.fine_edges_ns)
    if fwhm_ns >= BINS_PER_FWHM * np.median(widths_ns):
        suspects.append(_bin_widths(sampled))
    return ImageCheck(tuple(suspects), len(fitted.counts), photons, model.background)


@dataclass(frozen=True, eq=False)
class _Solution:
    """Sizes of the departures that were fitted together."""

    model: SharedModel
    active: NDArray[np.intp]
    sizes: _Floats
    covariance: _Floats
    #: for each optional kind, the best direction, its size, deviation and score
    optional: dict[str, tuple[int, float, float, float]]

    def suspects(self, names: Sequence[str]) -> list[Suspect]:
        bands, model = len(names), self.model
        delays = np.arange(bands)
        found = []
        if bands > 1:
            found.append(self._suspect("delay", "ps", tuple(names), delays, 1e3))
        found.append(self._suspect("width", "1", tuple(names), delays + bands))
        slope = np.array([2 * bands])
        found.append(self._suspect("background slope", "1", ("",), slope))
        tails = slope[0] + 1 + np.arange(len(model.tails_ns))
        labels = tuple(f"{mean_ns:g} ns" for mean_ns in model.tails_ns)
        found.append(self._suspect("tail", "1", labels, tails))
        for name, constants in (("background decay", model.decays_ns), ("flare", model.flares_ns)):
            number, size, deviation, score = self.optional[name]
            label = f"{constants[number]:g} ns"
            found.append(Suspect(name, "1", (label,), (size,), (deviation,), score))
        return found

    def _suspect(
        self,
        name: str,
        unit: str,
        labels: tuple[str, ...],
        numbers: NDArray[np.intp],
        factor: float = 1.0,
    ) -> Suspect:
        sizes, covariance = self.sizes[numbers], self.covariance[np.ix_(numbers, numbers)]
        deviations = factor * np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance)
        kept = values > 1e-9 * values.max()
        chi_square = float(((sizes @ vectors[:, kept]) ** 2 / values[kept]).sum())
        return Suspect(
            name,
            unit,
            labels,
            tuple(map(float, factor * sizes)),
            tuple(map(float, deviations)),
            normal_score(chi_square, int(kept.sum())),
        )


def _solve(scores: SharedScores, model: SharedModel, *, noise: float) -> _Solution:
    """Fit all departures together; of the optional ones, those that improve the fit."""
    bands = model.templates.bands
    basic = 2 * bands + 1 + len(model.tails_ns)
    decays = basic + np.arange(len(model.decays_ns))
    flares = basic + decays.size + np.arange(len(model.flares_ns))
    prior = np.concatenate(
        [
            np.full(bands, PRIOR["delay"]),
            np.full(bands, PRIOR["width"]),
            [PRIOR["background"]],
            np.full(len(model.tails_ns), PRIOR["tail"]),
            np.full(decays.size, PRIOR["background"]),
            np.full(flares.size, PRIOR["flare"]),
        ]
    )
    gauge = np.eye(scores.score.size)
    gauge[:bands, :bands] -= 1 / bands

    def solved(active: NDArray[np.intp]) -> tuple[_Floats, _Floats]:
        part = np.ix_(active, active)
        covariance = np.linalg.inv(scores.information[part] / noise + np.diag(prior[active] ** -2))
        sizes = covariance @ scores.score[active] / noise
        free = gauge[part]
        return free @ sizes, free @ covariance @ free.T

    active = np.arange(basic)
    optional: dict[str, tuple[int, float, float, float]] = {}
    for name, candidates in (("background decay", decays), ("flare", flares)):
        tried = []
        for number, candidate in enumerate(candidates):
            sizes, covariance = solved(np.append(active, candidate))
            deviation = float(np.sqrt(covariance[-1, -1]))
            tried.append((number, float(sizes[-1]), deviation, abs(float(sizes[-1])) / deviation))
        best = max(tried, key=lambda one: one[-1])
        optional[name] = best
        if best[-1] > FOUND:
            active = np.append(active, candidates[best[0]])
    some, covariance = solved(active)
    sizes = np.zeros(scores.score.size)
    whole = np.zeros((sizes.size, sizes.size))
    sizes[active] = some
    whole[np.ix_(active, active)] = covariance
    for name, candidates in (("background decay", decays), ("flare", flares)):
        direction = candidates[optional[name][0]]
        if direction in active:  # the final size, with all others
            deviation = float(np.sqrt(whole[direction, direction]))
            size = float(sizes[direction])
            optional[name] = (optional[name][0], size, deviation, abs(size) / deviation)
    return _Solution(model, active, sizes, whole, optional)


def _bin_widths(sampled: SampledPixels) -> Suspect:
    """Relative changes of single bins' widths, from differences between neighbors."""
    expected = expected_sum(sampled.fitted, sampled.model, sampled.fine_edges_ns)
    known = expected > 0
    ratio = np.where(known, sampled.sums / np.where(known, expected, 1.0) - 1, np.nan)
    variance = np.where(known, 1 / np.where(known, expected, 1.0), np.nan)
    # smooth residuals are the other suspects' business
    apart = ratio[1:-1] - (ratio[2:] + ratio[:-2]) / 2
    spread = variance[1:-1] + (variance[2:] + variance[:-2]) / 4
    told = np.isfinite(apart)
    count = int(told.sum())
    chi_square = float((apart[told] ** 2 / spread[told]).sum())
    # neighboring differences share bins: autocorrelations -2/3 and 1/6
    independent = count / (1 + 2 * ((2 / 3) ** 2 + (1 / 6) ** 2))
    score = normal_score(chi_square * independent / count, independent)
    excess = np.mean(apart[told] ** 2 - spread[told]) / 1.5
    size = float(np.sqrt(max(excess, 0.0)))
    deviation = float(np.sqrt(np.mean(spread[told]) / 1.5 * np.sqrt(2 / independent)))
    return Suspect("bin widths", "1", ("rms",), (size,), (deviation,), score)


def background_found(check: ImageCheck) -> BackgroundShape:
    """Return the shape of the background that a check suggests.

    Parameters
    ----------
    check : ImageCheck
        Result of a check.

    Returns
    -------
    BackgroundShape
        That of the check, changed by what was found. What it has already is refined until less
        than half a standard deviation is missing.
    """
    shape = check.background
    slope, decay = check["background slope"], check["background decay"]
    if _is_due(slope, known=shape.slope != 0):
        steeper = float(np.clip(shape.slope + slope.sizes[0], -STEEPEST, STEEPEST))
        shape = replace(shape, slope=steeper)
    if _is_due(decay, known=shape.decay_share != 0):
        share = float(np.clip(shape.decay_share + decay.sizes[0], 0.0, 1.0))
        shape = replace(shape, decay_share=share, decay_ns=float(decay.labels[0].split()[0]))
    return shape


def _is_due(suspect: Suspect, *, known: bool) -> bool:
    missing = abs(suspect.sizes[0]) > SETTLED * suspect.deviations[0]
    return suspect.found or (known and missing)
