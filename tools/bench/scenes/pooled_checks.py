# SPDX-License-Identifier: Apache-2.0
"""Method `pooled` on empty regions, and judged by photons that it did not see.

Photons of a real capture are divided at random. One half is reconstructed, by `pooled` and from
each pixel's own photons. The other half tells the depth of each pixel that has enough photons, by
the highest correlation with the logarithm of the pulse.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from _face import DEPTH_RANGE, FACE, face_capture, matched_depths
from _night import NIGHT, NIGHT_DEPTH_RANGE, night_calibration, night_counts
from acceptance import NO_DATA, Row
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.ndimage import distance_transform_edt

import hueflight as hf
from hueflight import simulator
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS

LEAST_PHOTONS = 6  #: of a pixel, in either half


def rows(quick: bool) -> Iterator[Row]:
    """Empty regions of a simulated scene, then the two real captures."""
    yield from _skyline(quick)
    for name, path in (("face", FACE), ("night picture", NIGHT)):
        what = f"`pooled` against each pixel's own photons, half and half, real {name}"
        if not path.exists():
            yield Row(what, NO_DATA)
            continue
        counts, calibration, depth_range = _face() if path == FACE else _night(quick)
        yield from _judged(what, counts, calibration, depth_range)


def _skyline(quick: bool) -> Iterator[Row]:
    """Sky that shines steadily and an absorber, seen with few photons."""
    instrument = hf.Instrument.load("paper")
    bright = simulator.SimulationSettings()
    effects = simulator.Effects(sky=1.0)

    def capture(kind, frames, settings, **words):
        return simulator.simulate_capture(
            kind, instrument, frames=frames, settings=settings, **words
        )

    calibration = hf.calibrate(
        capture("reference", 4000, bright), instrument, distance=0.4,
        bands=capture("bands", 400, bright), dark=capture("dark", 2000, bright),
    )  # fmt: skip
    seen = simulator.scene("skyline", instrument)
    for ambient in (0.02, 0.2):
        dim = bright.replace(white_detections=0.05, ambient=ambient, effects=effects)
        empty = simulator.effect_truth(seen, instrument, dim).empty
        inside = distance_transform_edt(empty) > 2
        shares, photons = [], 0.0
        for seed in range(1 if quick else 3):
            counts = capture("scene", 400, dim, scene=seen, seed=seed)
            shown = _unflagged(hf.reconstruct(counts, calibration, method="pooled"))
            usable = empty & calibration.usable
            shares.append((shown[usable].mean(), shown[usable & inside].mean()))
            photons = counts[..., 1:].sum(axis=-1)[usable].mean()
        share, off = np.mean(shares, axis=0)
        yield Row(
            f"sky and absorber of scene `skyline`, {photons:.0f} photons of background and 5 of a "
            "surface, `pooled`: unflagged depths",
            f"{share:.2%}; more than two pixels from a surface {off:.2%}",
            "≤ 1 %", ".2 %", bool(share <= 0.01),
        )  # fmt: skip


Capture = tuple[NDArray[np.uint16], hf.Calibration, tuple[float, float]]


def _face() -> Capture:
    counts, calibration, _ = face_capture()
    return counts, calibration, DEPTH_RANGE


def _night(quick: bool) -> Capture:
    cells = loadmat(NIGHT)["Ts_gated"]
    if quick:
        cells = cells[100:196, 64:160]
    return night_counts(cells), night_calibration(cells.shape), NIGHT_DEPTH_RANGE


def _judged(
    what: str,
    counts: NDArray[np.uint16],
    calibration: hf.Calibration,
    depth_range: tuple[float, float],
) -> Iterator[Row]:
    rng = np.random.default_rng(6)
    half = rng.binomial(counts, 0.5).astype(np.uint16)
    rest = (counts - half).astype(np.uint16)
    judge = matched_depths(rest, calibration, depth_range)
    own, other = half.sum(axis=-1), rest.sum(axis=-1)
    one_m = _of_one_photon_m(calibration)
    limit = 3 * one_m * np.sqrt(1 / np.maximum(own, 1) + 1 / np.maximum(other, 1))
    judged = (np.minimum(own, other) >= LEAST_PHOTONS) & np.isfinite(judge)
    pooled, joint = (
        hf.reconstruct(half, calibration, method=method, depth_range=depth_range)
        for method in ("pooled", "joint")
    )
    alone = matched_depths(half, calibration, depth_range)
    for name, depth, known in (
        ("the same filter on its own photons", alone, judged & _unflagged(pooled)),
        ("`joint`", joint["depth"].values, judged & _unflagged(pooled) & _unflagged(joint)),
    ):
        found, by_pixel = (
            float((np.abs(one - judge) <= limit)[known].mean())
            for one in (pooled["depth"].values, depth)
        )
        yield Row(
            f"{what}: within three pulse-limited deviations, of pixels of at least "
            f"{LEAST_PHOTONS} photons, beside {name}",
            f"{found:.1%}, alone {by_pixel:.1%} "
            f"({known.sum()} of {judged.sum()} pixels, where both know a depth)",
            "≥ the pixel alone", "", found >= by_pixel,
        )  # fmt: skip


def _unflagged(image: xr.Dataset) -> NDArray[np.bool_]:
    return np.isfinite(image["depth"].values) & (image["quality"].values == 0)


def _of_one_photon_m(calibration: hf.Calibration) -> float:
    """Return the Cramér-Rao bound of the depth from one photon without background, m."""
    edges_ns = calibration.bins.edges_ns
    shares, slopes = calibration.templates.shares(edges_ns), calibration.templates.slopes(edges_ns)
    seen = shares[0] > 1e-9
    information = (slopes[0, seen] ** 2 / shares[0, seen]).sum()
    return float(information**-0.5) * SPEED_OF_LIGHT_M_PER_NS / 2
