# SPDX-License-Identifier: Apache-2.0
"""Few photons per pixel, and interleaved schedules: accuracy, speed and pictures.

    python3 tools/dev.py bench few_photons                    all of it, some minutes
    python3 tools/dev.py bench few_photons scene speed        some sections
    python3 tools/dev.py bench few_photons scene --write      tables and pictures into docs/

Sections: scene (the paper's Fig. 1, simulated), speed, ranges (of schedules), schedules (mislocks
on the whole circle, some minutes), face (real photons of a mannequin's face, from
../shared/data/photons where that lies beside the project).
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import msgspec
import numpy as np
from _face import FACE, face_depths
from _measure import best_of, table
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

import hueflight as hf
from hueflight import simulator
from hueflight.model.schedules import Schedule, ambiguity, design_schedules, unambiguous_range
from hueflight.reconstruction.bounds import expected_shares
from hueflight.reconstruction.quality import Quality
from hueflight.simulator import CaptureKind

mpl.use("agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parent.parent.parent
DOCS = ROOT / "docs"
KEPT = ROOT / "out" / "few-photons-calibration.zarr"
FRAMES = 10
SIGNAL, BACKGROUND = 3.0, 0.3  #: mean photons per pixel in so many frames
BAND = 7  #: 445 nm
EDGE_PIXELS = 3
COLOURS = {
    "white": (1, 1, 1, 1, 1, 1, 1, 1, 1),
    "red": (1, 1, 0.9, 0.5, 0.1, 0.05, 0.05, 0.05, 0.05),
    "green": (0.05, 0.05, 0.1, 0.3, 1, 0.7, 0.1, 0.05, 0.05),
    "blue": (0.03, 0.03, 0.03, 0.03, 0.05, 0.3, 1, 1, 0.8),
    "yellow": (1, 1, 1, 0.9, 0.6, 0.2, 0.05, 0.05, 0.05),
    **{f"only band {band}": tuple(np.eye(9)[band]) for band in range(9)},
}
CIRCLE = 320 * 0.299792458 / 2  #: metres that a period of 320 ns holds


# -- the paper's Fig. 1 -----------------------------------------------------------------------


class Fig1:
    """The simulated scene, its truth, and a calibration as a lab would take it."""

    def __init__(self) -> None:
        self.instrument = hf.Instrument.load("paper")
        self.scene = simulator.scene("fig1", self.instrument)
        plain = simulator.SimulationSettings()
        self.calibration = self._calibrated(plain)
        self.usable = self.calibration.usable
        self.settings = self._dimmed(plain)
        reference = simulator.scene("plane", self.instrument, distance=0.4)
        white = simulator.expected_rates(reference, self.instrument, plain).photons
        seen = simulator.expected_rates(self.scene, self.instrument, self.settings).photons
        self.reflectance = np.divide(seen, white, out=np.zeros_like(seen), where=white > 0)
        self.depth = self.scene.depth
        size = 2 * EDGE_PIXELS + 1
        self.edge = maximum_filter(self.depth, size) - minimum_filter(self.depth, size) > 0.01

    def _calibrated(self, settings: simulator.SimulationSettings) -> hf.Calibration:
        """As a lab would take it; kept, so that another run need not wait for it."""
        if KEPT.exists():
            kept = hf.Calibration.load(KEPT)
            kept.require(self.instrument)
            return kept

        def shot(kind: CaptureKind, frames: int) -> NDArray[np.unsignedinteger]:
            return simulator.simulate_capture(
                kind, self.instrument, frames=frames, settings=settings, seed=1
            )

        calibration = hf.calibrate(
            shot("reference", 4000),
            self.instrument,
            distance=0.4,
            bands=shot("bands", 400),
            dark=shot("dark", 2000),
            flat=shot("flat", 300),
        )
        KEPT.parent.mkdir(parents=True, exist_ok=True)
        calibration.save(KEPT)
        return calibration

    def _dimmed(self, settings: simulator.SimulationSettings) -> simulator.SimulationSettings:
        """Light so dim that few photons come back, and so much steady light."""
        signal, _ = self._means(settings)
        dim = settings.replace(
            white_detections=settings.white_detections * SIGNAL / FRAMES / signal, ambient=0.0
        )
        _, dark = self._means(dim)
        _, lit = self._means(dim.replace(ambient=1.0))
        return dim.replace(ambient=max(0.0, (BACKGROUND / FRAMES - dark) / (lit - dark)))

    def _means(self, settings: simulator.SimulationSettings) -> tuple[float, float]:
        """Mean photons of signal and background per exposure of a usable pixel."""
        rates = simulator.expected_rates(self.scene, self.instrument, settings)
        signal, background = rates.photons.sum(axis=0), rates.background
        return tuple(
            float(rates.periods * part[self.usable].mean()) for part in (signal, background)
        )  # type: ignore[return-value]

    def capture(self, frames: int, *, seed: int = 5) -> NDArray[np.unsignedinteger]:
        """Histogram of so many frames."""
        return simulator.simulate_histogram(
            self.scene, self.instrument, frames=frames, settings=self.settings, seed=seed
        )

    def errors(self, image) -> list[float]:
        """Depth RMSE, median (cm) away from edges, at edges, in all; error at 445 nm; share."""
        apart = 100 * np.abs(image.depth.values - self.depth)
        known = self.usable & np.isfinite(apart)
        found = []
        for where in (known & ~self.edge, known & self.edge, known):
            found += [float(np.sqrt(np.mean(apart[where] ** 2))), float(np.median(apart[where]))]
        blue, truth = image.reflectance.values[..., BAND], self.reflectance[BAND]
        seen = self.usable & np.isfinite(blue)
        error = np.sqrt(np.mean((blue - truth)[seen] ** 2) / np.mean(truth[seen] ** 2))
        return [*found, float(error), float(known.sum() / self.usable.sum())]


def scene(fig1: Fig1, write: bool) -> None:
    """Depth and reflectance from ten frames, beside the paper's method with many more."""
    rows, images = [], {}
    for method, frames, seeds in (
        ("pooled", FRAMES, (5, 6, 7)),
        ("paper", FRAMES, (5,)),
        ("paper", 30 * FRAMES, (5,)),
        ("paper", 50 * FRAMES, (5,)),
        ("paper", 100 * FRAMES, (5,)),
        ("paper", 400 * FRAMES, (5,)),
    ):
        shots = [
            hf.reconstruct(
                fig1.capture(frames, seed=seed),
                fig1.calibration,
                method=method,
                range_correction=False,
            )
            for seed in seeds
        ]
        images[method, frames] = shots[0]
        mean = np.mean([fig1.errors(shot) for shot in shots], axis=0)
        cells = [f"{rmse:.1f} ({middle:.1f})" for rmse, middle in mean[:6].reshape(3, 2)]
        name = f"`{method}`, {frames} frames" + (f", ×{frames // FRAMES}" if frames > 10 else "")
        rows.append([name, *cells, f"{mean[6]:.3f}", f"{mean[7]:.0%}"])
    head = ["method", "away from steps", "at steps", "everywhere", "445 nm", "with a depth"]
    publish("few-photons.md", "scene", table(head, rows), write)
    pooled = images["pooled", FRAMES]
    inside = np.abs(pooled.depth.values - fig1.depth) / pooled.depth_std.values
    known = fig1.usable & np.isfinite(pooled.depth.values)  # others state nothing
    away = known & ~fig1.edge
    blue = np.abs(pooled.reflectance.values[..., BAND] - fig1.reflectance[BAND])
    blue /= pooled.reflectance_std.values[..., BAND]
    widths = np.nanpercentile(pooled.resolution, [10, 50, 90])
    text = f"""\
Away from steps {100 * (inside[away] < 1).mean():.0f} % of the depths lie within one reported
standard deviation and {100 * (inside[away] < 1.96).mean():.0f} % within 1.96. Of the reflectances
at 445 nm, {100 * (blue[known] < 1).mean():.0f} % lie within one: `reflectance_std` is the
photon noise and does not include the blur of details. The effective resolution is
{widths[1]:.0f} pixels (10 % of the pixels below {widths[0]:.0f}, 10 % above {widths[2]:.0f}).
"""
    publish("few-photons.md", "coverage", text, write)
    if write:
        picture(fig1, images)


def picture(fig1: Fig1, images: dict) -> None:
    pooled, alone = images["pooled", FRAMES], images["paper", FRAMES]
    many = images["paper", 100 * FRAMES]
    blue = fig1.reflectance[BAND]
    panels = [
        ("truth", fig1.depth, blue),
        (f"paper's method, {FRAMES} frames", alone.depth, alone.reflectance[..., BAND]),
        (f"pooled, {FRAMES} frames", pooled.depth, pooled.reflectance[..., BAND]),
        (f"paper's method, {100 * FRAMES} frames", many.depth, many.reflectance[..., BAND]),
    ]
    figure, axes = plt.subplots(2, 5, figsize=(14, 4.6), layout="constrained")
    sensor = fig1.instrument.sensor
    pitch = (sensor.pixel_height_um or 1) / (sensor.pixel_width_um or 1)
    shown = lit = None
    for column, (title, depth, reflectance) in enumerate(panels):
        axes[0, column].set_title(title, fontsize=10)
        shown = axes[0, column].imshow(depth, vmin=0.6, vmax=1.1, cmap="viridis", aspect=pitch)
        lit = axes[1, column].imshow(
            reflectance, vmin=0, vmax=np.percentile(blue, 99), cmap="gray", aspect=pitch
        )
    assert shown is not None
    assert lit is not None
    axes[0, 4].set_title("effective resolution", fontsize=10)
    width = axes[0, 4].imshow(pooled.resolution, cmap="magma", vmin=0, aspect=pitch)
    figure.colorbar(shown, ax=axes[0, 3], label="depth / m")
    figure.colorbar(lit, ax=axes[1, 3], label="reflectance at 445 nm")
    figure.colorbar(width, ax=axes[0, 4], label="pixels")
    for axis in axes.ravel():
        axis.set_axis_off()
    figure.savefig(DOCS / "images" / "few-photons-scene.png", dpi=80)
    plt.close(figure)


def speed(fig1: Fig1, write: bool) -> None:
    """Pixels per second of the few-photon mode, beside the joint fit on the same counts."""
    counts = fig1.capture(FRAMES)

    def run(threads: int):
        return lambda: hf.reconstruct(counts, fig1.calibration, method="pooled", threads=threads)

    contenders = {
        "one thread": run(1),
        "two threads": run(2),
        "joint fit, one thread": lambda: hf.reconstruct(counts, fig1.calibration),
        "counts.sum()": lambda: counts.sum(axis=-1, dtype=np.float64),
    }
    seconds = best_of(contenders, rounds=7)
    pixels = fig1.usable.size
    rows = [
        [
            name,
            f"{1e3 * taken:.0f}",
            f"{pixels / taken / 1e6:.2f}",
            f"{1e3 * processor_seconds(contenders[name]):.0f}",
        ]
        for name, taken in seconds.items()
    ]
    head = ["", "ms", "Mpixel/s", "processor time, ms"]
    publish("few-photons.md", "speed", table(head, rows), write)


def processor_seconds(work: Callable[[], object]) -> float:
    """Least time that processors spend on it: what else the machine does hardly counts."""
    least = float("inf")
    for _ in range(5):
        start = time.process_time()
        work()
        least = min(least, time.process_time() - start)
    return least


# -- schedules --------------------------------------------------------------------------------


def small(schedule: Schedule) -> hf.Instrument:
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=16, cols=16)
    return schedule.applied_to(paper.replace(sensor=sensor, lens=None))


def drawn(
    instrument: hf.Instrument, depth: float, photons: float, colour, background: float, seed
) -> NDArray[np.uint32]:
    """Counts from the instrument's pulses themselves, as sharp in time as they are."""
    shares, _, widths = expected_shares(instrument, depth)
    amplitudes = instrument.band_brightness() * colour
    mean = amplitudes * (photons / amplitudes.sum()) @ shares + background * widths
    counts = np.zeros(instrument.histogram_shape, np.uint32)
    shape = (*instrument.image_shape, mean.size)
    counts[..., instrument.time_bins().codes] = np.random.default_rng(seed).poisson(mean, shape)
    counts[..., 0] = 10**6 - counts.sum(axis=-1)
    return counts


def mislocked(schedules: tuple[Schedule, ...], photons: float, share: float) -> list[str]:
    """Of pixels at five depths: wrong ones of colours of several bands, of one, of the worst."""
    instruments = [small(schedule) for schedule in schedules]
    calibrations = [calibrated(schedule) for schedule in schedules]
    parts = len(schedules)
    wrong, pixels, flagged, kept = [], 0, 0, 0
    for number, colour in enumerate(COLOURS.values()):
        here = 0
        for depth in (1.0, 7.3, 20.0, 33.7, 46.5):
            counts = [
                drawn(one, depth, photons / parts, colour, share * photons / parts, seed)
                for one, seed in zip(
                    instruments, [(number, int(10 * depth), i) for i in range(parts)], strict=True
                )
            ]
            if parts == 1:
                image = hf.reconstruct(
                    counts[0], calibrations[0], depth_range=(0.0, CIRCLE * (1 - 1e-9))
                )
            else:
                image = hf.reconstruct_interleaved(counts, calibrations)
            far = [
                np.abs((image[name].values - depth + CIRCLE / 2) % CIRCLE - CIRCLE / 2) > 1.9
                for name in ("depth", "other_depth")
            ]
            two = (image.quality.values & Quality.AMBIGUOUS) != 0
            here += int(far[0].sum())
            flagged += int(two.sum())
            kept += int((far[0] & two & ~far[1]).sum())
            pixels += image.depth.size
        wrong.append(here)
    share_wrong = np.array(wrong) * len(COLOURS) / pixels
    several = len(COLOURS) - len(instruments[0].bands)
    shown = share_wrong[:several].mean(), share_wrong[several:].mean(), share_wrong.max()
    return [
        *(f"{100 * value:.2f} %" for value in (*shown, flagged / pixels)),
        f"{kept} of {sum(wrong)}",
    ]


_calibrations: dict[Schedule, hf.Calibration] = {}


def calibrated(schedule: Schedule) -> hf.Calibration:
    if schedule not in _calibrations:
        instrument = small(schedule)
        white = drawn(instrument, 0.5, 20_000, np.ones(9), 0, len(_calibrations))
        _calibrations[schedule] = hf.calibrate(white, instrument, distance=0.5)
    return _calibrations[schedule]


def compared() -> dict[str, tuple[Schedule, ...]]:
    """Schedules to compare."""
    pair = design_schedules(9, period_ns=320.0)
    even = Schedule.of(hf.Instrument.load("paper"))
    return {"even, 30 ns": (even,), "designed, one": pair[:1], "designed, two in turn": pair}


def schedules(write: bool) -> None:
    """Mislocks on the whole circle of 48 m, by schedule, photons and background."""
    rows = []
    for name, used in compared().items():
        for photons, share in ((20, 0.1), (50, 0.1), (50, 0.5), (200, 0.1)):
            result = mislocked(used, photons, share)
            rows.append([name, str(photons), f"{100 * share:.0f} %", *result])
    head = [
        "schedule",
        "photons",
        "background",
        "several bands",
        "one band",
        "worst",
        "ambiguous",
        "kept",
    ]
    publish("schedules.md", "mislocks", table(head, rows), write)


def ranges(write: bool) -> None:
    """How far schedules range without ambiguity."""
    names = compared()
    rows = [
        [name, *(f"{unambiguous_range(*used, colours=n):.1f} m" for n in (1, 2, 3))]
        for name, used in names.items()
    ]
    head = ["schedule", "one colour", "two or more", "three or more"]
    publish("schedules.md", "ranges", table(head, rows), write)
    if write:
        schedule_picture(names)


def schedule_picture(names: dict[str, tuple[Schedule, ...]]) -> None:
    bands = hf.Instrument.load("paper").bands
    colours = ["#8b0000", "#e02020", "#ff5010", "#ffa000", "#20a020", "#00a0a0", "#2060ff",
               "#4030d0", "#8020c0"]  # fmt: skip
    figure, axes = plt.subplots(3, 2, figsize=(11, 6), layout="constrained", sharex="col")
    for row, (name, used) in enumerate(names.items()):
        for turn, schedule in enumerate(used):
            for band, delays in enumerate(schedule.delays_ns):
                axes[row, 0].bar(
                    list(delays), 0.8, width=8, bottom=-turn, color=colours[band],
                    label=f"{bands[band].wavelength_nm:.0f} nm" if row + turn == 0 else None,
                )  # fmt: skip
        axes[row, 0].set(title=name, yticks=[], xlim=(-6, 326))
        shifts_ns, partners = ambiguity(*used)
        axes[row, 1].fill_between(shifts_ns * 0.299792458 / 2, partners, step="mid", color="0.3")
        axes[row, 1].set(ylim=(0, 9.5), ylabel="bands that fit")
    figure.legend(loc="outside lower center", ncols=9, fontsize=8)
    axes[2, 0].set_xlabel("time within the period / ns")
    axes[2, 1].set_xlabel("wrong by / m")
    figure.savefig(DOCS / "images" / "schedules.png", dpi=80)
    plt.close(figure)


# -- a real face ------------------------------------------------------------------------------


def face(write: bool) -> None:
    """Real photons of a mannequin's face, beside the log-matched filter."""
    if not FACE.exists():
        print("face: the real photons are not beside the project (../shared/data/photons)")
        return
    alone, pooled, photons = face_depths()
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained")
    titles = "log-matched filter, each pixel alone", "pooled", "effective resolution"
    for axis, title, values in zip(
        axes, titles, (alone, pooled.depth, pooled.resolution), strict=True
    ):
        depth = "resolution" not in title
        limits = {"vmin": 0.21, "vmax": 0.37} if depth else {"vmin": 0}
        shown = axis.imshow(values, cmap="viridis" if depth else "magma", **limits)
        figure.colorbar(shown, ax=axis, label="relative depth / m" if depth else "pixels")
        axis.set(title=title)
        axis.set_axis_off()
    if write:
        figure.savefig(DOCS / "images" / "few-photons-face.png", dpi=80)
    plt.close(figure)
    # how rough is either: the median step between neighbours
    rough = [
        1e3 * float(np.nanmedian(np.abs(np.diff(np.asarray(values), axis=1))))
        for values in (alone, pooled.depth)
    ]
    text = (
        f"{photons:.1f} photons a pixel on average. Median step between neighbouring pixels: "
        f"{rough[0]:.1f} mm by the log-matched filter, {rough[1]:.2f} mm pooled.\n"
    )
    publish("few-photons.md", "face", text, write)


# -- pages ------------------------------------------------------------------------------------


def publish(page: str, name: str, text: str, write: bool) -> None:
    """Print a result and put it into its place on a page."""
    print(f"\n{name}\n\n{text}")
    if not write:
        return
    path = DOCS / page
    start, end = f"<!-- {name}: written by tools/bench/few_photons.py -->", f"<!-- end {name} -->"
    old = path.read_text("utf-8")
    new, count = re.subn(
        f"{re.escape(start)}.*?{re.escape(end)}",
        lambda _: f"{start}\n\n{text}\n{end}",
        old,
        flags=re.DOTALL,
    )
    if count != 1:
        raise SystemExit(f"{path} has {count} places for {name!r}: one is needed")
    path.write_text(new, "utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    sections = ("scene", "speed", "ranges", "schedules", "face")
    parser.add_argument("sections", nargs="*", help=", ".join(sections))
    parser.add_argument("--write", action="store_true", help="tables and pictures into docs/")
    arguments = parser.parse_args()
    chosen = arguments.sections or sections
    if unknown := set(chosen) - set(sections):
        raise SystemExit(f"no section {', '.join(sorted(unknown))}: there are {sections}")
    fig1 = Fig1() if {"scene", "speed"} & set(chosen) else None
    if fig1 and "scene" in chosen:
        scene(fig1, arguments.write)
    if fig1 and "speed" in chosen:
        speed(fig1, arguments.write)
    if "ranges" in chosen:
        ranges(arguments.write)
    if "schedules" in chosen:
        schedules(arguments.write)
    if "face" in chosen:
        face(arguments.write)


if __name__ == "__main__":
    main()
