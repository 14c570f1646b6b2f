# SPDX-License-Identifier: Apache-2.0
"""Benchmarks of ingest and recording, each beside a reference in the same run.

    python3 tools/dev.py bench ingest                  all of it, about two minutes
    python3 tools/dev.py bench ingest kernels growth   some sections
    python3 tools/dev.py bench ingest instructions --gate 6
    python3 tools/dev.py bench ingest paced --seconds 600 --plot docs/images/ingest-paced.svg

Real time (RT) is the paper's chip at full rate: 18 600 frames of 24 576 pixels per second.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from _live import live, paced, recording
from _measure import (
    PIXELS,
    REAL_TIME,
    best_of,
    packets_of,
    per_pixel,
    table,
    uniform_codes,
)

from hueflight.ingest import accumulate
from hueflight.ingest.kernels import available
from hueflight.model.instrument import Instrument

ROOT = Path(__file__).resolve().parent.parent.parent
FRAMES = 620  # one picture of thirty per second
OCCUPANCIES = (0.05, 0.3, 0.7, 1.0)


def instrument_of(rows: int, cols: int) -> Instrument:
    """The paper's instrument with another geometry."""
    paper = Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=rows, cols=cols)
    return paper.replace(sensor=sensor, lens=None)


def kernels() -> None:
    """Packets to histogram: scan, CRC and counting, against plain ways to count."""
    paper = Instrument.load("paper")
    backends = available()
    pixels = FRAMES * PIXELS
    rows = []
    for occupancy in OCCUPANCIES:
        codes = np.stack(list(uniform_codes(FRAMES, 192, 128, occupancy)))
        packets = packets_of(iter(codes))
        counts = np.zeros(paper.histogram_shape, np.uint16)
        index = (np.arange(PIXELS) * 512 + codes.reshape(FRAMES, -1)).astype(np.int64)
        hits = index[codes.reshape(FRAMES, -1) > 0]
        flat = np.zeros(PIXELS * 512, np.uint16)
        space = bytearray(len(packets))

        def count(name: str, threads: int = 1) -> Callable[[], object]:
            def run() -> None:  # adds to the same counts, which are emptied in between
                accumulate(packets, paper, out=counts, threads=threads, kernels=backends[name])  # noqa: B023

            return run

        contenders: dict[str, Callable[[], object]] = {
            "numpy": count("numpy"),
            "bincount": lambda: np.bincount(index.reshape(-1), minlength=PIXELS * 512),  # noqa: B023
            "bincount, hits": lambda: np.bincount(hits, minlength=PIXELS * 512),  # noqa: B023
            # a 1 of another type than the counts would take fifty times as long
            "add.at": lambda: np.add.at(flat, index.reshape(-1), np.uint16(1)),  # noqa: B023
            "memcpy": lambda: space.__setitem__(slice(None), packets),  # noqa: B023
            "empty counts": lambda: counts.fill(0),  # noqa: B023
        }
        if "c" in backends:
            contenders = {"c, 1 thread": count("c"), "c, 2 threads": count("c", 2)} | contenders
        best = best_of(contenders)
        ours = best.get("c, 1 thread", best["numpy"])
        rows += [
            [
                f"{occupancy}",
                name,
                per_pixel(best[name], pixels),
                f"{best[name] / ours:.2f}",
            ]
            for name in best
            if name != "empty counts"
        ]
    print("## Packets to histogram (620 frames, CRC included)\n")
    print(table(["occupancy", "how", "best of 9", "time against one thread of C"], rows))


def growth() -> None:
    """The cost of a pixel over sensor size and number of frames."""
    rows = []
    shapes = ((192, 128, 62), (192, 128, 620), (192, 128, 2480), (512, 512, 256), (1024, 1024, 96))
    for height, width, frames in shapes:
        some = packets_of(uniform_codes(frames, height, width, 0.3))
        instrument = instrument_of(height, width)
        out = np.zeros(instrument.histogram_shape, np.uint16)
        best = best_of(
            {
                "count": lambda: accumulate(some, instrument, out=out, overflow="widen"),  # noqa: B023
                "empty": lambda: out.fill(0),  # noqa: B023
            }
        )
        pixels = frames * height * width
        rows.append([f"{height} × {width}", str(frames), per_pixel(best["count"], pixels)])
    print("## Growth with pixels and frames (occupancy .3)\n")
    print(table(["sensor", "frames", "best of 9, one thread"], rows))


def lacking() -> dict[str, bytes]:
    """Packets of full frames, and of frames that lack most of it."""
    full = list(uniform_codes(FRAMES, 192, 128, 1.0))

    def changed(change: Callable[[np.ndarray], np.ndarray]) -> bytes:
        return packets_of(change(frame.copy()) for frame in full)

    def rows_masked(frame: np.ndarray) -> np.ndarray:
        frame[: 192 * 95 // 100] = 0
        return frame

    def gated(frame: np.ndarray) -> np.ndarray:
        frame[frame > 10] = 0  # a gate of 10 codes in 498
        return frame

    return {
        "full frame": packets_of(iter(full)),
        "empty frame": changed(lambda frame: frame * 0),
        "95 % of the rows masked": changed(rows_masked),
        "98 % of the codes gated": changed(gated),
    }


def skips() -> None:
    """What a scene lacks is not paid for."""
    paper = Instrument.load("paper")
    streams = lacking()
    counts = np.zeros(paper.histogram_shape, np.uint16)

    def count(packets: bytes) -> Callable[[], object]:
        return lambda: accumulate(packets, paper, out=counts, overflow="saturate")

    best = best_of({name: count(packets) for name, packets in streams.items()})
    rows = [
        [
            name,
            f"{len(streams[name]) // FRAMES}",
            f"{best[name] / FRAMES * 1e6:.2f}",
            f"{best[name] / best['full frame']:.3f}",
        ]
        for name in streams
    ]
    print("## What is not there\n")
    print(table(["frames", "bytes per frame", "µs per frame", "of a full one"], rows))


def instructions(gate: float | None) -> None:
    """Instructions per pixel by callgrind, which are the same on every run."""
    if shutil.which("valgrind") is None or shutil.which("gcc") is None:
        print("instructions: need valgrind and gcc, which are not both here")
        if gate is not None:
            raise SystemExit(1)
        return
    rows = []
    worst = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program, stream = folder / "instructions", folder / "packets"
        source = Path(__file__).parent / "_instructions.c"
        include = f"-I{ROOT / 'host' / 'hueflight' / 'ingest' / '_c'}"
        subprocess.run(["gcc", "-O3", "-g", include, str(source), "-o", str(program)], check=True)
        for occupancy in (0.0, *OCCUPANCIES):
            stream.write_bytes(packets_of(uniform_codes(FRAMES, 192, 128, occupancy)))
            scan, count = (_collected(program, stream, f) for f in ("scan", "count"))
            if occupancy == 1.0:
                worst = count
            rows.append([f"{occupancy}", f"{scan:.2f}", f"{count:.2f}", f"{scan + count:.2f}"])
        lacks = {}
        for name, packets in lacking().items():
            stream.write_bytes(packets)
            lacks[name] = [_collected(program, stream, f) for f in ("scan", "count")]
    print("## Instructions per pixel (callgrind, 620 frames)\n")
    print(table(["occupancy", "scan and CRC", "count", "both"], rows))
    full = sum(lacks["full frame"])
    rows = [
        [name, f"{scan:.2f}", f"{count:.2f}", f"{(scan + count) / full:.3f}"]
        for name, (scan, count) in lacks.items()
    ]
    print(table(["frames", "scan and CRC", "count", "both, of a full one"], rows))
    if gate is not None and worst > gate:
        raise SystemExit(f"dense counting takes {worst:.2f} instructions per pixel, over {gate}")


def _collected(program: Path, stream: Path, function: str) -> float:
    out = stream.with_suffix(f".{function}")
    subprocess.run(
        [
            *("valgrind", "-q", "--tool=callgrind", f"--callgrind-out-file={out}"),
            f"--toggle-collect=measured_{function}*",
            *(str(program), str(stream), "192", "128", "9"),
        ],
        check=True,
        capture_output=True,
    )
    summary = next(line for line in out.read_text().splitlines() if line.startswith("summary:"))
    return int(summary.split()[1]) / (FRAMES * PIXELS)


def main() -> None:
    sections: dict[str, Callable[[], None]] = {
        "kernels": kernels,
        "growth": growth,
        "skips": skips,
        "instructions": lambda: instructions(arguments.gate),
        "live": live,
        "recording": recording,
    }
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sections", nargs="*", metavar="section", help=", ".join(sections))
    parser.add_argument("--gate", type=float, help="fail if dense counting takes more instructions")
    parser.add_argument("--seconds", type=float, default=600, help="of the paced run")
    parser.add_argument("--occupancy", type=float, default=0.3, help="of the paced run")
    parser.add_argument("--plot", type=Path, help="where to draw the paced run's memory")
    parser.add_argument("--record", type=Path, help="folder to record the paced run in")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.sections if name not in (*sections, "paced")]
    if unknown:
        parser.error(f"no section {unknown[0]!r}: one of {', '.join((*sections, 'paced'))}")
    print(f"Python {sys.version.split()[0]}, NumPy {np.__version__}")
    print(f"RT = {REAL_TIME:,} pixels per second\n")
    for name in arguments.sections or sections:
        if name == "paced":
            paced(arguments.seconds, arguments.occupancy, arguments.plot, arguments.record)
        else:
            sections[name]()


if __name__ == "__main__":
    main()
