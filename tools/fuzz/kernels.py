# SPDX-License-Identifier: Apache-2.0
"""Fuzz the compiled kernels with libFuzzer, AddressSanitizer and UndefinedBehaviorSanitizer.

    python3 tools/dev.py run python tools/fuzz/kernels.py --seconds 60

This needs clang. A run starts from intact packets and tools/fuzz/corpus.zip; with ``--inputs`` it
also starts from the inputs in a folder, to which it adds new ones. ``--minimize`` then stores in
corpus.zip the smallest set of inputs with the coverage of all. A failure ends the run with the
input that caused it and a stack trace.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from hueflight_protocol import Event, PacketHeader, encode_event, encode_frame

ROOT = Path(__file__).resolve().parent.parent.parent
SOURCE = Path(__file__).with_suffix(".c")
HEADERS = ROOT / "host" / "hueflight" / "ingest" / "_c"
CORPUS = SOURCE.with_name("corpus.zip")
BUILD = ROOT / "build" / "fuzz"
LONGEST = 4096  # largest size of an input in bytes
# as in kernels.c
GEOMETRIES = [(1, 1, 1), (3, 5, 9), (8, 8, 9), (1, 2, 13), (10, 13, 8), (5, 64, 7), (32, 32, 4)]
GEOMETRIES += [(256, 8, 2)]
OPTIONS = (1, 2 | 4, 8, 1 | 2 | 4 | 8)


def build() -> Path:
    """Compile the fuzz target and return the program."""
    if shutil.which("clang") is None:
        raise SystemExit("clang, which contains libFuzzer, was not found: install clang")
    BUILD.mkdir(parents=True, exist_ok=True)
    program = BUILD / "fuzz-kernels"
    sanitizers = ["-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all"]
    unsafe = "-DFUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION"  # accepts every CRC
    command = [
        "clang",
        "-gline-tables-only",
        "-O1",
        unsafe,
        *sanitizers,
        f"-I{HEADERS}",
        str(SOURCE),
    ]
    subprocess.run([*command, "-o", str(program)], check=True)
    return program


def write_seeds(folder: Path) -> None:
    """Write streams of intact packets, from which the fuzzer starts."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    number = 0
    for which, (rows, cols, code_bits) in enumerate(GEOMETRIES):
        for occupancy in (0.0, 0.1, 0.6, 1.0):
            for run in (8, 64, 512):
                packets = [encode_event(Event(PacketHeader(sequence=9), code=5))]
                for frame in range(3):
                    codes = rng.integers(1, 1 << code_bits, (rows, cols), endpoint=code_bits == 1)
                    codes[rng.random((rows, cols)) >= occupancy] = 0
                    codes &= (1 << code_bits) - 1
                    abort_at = 0 if frame == 1 and run == 8 else None
                    packets.append(
                        encode_frame(
                            codes,
                            sequence=frame,
                            frame=frame,
                            timestamp=frame,
                            code_bits=code_bits,
                            run=run,
                            abort_at=abort_at,
                        )
                    )
                head = bytes([which, OPTIONS[number % 4], number % 7, number % 16])
                data = head + b"".join(packets)
                if len(data) <= LONGEST:
                    (folder / f"seed-{number:02}").write_bytes(data)
                    number += 1


def fuzz(program: Path, found: Path, seconds: int, minimize: bool) -> None:
    """Fuzz for a number of seconds, then store the smallest sufficient corpus if asked to."""
    write_seeds(found)
    if CORPUS.exists():
        with ZipFile(CORPUS) as kept:
            kept.extractall(found)
    limits = [f"-max_len={LONGEST}", "-use_value_profile=1", "-print_final_stats=1"]
    if seconds:
        time = f"-max_total_time={seconds}"
        artifacts = f"-artifact_prefix={BUILD}/"
        command = [program, time, *limits, artifacts, found]
        subprocess.run([str(word) for word in command], check=True)
    if minimize:
        fresh = BUILD / "minimal"
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir()
        command = [program, "-merge=1", limits[0], fresh, found]
        subprocess.run([str(word) for word in command], check=True)
        files = sorted(fresh.iterdir())
        with ZipFile(CORPUS, "w", ZIP_DEFLATED) as kept:
            for file in files:
                kept.writestr(ZipInfo(file.name), file.read_bytes(), ZIP_DEFLATED)
        print(f"{len(files)} inputs stored in {CORPUS}, {CORPUS.stat().st_size} bytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--seconds", type=int, default=60, help="duration of the run in seconds; 0 only minimizes"
    )
    parser.add_argument("--inputs", type=Path, help="folder of inputs to start from and to add to")
    parser.add_argument(
        "--minimize",
        action="store_true",
        help="store the smallest sufficient set of inputs in corpus.zip",
    )
    arguments = parser.parse_args()
    program = build()
    if arguments.inputs is None:
        with tempfile.TemporaryDirectory() as folder:
            fuzz(program, Path(folder), arguments.seconds, arguments.minimize)
    else:
        fuzz(program, arguments.inputs, arguments.seconds, arguments.minimize)


if __name__ == "__main__":
    main()
