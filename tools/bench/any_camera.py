# SPDX-License-Identifier: Apache-2.0
"""Time and memory that captures of cameras other than the paper's take.

    python3 tools/dev.py bench any_camera                  all rows, about two minutes
    python3 tools/dev.py bench any_camera lasers pixel     some rows
    python3 tools/dev.py bench any_camera --write          also write docs/results/any-camera.inc

Captures are drawn from the nominal pulses of an instrument and stored in files. Each row runs in a
process of its own, on one thread, so that CPU time and peak memory are its own: interpreter,
libraries and counts included. The reference is reading the same counts and adding them up with
NumPy, in the same process. Processes of the rows `large` can't allocate more than the limit that
is stated (RLIMIT_AS), which is less than the file of counts.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import zarr
from _measure import table

import hueflight as hf
from hueflight.model.instrument import Band, Sensor, Timing
from hueflight.numerical_threads import ONE_THREAD
from hueflight.reconstruction.bounds import expected_shares

RESULT = Path(__file__).resolve().parents[2] / "docs" / "results" / "any-camera.inc"
SIDES = (256, 512, 1024)  #: pixels along each side of the large sensors
LIMIT = 2_000_000_000  #: bytes of address space for them; the file of the largest has 2.15e9
DRAWN_ROWS = 32  #: of large sensors, repeated
CAPTURES = 200  #: of the nine-zone sensor
EXPOSURES = 50_000  #: where empty ones are counted: pile-up is small


def laser(number: int, delay_ns: float, fwhm_ns: float) -> Band:
    """One band."""
    return Band(
        name=f"laser {number}", wavelength_nm=450 + 100 * number, delay_ns=delay_ns,
        pulse_fwhm_ns=fwhm_ns,
    )  # fmt: skip


def four_lasers() -> hf.Instrument:
    """Codes of 14 bits and 50 ps."""
    return hf.Instrument(
        name="four lasers",
        sensor=Sensor(rows=32, cols=64, code_bits=14, bin_width_ns=0.05),
        timing=Timing(period_ns=800),
        bands=tuple(laser(number, 10 + 200 * number, 0.35) for number in range(4)),
    )


def one_pixel() -> hf.Instrument:
    """A single shot of 1024 bins."""
    sensor = Sensor(rows=1, cols=1, code_bits=10, bin_width_ns=0.05)
    return hf.Instrument(name="one pixel", sensor=sensor, bands=(laser(0, 5, 0.3),))


def nine_zones() -> hf.Instrument:
    """A ranging module whose reference pulse is at distance 0."""
    sensor = Sensor(rows=3, cols=3, code_bits=7, bin_width_ns=0.1)
    return hf.Instrument(name="nine zones", sensor=sensor, bands=(laser(0, 2, 0.3),))


def large(side: int) -> hf.Instrument:
    """Codes and LEDs of the paper."""
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=side, cols=side)
    return paper.replace(sensor=sensor, lens=None)


@dataclass(frozen=True)
class Setting:
    """Files of an instrument, and where its targets are."""

    instrument: hf.Instrument
    distance: float
    depth: float
    photons: tuple[float, float]  #: of reference and scene, a pixel
    dtype: str = "u2"

    def draw(self, folder: Path) -> None:
        """Write reference.npy and scene.zarr."""
        for seed, (name, away, light) in enumerate(
            (("reference", self.distance, self.photons[0]), ("scene", self.depth, self.photons[1]))
        ):
            shape = rows, cols, _ = self.instrument.histogram_shape
            few = min(rows, DRAWN_ROWS)
            shares, _, widths = expected_shares(self.instrument, away)
            brightness = self.instrument.band_brightness()
            mean = light * (brightness / brightness.sum()) @ shares + 0.1 * light * widths
            bins = self.instrument.time_bins()
            block = np.zeros((few, cols, shape[2]), self.dtype)
            drawn = np.random.default_rng(seed).poisson(mean, (few, cols, bins.count))
            block[..., bins.codes] = drawn
            if self.instrument.sensor.reports_empty:
                block[..., 0] = EXPOSURES - drawn.sum(axis=-1)
            stored: Any
            if name == "scene":  # not mapped: pages of files would count as memory
                stored = zarr.create_array(
                    folder / "scene.zarr", shape=shape, dtype=self.dtype, compressors=None,
                    chunks=(few, *shape[1:]),
                )  # fmt: skip
            else:
                stored = np.lib.format.open_memmap(
                    folder / "reference.npy", "w+", np.dtype(self.dtype), shape
                )
            for row in range(0, rows, few):
                stored[row : row + few] = block


SETTINGS = {
    "lasers": lambda: Setting(four_lasers(), 1.0, 3.0, (20_000, 2000)),
    "pixel": lambda: Setting(one_pixel(), 1.0, 2.0, (20_000, 2000)),
    "zones": lambda: Setting(nine_zones(), 0.0, 0.5, (100_000, 20_000), "u4"),
    **{
        f"large-{side}": lambda side=side: Setting(large(side), 0.4, 0.9, (2000, 600), "u4")
        for side in SIDES
    },
}


@contextmanager
def measured(into: dict[str, float], name: str) -> Iterator[None]:
    """Note the CPU seconds of a block."""
    start = time.process_time()
    yield
    into[name] = time.process_time() - start


def peak_mb() -> float:
    """Largest resident memory of this process so far (of Linux).

    The figure of getrusage would be at least what the starting process had.
    """
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e6


def deviation(image: Any, depth: float) -> dict[str, float]:
    """How far the depths are from the truth, and how far they say they are, in mm."""
    away = 1000 * np.abs(image["depth"].values - depth)
    stated = 1000 * image["depth_std"].values
    return {"error_mm": float(np.nanmedian(away)), "stated_mm": float(np.nanmedian(stated))}


def first_image(setting: Setting, folder: Path) -> dict[str, float]:
    """Calibrate and reconstruct, as the first thing that a process does."""
    found: dict[str, float] = {}
    with measured(found, "calibrate"):
        calibration = hf.calibrate(
            np.load(folder / "reference.npy"), setting.instrument, distance=setting.distance
        )
    with measured(found, "reconstruct"):
        counts: Any = zarr.open_array(folder / "scene.zarr", mode="r")
        image = hf.reconstruct(counts[...], calibration)
    found["peak_mb"] = peak_mb()
    with measured(found, "read"):
        np.load(folder / "reference.npy").sum(axis=-1, dtype=np.uint64)
        counts[...].sum(axis=-1, dtype=np.uint64)
    return found | deviation(image, setting.depth)


def many_captures(setting: Setting, folder: Path) -> dict[str, float]:
    """Calibrate anew for each capture, in one process."""
    found: dict[str, float] = {}
    reference = np.load(folder / "reference.npy")
    scene = np.asarray(zarr.open_array(folder / "scene.zarr", mode="r")[...])
    image = None
    with measured(found, "all"):
        for _ in range(CAPTURES):
            calibration = hf.calibrate(reference, setting.instrument, distance=setting.distance)
            image = hf.reconstruct(scene, calibration)
    found["peak_mb"] = peak_mb()
    with measured(found, "read"):
        for _ in range(CAPTURES):
            reference.sum(axis=-1), scene.sum(axis=-1)
    return found | deviation(image, setting.depth)


def calibrate_large(setting: Setting, folder: Path) -> dict[str, float]:
    """Make and save a calibration."""
    found: dict[str, float] = {}
    with measured(found, "calibrate"):
        reference = np.load(folder / "reference.npy", mmap_mode="r")
        hf.calibrate(reference, setting.instrument, distance=setting.distance).save(
            folder / "calibration.zarr"
        )
    return found | {"peak_mb": peak_mb()}


def reconstruct_large(setting: Setting, folder: Path) -> dict[str, float]:
    """Reconstruct counts that stay on disk, with less memory than they have."""
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT, LIMIT))
    found: dict[str, float] = {}
    counts: Any = zarr.open_array(folder / "scene.zarr", mode="r")
    with measured(found, "reconstruct"):
        calibration = hf.Calibration.load(folder / "calibration.zarr")
        image = hf.reconstruct(counts, calibration)
    found |= {"peak_mb": peak_mb(), "file_mb": counts.nbytes / 1e6}
    with measured(found, "read"):
        for row in range(0, counts.shape[0], DRAWN_ROWS):
            counts[row : row + DRAWN_ROWS].sum(axis=-1, dtype=np.uint64)
    return found | deviation(image, setting.depth)


STEPS: dict[str, Callable[[Setting, Path], dict[str, float]]] = {
    "first image": first_image,
    "many captures": many_captures,
    "calibrate": calibrate_large,
    "reconstruct": reconstruct_large,
}


def alone(step: str, name: str, folder: Path) -> dict[str, float]:
    """Run a step in a process of its own and return what it measured."""
    command = [sys.executable, __file__, "--step", step, "--folder", str(folder), name]
    environment = os.environ | ONE_THREAD
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=environment)
    return json.loads(done.stdout)


def lasers(folder: Path) -> list[list[str]]:
    """64 × 32 pixels, 16 384 codes."""
    got = alone("first image", "lasers", folder)
    seconds = got["calibrate"] + got["reconstruct"]
    return [
        row("64 × 32, 14 bits of 50 ps, 4 lasers of 0.35 ns: CPU time of calibrate + reconstruct",
            f"{seconds:.1f} s", "30 s, 10 s", seconds / got["read"], got),
        row("the same: peak memory", f"{got['peak_mb']:.0f} MB", "1500 MB, 600 MB", None, got),
    ]  # fmt: skip


def pixel(folder: Path) -> list[list[str]]:
    """One pixel, 1024 bins."""
    got = alone("first image", "pixel", folder)
    seconds = got["calibrate"] + got["reconstruct"]
    return [
        row("one pixel, 1024 bins of 0.05 ns: CPU time to the first image", f"{seconds:.2f} s",
            "1 s, 0.2 s", seconds / got["read"], got)
    ]  # fmt: skip


def zones(folder: Path) -> list[list[str]]:
    """Nine zones, a new reference each time."""
    got = alone("many captures", "zones", folder)
    rate = CAPTURES / got["all"]
    return [
        row(f"nine zones, a new reference with each of {CAPTURES} captures: per second of CPU time",
            f"{rate:.0f}", "20, 100", got["all"] / got["read"], got)
    ]  # fmt: skip


def many_pixels(folder: Path) -> list[list[str]]:
    """Large sensors with the paper's codes."""
    rows = []
    for side in SIDES:
        place = folder / str(side)
        place.mkdir()
        SETTINGS[f"large-{side}"]().draw(place)
        made = alone("calibrate", f"large-{side}", place)
        got = alone("reconstruct", f"large-{side}", place)
        about = f"{side} × {side}, counts of {got['file_mb']:.0f} MB on disk"
        seconds = got["reconstruct"]
        rows += [
            row(f"{about}: reconstruct, CPU time and peak memory",
                f"{seconds:.1f} s, {got['peak_mb']:.0f} MB", "runs, linear",
                seconds / got["read"], got),
            row("the same: calibrate and save",
                f"{made['calibrate']:.0f} s, {made['peak_mb']:.0f} MB", "",
                made["calibrate"] / got["read"], None),
        ]  # fmt: skip
    return rows


ROWS = {"lasers": lasers, "pixel": pixel, "zones": zones, "large": many_pixels}


def row(
    what: str, figure: str, wanted: str, times: float | None, got: dict[str, float] | None
) -> list[str]:
    """A line of the table."""
    depth = "" if got is None else f"{got['error_mm']:.2g}, stated {got['stated_mm']:.2g} mm"
    return [what, figure, wanted, "" if times is None else f"{times:.0f}", depth]


def main() -> None:
    """Measure the rows asked for, or one step of one row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", help=", ".join(ROWS))
    parser.add_argument("--write", action="store_true", help=f"also write {RESULT.name}")
    parser.add_argument("--step", choices=STEPS, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.step:
        print(json.dumps(STEPS[given.step](SETTINGS[given.rows[0]](), given.folder)))
        return
    wanted = given.rows or list(ROWS)
    unknown = [name for name in wanted if name not in ROWS]
    if unknown:
        parser.error(f"no row {unknown[0]!r}; there are {', '.join(ROWS)}")
    lines = []
    for name in wanted:
        with tempfile.TemporaryDirectory() as folder:
            if name in SETTINGS:
                SETTINGS[name]().draw(Path(folder))
            lines += ROWS[name](Path(folder))
    head = ["", "measured", "at least, aim", "× reading", "median error of depth"]
    text = f"`python3 tools/dev.py bench any_camera`\n\n{table(head, lines)}"
    print(text)
    if given.write:
        RESULT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
