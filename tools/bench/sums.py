# SPDX-License-Identifier: Apache-2.0
"""Images from sums against the bound of the histogram: precision, coverage, link load and speed.

    python3 tools/dev.py bench sums [--quick] [--write]

Photons, truth, colors and bounds are those of `bench accuracy`. Depths lie within 2 ns of the
middle of the tables, or from 4 to 6 ns away. `--write` puts the tables where the documentation
shows them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from _measure import table
from _trials import COLOURS, DISTANCE_M, Cell, Estimator, Outcome, Rig, rig, run_cell
from numpy.typing import NDArray

import hueflight as hf
from hueflight.acquisition.sums_reduction import PACKET_SHARE, reduction_of
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction import code_offsets
from hueflight.reconstruction.bounds import expected_shares
from hueflight.reconstruction.sums.delay_tables import sum_tables
from hueflight.reconstruction.sums.design import SumsDesign, link_bytes
from hueflight.reconstruction.sums.kernels import estimate_pixels
from hueflight.reconstruction.sums.method import reconstruct_sums
from hueflight_protocol import ReductionRoom
from hueflight_protocol.reduction import MOST_SUM_BITS, reduce_histogram

DOCS = Path(__file__).parents[2] / "docs" / "results"
DESIGNS = {"15 sums, 8 bits": (15, 8), "14 sums, 4 bits": (14, 4), "12 sums, 3 bits": (12, 3)}
ROOM = ReductionRoom(sums=12, entry_bits=3, sum_bits=10, group=8, narrow=8)  #: of one bank
IN_ROOM = "12 sums in 112 bits, 3 bits"
RATE_HZ = 18_600
TAIL_NS, BIN_WIDTH_NS = 3.0, 0.642
MOST_PHOTONS = 1500.0  #: of a pixel and picture
RUNS = 7  #: of each speed
PIXELS, PICTURES_PER_S = 192 * 128, 30
NEAR, FAR = "within 2 ns", "4 to 6 ns away"
LIMITS = {
    (NEAR, 0.1): ("≤ 1.08", "≤ 1.15"),
    (FAR, 0.1): ("≤ 1.20", ""),
    (NEAR, 1.0): ("≤ 1.25", ""),
    (FAR, 1.0): ("≤ 1.5", ""),
}

Results = dict[tuple[str, str, float], list[Outcome]]  #: by design, depth, background: each color


def from_sums(design: SumsDesign) -> Estimator:
    """Estimator that reduces a histogram before it reconstructs."""

    def estimate(histogram: NDArray[np.uint32], calibration: hf.Calibration):
        shape = histogram.shape
        offsets = code_offsets(calibration)
        sums = reduce_histogram(
            histogram.reshape(-1, shape[-1]), design.tables, offsets=offsets.ravel()
        )
        frames = histogram.sum(axis=-1, dtype=np.float64)
        return reconstruct_sums(
            sums.reshape(*shape[:2], -1), design, calibration, offsets=offsets, frames=frames,
            range_correction=False,
        )  # fmt: skip

    return estimate


def at_delays(made: Rig, where: str) -> Rig:
    """The same rig with depths at the given delays against the reference."""
    rows = len(made.depths)
    delays_ns = np.linspace(-2, 2, rows)
    if where == FAR:
        half = np.linspace(4, 6, rows // 2)
        delays_ns = np.concatenate([-half[::-1], half])
    depths = DISTANCE_M + delays_ns * SPEED_OF_LIGHT_M_PER_NS / 2
    light = [expected_shares(made.instrument, depth) for depth in depths]
    return replace(
        made,
        depths=depths,
        shares=np.array([shares for shares, _, _ in light]),
        slopes=np.array([slopes for _, slopes, _ in light]),
    )


def main() -> None:
    quick = "--quick" in sys.argv
    pixels = 2048 if quick else 4096
    names = [IN_ROOM] if quick else [*DESIGNS, IN_ROOM]
    found: Results = {}
    loads = {}
    made = rig(TAIL_NS, BIN_WIDTH_NS)
    for name in names:
        design, loads[name] = _designed(name, made.calibration)
        estimators = {"sums": from_sums(design)}
        for where, background in LIMITS:
            moved = at_delays(made, where)
            cells = [Cell(colour, 620, background, TAIL_NS, BIN_WIDTH_NS) for colour in COLOURS]
            found[name, where, background] = [
                run_cell(cell, estimators, pixels=pixels, made=moved)["sums"] for cell in cells
            ]
    parts = {"precision": _precision(found, loads), "speed": _speed()}
    for title, text in parts.items():
        print(f"\n## {title}\n\n{text}")
    if "--write" in sys.argv:
        for name, text in parts.items():
            (DOCS / f"sums-{name}.inc").write_text(text)


def _designed(name: str, calibration: hf.Calibration) -> tuple[SumsDesign, float]:
    """A design, and the MB/s that it takes with the headers of packets."""
    if name in DESIGNS:
        sums, bits = DESIGNS[name]
        design = hf.design_sums(calibration, sums=sums, entry_bits=bits, most_photons=MOST_PHOTONS)
        return design, PACKET_SHARE * link_bytes(design, PIXELS) * PICTURES_PER_S / 1e6
    # the rig has fewer pixels: as many frames per second more make the same load
    sensor = calibration.instrument.sensor
    made = reduction_of(
        calibration, picture_frames=RATE_HZ // PICTURES_PER_S, room=ROOM,
        rate_hz=RATE_HZ * PIXELS / (sensor.rows * sensor.cols),
    )  # fmt: skip
    load = link_bytes(SumsDesign(made.tables), PIXELS) * RATE_HZ / made.frames
    # sums of several windows, as the host adds them up
    widths = (MOST_SUM_BITS,) * made.tables.sums
    return SumsDesign(replace(made.tables, widths=widths)), PACKET_SHARE * load / 1e6


def _precision(found: Results, loads: dict[str, float]) -> str:
    rows = []
    for name in loads:
        for (where, background), (depth_limit, band_limit) in LIMITS.items():
            some = found[name, where, background]
            depth = max(o.depth_ratio for o in some)
            band = max(o.reflectance_ratio.max() for o in some)
            cover = 100 * np.mean([o.depth_cover for o in some], axis=0)
            bands = 100 * np.mean([o.reflectance_cover for o in some], axis=(0, 1))
            lost = 100 * max(max(o.mislocks, o.missing) for o in some)
            rows.append([
                name, f"{loads[name]:.1f}", where, f"{background:g}:1",
                f"{depth:.3f}", depth_limit, f"{band:.2f}", band_limit,
                f"{cover[0]:.1f} / {cover[1]:.1f}", f"{bands[0]:.1f} / {bands[1]:.1f}",
                f"{lost:.2g}",
            ])  # fmt: skip
    head = [
        "sums, entries", "MB/s", "depth", "background", "depth RMSE ÷ bound",
        "limit", "reflectance spread ÷ bound", "limit", "depth within 68 / 95 %",
        "reflectance within 68 / 95 %", "lost / %",
    ]  # fmt: skip
    return table(head, rows)


def _speed() -> str:
    """Images of the paper's size from sums and from the same histograms, in one thread."""
    instrument = hf.Instrument.load("paper").replace(lens=None)
    bins = instrument.time_bins()
    shares, _, widths = expected_shares(instrument, DISTANCE_M)
    white = instrument.band_brightness() / instrument.band_brightness().sum()
    rng = np.random.default_rng(1)
    reference, counts = (np.zeros(instrument.histogram_shape, np.uint32) for _ in range(2))
    size = (*instrument.image_shape, bins.count)
    reference[..., bins.codes] = rng.poisson(2000 * white @ shares, size)
    reference[..., 0] = 1_000_000
    counts[..., bins.codes] = rng.poisson(620 * white @ shares + 62 * widths, size)
    counts[..., 0] = 1_000_000
    calibration = hf.calibrate(reference, instrument, distance=DISTANCE_M)
    design, offsets = hf.design_sums(calibration), code_offsets(calibration)
    flat = reduce_histogram(counts.reshape(PIXELS, -1), design.tables, offsets=offsets.ravel())
    image, tables = flat.reshape(*counts.shape[:2], -1), sum_tables(calibration, design, offsets)
    number = np.searchsorted(tables.offsets, offsets.ravel())
    works = {
        "sums → delay, bands, background and their deviations": lambda: estimate_pixels(
            flat, number, tables
        ),
        "sums → image, `reconstruct_sums`": lambda: reconstruct_sums(
            image, design, calibration, offsets=offsets, frames=1e6
        ),
        "histogram → image, `reconstruct`": lambda: hf.reconstruct(
            counts, calibration, second_returns=False
        ),
    }
    rows = [[name, f"{_pixels_per_s(work) / 1e6:.2f}"] for name, work in works.items()]
    return table(["one thread", "Mpixel/s"], rows)


def _pixels_per_s(work: Callable[[], object]) -> float:
    """Pixels per second of processor time, the best of several runs."""
    best = np.inf
    for _ in range(RUNS):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return PIXELS / best


if __name__ == "__main__":
    main()
