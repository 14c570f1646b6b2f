"""When a capture has seen enough: a share of the pixels known well enough."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
import xarray as xr

from hueflight.errors import HueflightError
from hueflight.reconstruction.quality import Quality


@dataclass(frozen=True, kw_only=True)
class StopRule:
    """What must be known, of how many pixels.

    Attributes
    ----------
    depth_std : standard deviation of depth that is wanted, m; None if depth does not matter.
    reflectance_std : the same of the reflectance in every band.
    share : of the pixels that could be known at all, above 0 and at most 1.

    Raises
    ------
    HueflightError
        If a wish can't be met or there is none.
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
    """Share of the pixels whose uncertainties are what the rule wants.

    Dead and hot pixels, and those left out on request, don't count: no wait would help them.
    Pixels that nothing is known of yet count as not there.

    Parameters
    ----------
    image : as `reconstruct` gives.
    rule : what is wanted.
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
    """Whether a capture may stop: see `share_known`."""
    return share_known(image, rule) >= rule.share


def frames_needed(image: xr.Dataset, rule: StopRule, frames: float, /) -> float:
    """Frames in all after which the rule will be met, if the scene stays.

    Variances fall as the number of frames grows; infinity where pixels of which nothing is known
    yet are more than the rule forgives.

    Parameters
    ----------
    frames : behind the image.
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
