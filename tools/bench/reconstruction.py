# SPDX-License-Identifier: Apache-2.0
"""Benchmark of reconstruction: pixels per second of every method and skip.

    python3 tools/dev.py bench reconstruction                    all of it, about a minute
    python3 tools/dev.py bench reconstruction methods skips      some sections
    python3 tools/dev.py bench reconstruction --json new.json    also as a file, for `bench compare`
    python3 tools/dev.py bench reconstruction instructions --gate 14500  fails if the fit takes more

24 576 pixels (the paper's chip), 620 photons each and 10 % background unless a row says otherwise,
one thread unless it says two. Every table has its references from the same run: `read` sums the
histogram (NumPy), which any method must do at least; RT is real time, thirty images a second.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _fit_instructions import instructions
from _measure import PIXELS, best_of, packets_of, save, table
from numpy.typing import NDArray

import hueflight as hf
from hueflight import backend
from hueflight.calibration import Calibration
from hueflight.fit.reference import FitOptions
from hueflight.fit.solver import fit_pixels
from hueflight.ingest import accumulate
from hueflight.reconstruction import paper
from hueflight.reconstruction import paper_kernel as paper_compiled
from hueflight.reconstruction.bounds import expected_shares
from hueflight.reconstruction.entry_point import reconstruct_packets
from hueflight.reconstruction.joint import search_range_ns, tables_for_calibration
from hueflight.reconstruction.options import NO_SKIPS, Skips
from hueflight.reconstruction.video import Video

IMAGES_PER_SECOND = 30
FRAMES = 620  #: per image at 18.6 kfps
EXPOSURES = 60_000  #: of the slow captures: pile-up is negligible
PHOTONS, BACKGROUND = 620, 62
COUNTED = 4096  #: pixels whose instructions are counted

instrument = hf.Instrument.load("paper")
rng = np.random.default_rng(1)
measured: dict[str, dict[str, float]] = {}  # seconds of every row, by section


def drawn(photons: float, background: float, *, distance: float = 0.9) -> NDArray[np.uint16]:
    """A white wall, (row, col, code)."""
    shares, _, widths = expected_shares(instrument, distance)
    amplitudes = instrument.band_brightness()
    mean = (amplitudes / amplitudes.sum() * photons) @ shares + background * widths
    bins = instrument.time_bins()
    counts = rng.poisson(mean, (*instrument.image_shape, bins.count))
    histogram = np.zeros(instrument.histogram_shape, np.uint16)
    histogram[..., bins.codes] = counts
    histogram[..., 0] = np.maximum(EXPOSURES - counts.sum(axis=-1), 0)
    return histogram


def calibrated() -> Calibration:
    """A calibration of 5000 photons a pixel."""
    return hf.calibrate(drawn(5000, 100, distance=0.4), instrument, distance=0.4)


def rows_of(seconds: dict[str, float], against: str) -> list[list[str]]:
    """Table lines: megapixels per second, against real time and against a reference."""
    return [
        [
            name,
            f"{taken * 1e3:.1f}",
            f"{PIXELS / taken / 1e6:.2f}",
            f"{1 / taken / IMAGES_PER_SECOND:.2f}",
            f"{seconds[against] / taken:.2f}",
        ]
        for name, taken in seconds.items()
    ]


def show(title: str, seconds: dict[str, float], against: str) -> None:
    """Print one section."""
    measured[title] = seconds
    head = ["", "ms an image", "Mpixel/s", "× RT", f"× '{against}'"]
    print(f"\n## {title}\n\n{table(head, rows_of(seconds, against))}", flush=True)


def methods(calibration: Calibration) -> None:
    """Kernels by photons, and whole images."""
    plan = tables_for_calibration(calibration, search_range_ns(calibration, None))
    offsets = calibration.pixel_delay_ns.ravel()
    histograms = {
        (photons, background): drawn(photons, background)
        for photons, background in ((PHOTONS, BACKGROUND), (100, 100), (5000, 500))
    }
    contenders: dict[str, Callable[[], object]] = {}
    for (photons, background), histogram in histograms.items():
        flat = calibration.bins.in_time_order(histogram).reshape(PIXELS, -1)
        name = f"joint fit, {photons} + {background} photons"
        contenders[name] = lambda light=flat: fit_pixels(light, offsets, plan)
        if (photons, background) == (PHOTONS, BACKGROUND):
            contenders[name + ", two threads"] = lambda light=flat: fit_pixels(
                light, offsets, plan, threads=2
            )
    whole = histograms[PHOTONS, BACKGROUND]
    contenders["joint, whole image"] = lambda: hf.reconstruct(whole, calibration)
    contenders["paper, whole image"] = lambda: hf.reconstruct(whole, calibration, method="paper")
    flat = calibration.bins.in_time_order(whole).reshape(PIXELS, -1)
    every, most = np.arange(PIXELS), float(flat.sum(axis=-1).max())
    lags, outside = paper.search_of(calibration), paper.outside_windows(calibration)
    contenders[f"paper's correlation, {PHOTONS} + {BACKGROUND} photons"] = lambda: (
        paper_compiled.measure(flat, every, most, calibration, lags, outside)
    )
    contenders["read"] = lambda: whole.sum(axis=-1, dtype=np.uint32)
    show("Methods", best_of(contenders, rounds=7), "read")


def skips(calibration: Calibration) -> None:
    """What each skip saves of a whole image."""
    full = drawn(PHOTONS, BACKGROUND)
    tenth = np.zeros(instrument.image_shape, bool)
    tenth[:, ::10] = True
    empty = full.copy()
    empty[~tenth, 1:] = 0
    empty[~tenth, 0] = EXPOSURES
    next_still = drawn(PHOTONS, BACKGROUND)
    next_tenth = next_still.copy()
    moved = drawn(PHOTONS, BACKGROUND, distance=1.3)
    next_tenth[tenth] = moved[tenth]
    back_again = drawn(PHOTONS, BACKGROUND)

    def image(histogram: NDArray[np.uint16], **options: object) -> Callable[[], object]:
        return lambda: hf.reconstruct(histogram, calibration, **options)  # type: ignore[arg-type]

    def sequence(change_sigma: float, *others: NDArray[np.uint16]) -> Callable[[], object]:
        video = Video(calibration, change_sigma=change_sigma)
        video.next(full)
        turn = 0

        def run() -> object:
            nonlocal turn
            turn += 1
            return video.next(others[(turn - 1) % len(others)])

        return run

    known = float(np.nanmedian(hf.reconstruct(full, calibration)["depth_std"]))
    contenders: dict[str, Callable[[], object]] = {
        "all skips off": image(full, skips=NO_SKIPS),
        "all skips, nothing to skip": image(full),
        "steps at wide bins on": image(full, skips=Skips(switches=FitOptions(wide_first=True))),
        "early end off": image(full, skips=Skips(switches=FitOptions(settle=False))),
        "depth target met everywhere": image(full, skips=Skips(depth_target=2 * known)),
        "region: a tenth": image(full, region=tenth),
        "bands: three of nine": image(full, bands=[1, 4, 7]),
        "90 % empty": image(empty),
        "90 % empty, skip off": image(empty, skips=Skips(empty=False)),
        "video, all pixels fitted": sequence(0, full, next_still),
        "video, nothing changed": sequence(4, full, next_still),
        "video, 90 % unchanged": sequence(4, next_tenth, back_again),
    }
    show("Skips", best_of(contenders, rounds=6), "all skips, nothing to skip")


def fused(calibration: Calibration) -> None:
    """620 frames of packets to depth and nine bands."""
    shares, _, widths = expected_shares(instrument, 0.9)
    amplitudes = instrument.band_brightness()
    mean = amplitudes / amplitudes.sum() @ shares * 0.9 + 0.1 * widths
    codes_of = instrument.time_bins().codes
    contenders: dict[str, Callable[[], object]] = {}
    work = np.zeros(instrument.histogram_shape, np.uint16)
    for occupancy in (0.3, 0.95):
        shape = (FRAMES, *instrument.image_shape)
        codes = rng.choice(codes_of.astype(np.uint16), shape, p=mean / mean.sum())
        codes[rng.random(shape, np.float32) >= occupancy] = 0
        packets = packets_of(iter(codes))
        name = f"occupancy {occupancy}"
        for threads in (1, 2):
            contenders[f"{name}, counts only, {threads} threads"] = (
                lambda data=packets, threads=threads: accumulate(
                    data, instrument, out=emptied(work), threads=threads
                )
            )
            contenders[f"{name}, packets to image, {threads} threads"] = (
                lambda data=packets, threads=threads: reconstruct_packets(
                    data, calibration, out=work, threads=threads
                )
            )
    contenders["emptying the counters"] = lambda: work.fill(0)
    show("Packets to image (620 frames)", best_of(contenders, rounds=6), "emptying the counters")


def counted(calibration: Calibration, gate: float | None) -> None:
    """Instructions of the joint fit per pixel."""
    lights = {}
    for photons, background in ((PHOTONS, BACKGROUND), (100, 100)):
        flat = calibration.bins.in_time_order(drawn(photons, background)).reshape(PIXELS, -1)
        lights[f"{photons} + {background}"] = flat[:COUNTED]
    plan = tables_for_calibration(calibration, search_range_ns(calibration, None))
    instructions(lights, calibration.pixel_delay_ns.ravel()[:COUNTED], plan, gate=gate)


def emptied(counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The same memory, all zero."""
    counts.fill(0)
    return counts


SECTIONS = {"methods": methods, "skips": skips, "fused": fused}


def main() -> None:
    """Run the sections asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ", ".join([*SECTIONS, "instructions"])
    parser.add_argument("sections", nargs="*", help=names)
    parser.add_argument("--gate", type=float, help="most instructions of the fit for a pixel")
    parser.add_argument("--json", type=Path, help="file for `bench compare`")
    given = parser.parse_args()
    wanted = given.sections or list(SECTIONS)
    unknown = [name for name in wanted if name not in (*SECTIONS, "instructions")]
    if unknown:
        parser.error(f"no section {unknown[0]!r}; there are {names}")
    lanes = getattr(backend.compiled("fit"), "LANES", 1)
    kernel = f"{backend.describe()['fit']}, {lanes} lanes"
    print(f"kernel: {kernel}")
    calibration = calibrated()
    for name in wanted:
        if name == "instructions":
            counted(calibration, given.gate)
        else:
            SECTIONS[name](calibration)
    if given.json:
        save(given.json, measured, kernel=kernel)


if __name__ == "__main__":
    main()
