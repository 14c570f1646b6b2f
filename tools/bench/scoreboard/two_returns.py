# SPDX-License-Identifier: Apache-2.0
"""Methods on captures of others in which pixels see two surfaces, in files given by their paths.

A file ends in ``.npz`` or ``.mat`` and holds, by these names,

- ``counts``: photons (row, col, bin), whole numbers, bins in the order of time;
- ``pulse``: counts (bin) of a pulse of light from depth 0, in bins of the same width;
- ``bin_width_ns``: width of a bin;
- ``near`` and ``far``, if they are known: depths (row, col) of both surfaces in meters, NaN where
  there is none.

Times repeat after the last bin.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from _face import matched_scores
from _real_photons import laser_calibration
from data_sets import Half, halves_of
from methods import SIZES, pooled_in_squares
from numpy.typing import NDArray
from published import METERS_PER_NS
from scipy.io import loadmat
from score import held_out_bits

import hueflight as hf

Floats = NDArray[np.float64]
Method = Callable[[Half], Floats]
HEAD = [
    "method",
    "bits per photon",
    "pixels with one, two depths",
    "halves apart: near, far, cm",
    "error: near, far, cm",
    "processor time",
]
APART_WIDTHS = 2.0  #: standard deviations of the pulse by which two maxima are two surfaces


@dataclass(frozen=True)
class Capture:
    """A capture and what is known about it.

    Attributes
    ----------
    whole : Half
        All photons.
    truth : ndarray of float, shape (2, row, col), or None
        Near and far depth, m.
    """

    whole: Half
    truth: Floats | None


def read(path: Path) -> Capture:
    """Read a file of the form that this module describes."""
    if path.suffix not in (".npz", ".mat"):
        raise SystemExit(f"{path}: must end in .npz or .mat")
    held = dict(np.load(path)) if path.suffix == ".npz" else loadmat(path)
    if missing := {"counts", "pulse", "bin_width_ns"} - held.keys():
        raise SystemExit(f"{path}: holds no {', '.join(sorted(missing))}")
    counts = np.asarray(held["counts"]).astype(np.uint16)
    pulse = np.asarray(held["pulse"], np.float64).ravel()
    width_ns = float(np.asarray(held["bin_width_ns"]).ravel()[0])
    rows, cols, bins = counts.shape
    if pulse.size > bins:
        raise SystemExit(f"{path}: the pulse has {pulse.size} bins, more than the counts' {bins}")
    bits = max(1, (bins - 1).bit_length())
    counts = np.pad(counts, ((0, 0), (0, 0), (0, (1 << bits) - bins)))
    shape = np.pad(pulse - np.median(pulse), (0, bins - pulse.size)).clip(0)
    fwhm_ns = float(np.count_nonzero(shape > shape.max() / 2) * width_ns)
    middle_ns = float(np.average((np.arange(pulse.size) + 0.5) * width_ns, weights=pulse))
    instrument = hf.Instrument.from_toml(f"""
        name = "two returns"
        [sensor]
        rows = {rows}
        cols = {cols}
        code_bits = {bits}
        bin_width_ns = {width_ns}
        [timing]
        period_ns = {bins * width_ns}
        latency_ns = {middle_ns}
        [[bands]]
        name = "laser"
        wavelength_nm = 640
        pulse_fwhm_ns = {fwhm_ns}
    """)
    farthest = (bins * width_ns - 2 * middle_ns) * METERS_PER_NS
    whole = Half(counts, laser_calibration(instrument, shape), (0.0, farthest))
    known = {"near", "far"} <= held.keys()
    truth = np.stack([held["near"], held["far"]]).astype(np.float64) if known else None
    return Capture(whole, truth)


def one_peak(half: Half) -> Floats:
    """Depth of the highest correlation with the logarithm of the pulse, and no other."""
    return two_peaks(half) * [[[1.0]], [[np.nan]]]


def two_peaks(half: Half, *, size: int = 1) -> Floats:
    """Depths of the two highest, which are some widths of the pulse apart."""
    counts = pooled_in_squares(half.counts, size)
    depths, score = matched_scores(counts, half.calibration, half.depth_range)
    score = np.array(score)
    found = []
    for _ in range(2):
        best = depths[score.argmax(axis=-1)]
        found.append(np.where(counts.any(axis=-1), best, np.nan))
        _, width_ns = half.pulse_width_ns
        near = np.abs(depths - best[..., None]) < APART_WIDTHS * width_ns * METERS_PER_NS
        score[near] = -np.inf
    return np.array(found)


def ours(half: Half, *, method: str, second_returns: bool = False) -> Floats:
    """A method of this project; the second depth where it states one."""
    image = hf.reconstruct(
        half.counts,
        half.calibration,
        method=method,
        depth_range=half.depth_range,
        second_returns=second_returns,
    )
    depth = image["depth"].values
    second = image["second_depth"].values if second_returns else np.full(depth.shape, np.nan)
    return np.stack([depth, second])


#: name → variants of the method, of which the best one counts
METHODS: dict[str, dict[str, Method]] = {
    "log-matched filter": {"": one_peak},
    "log-matched filter, two highest": {"": two_peaks},
    "squares + log-matched filter, two highest": {
        f"{size} × {size}": partial(two_peaks, size=size) for size in SIZES
    },
    "`joint`": {"": partial(ours, method="joint")},
    "`joint`, second returns": {"": partial(ours, method="joint", second_returns=True)},
    "`pooled`": {"": partial(ours, method="pooled")},
}


def rows_of(capture: Capture) -> list[list[str]]:
    """Return a row of the table for each method."""
    one, other = halves_of(capture.whole)
    rows, least = [], None
    for name, variants in METHODS.items():
        tried = [(*_run(method, one, other), words) for words, method in variants.items()]
        bits, first, second, seconds, words = max(tried, key=lambda each: each[0])
        least = seconds if least is None else least
        single = np.isfinite(first[0]) & ~np.isfinite(first[1])
        rows.append(
            [
                name + (f", {words}" if words else ""),
                f"{bits:.3f}",
                f"{single.mean():.0%}, {np.isfinite(first[1]).mean():.0%}",
                _apart(np.sort(first, axis=0), np.sort(second, axis=0)),
                "" if capture.truth is None else _apart(np.sort(first, axis=0), capture.truth),
                f"{seconds / least:.1f} ×",
            ]
        )
        print("  ", *rows[-1], flush=True)
    return rows


def _run(method: Method, one: Half, other: Half) -> tuple[float, Floats, Floats, float]:
    """Bits per photon, depths of both halves, processor seconds."""
    started = time.process_time()
    first = method(one)
    seconds = time.process_time() - started
    second = method(other)
    bits = 0.5 * (held_out_bits(first, other) + held_out_bits(second, one))
    return bits, first, second, seconds


def _apart(one: Floats, other: Floats) -> str:
    """Median distance of near and of far depths, of pixels in which both have two."""
    both = np.isfinite(one).all(axis=0) & np.isfinite(other).all(axis=0)
    if not both.any():
        return "–"
    near, far = (np.median(np.abs(a - b)[both]) for a, b in zip(one, other, strict=True))
    return f"{100 * near:.2f}, {100 * far:.2f}"
