# SPDX-License-Identifier: Apache-2.0
"""What to do about departures from the calibration: correct them, or widen the deviations.

LEDs that drifted and background that is not flat are corrected. Tails and flare can't be: their
true shape is not known. The bias that they leave is predicted instead, and added to the stated
deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from hueflight.arguments import takes
from hueflight.calibration import Calibration
from hueflight.calibration.drift import with_drift
from hueflight.calibration.suspects import drift_of
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.reconstruction.image_check import (
    PICTURE,
    ImageCheck,
    background_found,
    check_pixels,
)
from hueflight.reconstruction.inputs import PreparedHistogram, prepare_histogram
from hueflight.reconstruction.sampled_pixels import (
    MOST_PIXELS,
    background_of,
    sample_pixels,
    trusted_pixels,
)
from hueflight.reconstruction.shared_scores import bias_of

BACKGROUND_PASSES = 4  #: in which the shape of the background is found
#: of the predicted bias that counts as a standard deviation: tails of other shapes than those that
#: are tried leave 0.7 to 1.5 times the bias that is predicted
UNKNOWN_SHAPE = 1.3
DRIFT_PASSES = 2  #: in which delays and widths are found


@dataclass(frozen=True, eq=False)
class Correction:
    """A calibration that a picture has corrected.

    Attributes
    ----------
    calibration : Calibration
        The corrected calibration; the given one where no drift was found.
    background : BackgroundShape
        Shape of the background in the picture, for ``reconstruct(background=...)``.
    before, after : ImageCheck
        Check with the given and with the corrected calibration.
    """

    calibration: Calibration
    background: BackgroundShape
    before: ImageCheck
    after: ImageCheck


@takes(**PICTURE)
def correct_drift(
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
) -> Correction:
    """Correct a calibration for the drift of LEDs that a picture shows.

    Delays are corrected where the check finds them. Widths are, unless the check also finds light
    through an exponential delay, from which they can't be told well enough.

    Parameters
    ----------
    histogram : array_like, shape (row, col, code)
        Counts, raw codes on the last axis.
    calibration : Calibration
        Calibration that the image was made with.
    image : Dataset
        Image, as `reconstruct` gives it; its unflagged pixels are used.
    depth_range : tuple of float, optional
        Nearest and farthest depth that was searched, m; as for `reconstruct`.
    frames : array_like, shape (row, col), or float, optional
        Exposures behind the histogram; as for `reconstruct`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    background : BackgroundShape, optional
        Shape of the background to begin with; by default that which the image was made with.
    pixels : int
        Largest number of pixels to fit, evenly spaced over the picture.
    threads : int
        Threads that share the pixels.

    Returns
    -------
    Correction
        Corrected calibration, shape of the background, and checks before and after.

    Raises
    ------
    HueflightError
        As `check_image` does.

    Notes
    -----
    The mean delay of all LEDs can't be told from a depth and stays as it was calibrated.
    """
    prepared = prepare_histogram(histogram, calibration, frames)
    trusted = trusted_pixels(image)

    def checked(calibration: Calibration, background: BackgroundShape) -> ImageCheck:
        sampled = sample_pixels(
            prepared,
            calibration,
            trusted,
            depth_range=depth_range,
            pileup_correction=pileup_correction,
            background=background,
            pixels=pixels,
            threads=threads,
        )
        return check_pixels(sampled, calibration)

    before = checked(calibration, background_of(image) if background is None else background)
    # a background of another shape disturbs everything else: first of all
    check = _settle_background(before, lambda shape: checked(calibration, shape))
    shape = check.background
    corrected = calibration
    for _ in range(DRIFT_PASSES):
        delays, factors = drift_of(check.suspects, calibration.templates.bands)
        if not delays.any() and (factors == 1).all():
            break
        corrected = with_drift(corrected, delay_ps=delays, width_factor=factors)
        check = checked(corrected, shape)
    return Correction(corrected, shape, before, check)


def find_background(
    prepared: PreparedHistogram,
    calibration: Calibration,
    trusted: NDArray[np.bool_],
    *,
    depth_range: tuple[float, float] | None,
    pileup_correction: bool,
    threads: int,
) -> BackgroundShape:
    """Find how the background of a picture is distributed over the time bins.

    Parameters
    ----------
    prepared : PreparedHistogram
        The histogram.
    calibration : Calibration
        Calibration of the same instrument.
    trusted : ndarray of bool, shape (row, col)
        Pixels with one surface each.
    depth_range : tuple of float or None
        Nearest and farthest depth to search, m.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    threads : int
        Threads that share the pixels.

    Returns
    -------
    BackgroundShape
        The shape; flat where nothing else was found.

    Raises
    ------
    HueflightError
        As `check_image` does.
    """

    def checked(shape: BackgroundShape) -> ImageCheck:
        sampled = sample_pixels(
            prepared,
            calibration,
            trusted,
            depth_range=depth_range,
            pileup_correction=pileup_correction,
            background=shape,
            threads=threads,
        )
        return check_pixels(sampled, calibration)

    return _settle_background(checked(FLAT), checked).background


def _settle_background(
    check: ImageCheck, checked: Callable[[BackgroundShape], ImageCheck]
) -> ImageCheck:
    """Change the shape of the background until a check finds no departure from it."""
    for _ in range(BACKGROUND_PASSES):
        shape = background_found(check)
        if shape == check.background:
            break
        check = checked(shape)
    return check


def with_floor(
    image: xr.Dataset,
    histogram: ArrayLike,
    calibration: Calibration,
    check: ImageCheck,
    /,
    *,
    depth_range: tuple[float, float] | None = None,
    frames: ArrayLike | None = None,
    pileup_correction: bool = True,
    threads: int = 1,
) -> xr.Dataset:
    """Widen the deviations of an image by the bias that tails and flare are predicted to leave.

    Parameters
    ----------
    image : Dataset
        Image, as `reconstruct` gives it.
    histogram : array_like, shape (row, col, code)
        Counts that it was made from.
    calibration : Calibration
        Calibration that it was made with.
    check : ImageCheck
        Its check.
    depth_range : tuple of float, optional
        Nearest and farthest depth that was searched, m; as for `reconstruct`.
    frames : array_like, shape (row, col), or float, optional
        Exposures behind the histogram; as for `reconstruct`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    threads : int
        Threads that share the pixels.

    Returns
    -------
    Dataset
        A copy. `depth_std` and `reflectance_std` contain the predicted bias, and their attribute
        `systematic` names its causes; where the check found neither tail nor flare, the image
        stays as it is.

    Raises
    ------
    HueflightError
        As `check_image` does.
    """
    causes = [name for name in ("tail", "flare") if check[name].found]
    known = np.isfinite(image.transpose("row", "col", ...)["depth"].values)
    if not causes or not known.any():
        return image
    sampled = sample_pixels(
        prepare_histogram(histogram, calibration, frames),
        calibration,
        known,
        depth_range=depth_range,
        pileup_correction=pileup_correction,
        background=check.background,
        pixels=known.size,
        threads=threads,
    )
    model = sampled.model
    sizes = np.zeros(model.directions)
    tails = 2 * model.templates.bands + 1
    flares = tails + len(model.tails_ns) + len(model.decays_ns)
    if "tail" in causes:
        sizes[tails : tails + len(model.tails_ns)] = check["tail"].sizes
    if "flare" in causes:
        delay_ns = float(check["flare"].labels[0].split()[0])
        sizes[flares + model.flares_ns.index(delay_ns)] = check["flare"].sizes[0]
    bias = UNKNOWN_SHAPE * bias_of(sampled.fitted, model, sizes)
    chosen = known & calibration.usable
    widened = image.copy()
    along_axis = calibration.meters_per_ns
    stated = {"systematic": f"predicted bias by {' and '.join(causes)}"}

    def put(name: str, values: NDArray[np.float64]) -> None:
        variable = image[name]
        planes = variable.transpose("row", "col", ...).values.astype(np.float64)
        planes[chosen] = np.hypot(planes[chosen], values)
        data = variable.transpose("row", "col", ...).copy(data=planes.astype(variable.dtype))
        widened[name] = data.transpose(*variable.dims).assign_attrs(variable.attrs | stated)

    put("depth_std", bias[:, -1] * along_axis[chosen])
    white = image["white_photons"].transpose("row", "col").values[chosen].astype(np.float64)
    gains = white[:, None] * image["white_share"].values
    names = [band.name for band in calibration.instrument.bands]
    kept = [names.index(str(name)) for name in image["band_name"].values]
    put("reflectance_std", bias[:, kept] / gains)
    return widened
