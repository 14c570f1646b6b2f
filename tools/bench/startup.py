# SPDX-License-Identifier: Apache-2.0
"""Measure what quick commands cost before they do anything.

    python tools/dev.py bench startup

Prints the CPU time (user and system) of fresh interpreters, the least of several runs, as a ratio
to the bare cost of importing NumPy and xarray in the same run.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import hueflight as hf
from hueflight import simulator
from hueflight.recording import RecordingWriter

REFERENCE = "import numpy, xarray"
COMMAND = "from hueflight.cli import main; main({words!r})"


def cpu_seconds(program: str) -> float:
    """CPU time of one fresh interpreter that runs a program."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", program], stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def record(path: Path) -> None:
    """Write a small recording."""
    instrument = hf.Instrument.load("paper")
    with RecordingWriter(path, instrument) as writer:
        for packet in simulator.simulate_packets("reference", instrument, frames=20):
            writer.write(packet)


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure what quick commands cost.")
    parser.add_argument("--runs", type=int, default=7, help="interpreters for each line")
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "scene.mcap"
        record(recording)
        programs = {
            "import numpy, xarray": REFERENCE,
            "python, nothing else": "pass",
            "import hueflight": "import hueflight",
            "hueflight --version": COMMAND.format(words=["--version"]),
            "hueflight --help": COMMAND.format(words=["--help"]),
            "hueflight info": COMMAND.format(words=["info", str(recording)]),
            "hf.reconstruct": "import hueflight as hf; hf.reconstruct",
        }
        least = dict.fromkeys(programs, float("inf"))
        for _ in range(runs):  # in turns, so that a busy moment hits all alike
            for name, program in programs.items():
                least[name] = min(least[name], cpu_seconds(program))
    reference = least["import numpy, xarray"]
    print(f"{'':<22} {'CPU s':>6} {'ratio':>6}")
    for name, seconds in least.items():
        print(f"{name:<22} {seconds:6.2f} {seconds / reference:6.2f}")


if __name__ == "__main__":
    main()
