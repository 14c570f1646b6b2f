# SPDX-License-Identifier: Apache-2.0
"""Damage recordings systematically, recover them, and count the outcomes.

    python3 tools/dev.py run python tools/fuzz/recordings.py --kills 1000

Prints the table of outcomes for docs/recordings.md: a small file is cut at every byte, each of its
bits is flipped, and a recording program is killed (SIGKILL) at random moments. Each time exactly
the packets that are intact in the files must be recovered, in order. After a kill these must
include all packets that the program had reported as safe.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np

from hueflight.errors import RecordingError
from hueflight.model.instrument import Instrument
from hueflight.recording import RecordingWriter, open_recording, recover
from hueflight_protocol import encode_frame

Row = tuple[str, int, Counter[str]]


def small_instrument() -> Instrument:
    """Return an instrument with one band and 8 × 8 pixels, whose files are mostly packets."""
    paper = Instrument.load("paper")
    sensor = msgspec.structs.replace(
        paper.sensor, rows=8, cols=8, detection_wavelength_nm=(), detection_probability=()
    )
    return paper.replace(sensor=sensor, lens=None, bands=paper.bands[:1], description="")


def frames(count: int) -> list[bytes]:
    """Return packets with different codes each."""
    rng = np.random.default_rng(0)
    codes = rng.integers(0, 512, (count, 8, 8)) * (rng.random((count, 8, 8)) < 0.4)
    return [encode_frame(c, sequence=i, frame=i, timestamp=i) for i, c in enumerate(codes)]


def packets_in(path: Path) -> list[bytes]:
    """Return all frame packets of a recording."""
    with open_recording(path) as recording:
        return list(recording.packets())


def outcome_of(octets: bytes, packets: list[bytes], folder: Path) -> str:
    """Recover one damaged file; exit unless exactly its intact packets are recovered."""
    path = folder / "try.mcap"
    path.write_bytes(octets)
    result = recover(path, overwrite=True, instrument=small_instrument())
    kept = packets_in(result.path) if result.path else []
    if kept != [packet for packet in packets if packet in octets]:
        raise SystemExit(f"recovered {len(kept)} packets, not exactly the intact ones: {path}")
    try:
        read = packets_in(path)
    except RecordingError:
        return f"{result.outcome.name.lower()}, refused by open_recording"
    rest = iter(packets)
    if not all(packet in rest for packet in read):
        raise SystemExit(f"open_recording returns packets that were never recorded: {path}")
    return f"{result.outcome.name.lower()}, opened"


def damage(name: str, files: Iterable[bytes], packets: list[bytes], folder: Path) -> Row:
    """Count the outcomes for many damaged files."""
    outcomes = Counter(outcome_of(octets, packets, folder) for octets in files)
    return name, outcomes.total(), outcomes


def flipped(octets: bytes, step: int) -> Iterable[bytes]:
    """Yield the file with one bit flipped, for every `step`-th bit."""
    for bit in range(0, 8 * len(octets), step):
        changed = bytearray(octets)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)


def record(path: Path, packets: list[bytes], pipe: int) -> None:
    """Record without end, and report after each packet how many are safe."""
    with RecordingWriter(
        path, small_instrument(), segment_bytes=200_000, chunk_bytes=3000
    ) as writer:
        while True:
            for packet in packets:
                writer.write(packet)
                os.write(pipe, writer.frames.to_bytes(8, "little"))


def kill_once(folder: Path, packets: list[bytes], reports: int) -> str:
    """Kill a recording after a number of reports; exit unless all safe packets are recovered."""
    shutil.rmtree(folder, ignore_errors=True)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            record(folder / "run.mcap", packets, writer)
        finally:
            os._exit(1)
    os.close(writer)
    received, last = 0, b""
    while received < 8 * reports:
        more = os.read(reader, 1 << 12)
        if not more:
            raise SystemExit("the recording ended by itself")
        received, last = received + len(more), (last + more)[-8:]
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while more := os.read(reader, 1 << 16):
        last = (last + more)[-8:]
    os.close(reader)
    safe = int.from_bytes(last, "little")
    if not folder.exists() or not list(folder.iterdir()):
        if safe:
            raise SystemExit("frames were reported as safe, but there is no file")
        return "no file yet"
    result = recover(folder / "run.mcap", instrument=small_instrument())
    kept = packets_in(result.path) if result.path else []
    if len(kept) < safe or any(p != packets[i % len(packets)] for i, p in enumerate(kept)):
        raise SystemExit(
            f"{safe} frames were reported as safe, but {len(kept)} or other ones were recovered"
        )
    return result.outcome.name.lower()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000, help="number of recordings to kill")
    parser.add_argument("--bit-step", type=int, default=1, help="flip only every N-th bit")
    parser.add_argument("--byte-step", type=int, default=1, help="cut only at every N-th byte")
    arguments = parser.parse_args()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        packets = frames(4)
        with RecordingWriter(folder / "run.mcap", small_instrument(), chunk_bytes=250) as writer:
            for packet in packets:
                writer.write(packet)
        octets = (folder / "run.mcap").read_bytes()
        cuts = (octets[:n] for n in range(0, len(octets), arguments.byte_step))
        rows.append(damage(f"cut at a byte (file of {len(octets)})", cuts, packets, folder))
        flips = flipped(octets, arguments.bit_step)
        rows.append(damage("one bit flipped", flips, packets, folder))
        rng, many = random.Random(1), frames(64)
        killed = Counter(
            kill_once(folder / "killed", many, rng.randrange(2500)) for _ in range(arguments.kills)
        )
        rows.append(("killed while recording", killed.total(), killed))
    print("| damage | number | outcome of recovery |\n|---|---|---|")
    for title, times, outcomes in rows:
        counted = "; ".join(f"{count} {what}" for what, count in outcomes.most_common())
        print(f"| {title} | {times} | {counted} |")


if __name__ == "__main__":
    main()
