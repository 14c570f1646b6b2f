# SPDX-License-Identifier: Apache-2.0
"""When a capture may stop: a share of the pixels is known precisely enough."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
import xarray as xr

from hueflight.errors import HueflightError
from hueflight.reconstruction.quality import Quality


@dataclass(frozen=True, kw_only=True)
class StopRule:
    """Precision that is wanted, and of how many pixels.

    Attributes
    ----------
    depth_std : float or None
        Standard deviation of depth, m; None if depth does not matter.
    reflectance_std : float or None
        Standard deviation of the reflectance in every band; None if it does not matter.
    share : float
        Share of the pixels that can be known at all, above 0 and at most 1.

    Raises
    ------
    HueflightError
        If a number is out of range, or no precision is given.
    """

    depth_std: float | None = None
    reflectance_std: float | None = None
    share: float = 0.9

    def __post_init__(self) -> None:
        for name in ("depth_std", "reflectance_std"):
            wish = getattr(self, name)
            if wish is not None and not (isfinite(wish) and wish > 0):
                raise HueflightError(f"{name} = {wish!r}: must be above 0 and finite")
        if self.depth_std is None and self.reflectance_std is None:
            raise HueflightError("StopRule: give depth_std (m), reflectance_std, or both")
        if not 0 < self.share <= 1:
            raise HueflightError(f"share = {self.share!r}: must be above 0 and at most 1")


def share_known(image: xr.Dataset, rule: StopRule, /) -> float:
    """Return the share of pixels whose uncertainties meet the rule.

    Dead and hot pixels and those left out on request don't count, because waiting does not help
    them. Pixels of which nothing is known yet count as not meeting it.

    Parameters
    ----------
    image : Dataset
        Image as `reconstruct` gives it.
    rule : StopRule
        Precision that is wanted.

    Returns
    -------
    float
        Share from 0 to 1.
    """
    never = int(Quality.DEAD | Quality.HOT | Quality.SKIPPED)
    could = (image["quality"].values & never) == 0
    known = could.copy()
    if rule.depth_std is not None:
        known &= image["depth_std"].values <= rule.depth_std  # NaN is not
    if rule.reflectance_std is not None:
        known &= (image["reflectance_std"].values <= rule.reflectance_std).all(axis=-1)
    return float(known.sum() / could.sum()) if could.any() else 1.0


def seen_enough(image: xr.Dataset, rule: StopRule, /) -> bool:
    """Tell whether a capture may stop; see `share_known`.

    Parameters
    ----------
    image : Dataset
        Image as `reconstruct` gives it.
    rule : StopRule
        Precision that is wanted.

    Returns
    -------
    bool
        True if enough pixels meet the rule.
    """
    return share_known(image, rule) >= rule.share


def frames_needed(image: xr.Dataset, rule: StopRule, frames: float, /) -> float:
    """Estimate after how many frames in all the rule will be met, if the scene does not change.

    Variances fall in proportion to the number of frames.

    Parameters
    ----------
    image : Dataset
        Image as `reconstruct` gives it.
    rule : StopRule
        Precision that is wanted.
    frames : float
        Frames behind the image.

    Returns
    -------
    float
        Number of frames; infinity where nothing is known yet of more pixels than the rule permits.
    """
    never = int(Quality.DEAD | Quality.HOT | Quality.SKIPPED)
    could = (image["quality"].values & never) == 0
    if not could.any():
        return frames
    ratio = np.zeros(int(could.sum()))
    if rule.depth_std is not None:
        ratio = np.maximum(ratio, image["depth_std"].values[could] / rule.depth_std)
    if rule.reflectance_std is not None:
        worst = image["reflectance_std"].values[could].max(axis=-1)
        ratio = np.maximum(ratio, worst / rule.reflectance_std)
    ratio = np.sort(np.where(np.isnan(ratio), np.inf, ratio))
    decisive = ratio[int(np.ceil(rule.share * ratio.size)) - 1]
    return float(frames * decisive**2)
