"""Damage recordings in every way, recover, and count how it went.

    python3 tools/dev.py run python tools/fuzz/recordings.py --kills 1000

Writes the table of outcomes for docs/recordings.md: a small file cut at every byte and with each
of its bits flipped, and a recording program killed (SIGKILL) at random moments. After each, all
packets that are whole in the files must come back, in order, and nothing else; after a kill at
least those that the program had said to be safe.
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
    """One band and 8 × 8 pixels, so that a file has few bytes that are not packets."""
    paper = Instrument.load("paper")
    sensor = msgspec.structs.replace(
        paper.sensor, rows=8, cols=8, detection_wavelength_nm=(), detection_probability=()
    )
    return paper.replace(sensor=sensor, lens=None, bands=paper.bands[:1], description="")


def frames(count: int) -> list[bytes]:
    """Packets with codes of their own each."""
    rng = np.random.default_rng(0)
    codes = rng.integers(0, 512, (count, 8, 8)) * (rng.random((count, 8, 8)) < 0.4)
    return [encode_frame(c, sequence=i, frame=i, timestamp=i) for i, c in enumerate(codes)]


def packets_in(path: Path) -> list[bytes]:
    """All frame packets of a recording."""
    with open_recording(path) as recording:
        return list(recording.packets())


def outcome_of(octets: bytes, packets: list[bytes], folder: Path) -> str:
    """Recover from one damaged file; complain unless exactly what is whole in it comes back."""
    path = folder / "try.mcap"
    path.write_bytes(octets)
    result = recover(path, overwrite=True, instrument=small_instrument())
    kept = packets_in(result.path) if result.path else []
    if kept != [packet for packet in packets if packet in octets]:
        raise SystemExit(f"recovered {len(kept)} packets, not those that are there: {path}")
    try:
        read = packets_in(path)
    except RecordingError:
        return f"{result.outcome.name.lower()}, refused by open_recording"
    rest = iter(packets)
    if not all(packet in rest for packet in read):
        raise SystemExit(f"open_recording gives packets that were never recorded: {path}")
    return f"{result.outcome.name.lower()}, opened"


def damage(name: str, files: Iterable[bytes], packets: list[bytes], folder: Path) -> Row:
    """Count the outcomes of many damaged files."""
    outcomes = Counter(outcome_of(octets, packets, folder) for octets in files)
    return name, outcomes.total(), outcomes


def flipped(octets: bytes, step: int) -> Iterable[bytes]:
    """The file with one bit changed, for each bit."""
    for bit in range(0, 8 * len(octets), step):
        changed = bytearray(octets)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)


def record(path: Path, packets: list[bytes], tell: int) -> None:
    """Record without end, and say after each packet how many are safe."""
    with RecordingWriter(
        path, small_instrument(), segment_bytes=200_000, chunk_bytes=3000
    ) as writer:
        while True:
            for packet in packets:
                writer.write(packet)
                os.write(tell, writer.frames.to_bytes(8, "little"))


def kill_once(folder: Path, packets: list[bytes], words: int) -> str:
    """Kill a recording after it has said so much; complain unless what was safe comes back."""
    shutil.rmtree(folder, ignore_errors=True)
    listen, tell = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            record(folder / "run.mcap", packets, tell)
        finally:
            os._exit(1)
    os.close(tell)
    heard, last = 0, b""
    while heard < 8 * words:
        more = os.read(listen, 1 << 12)
        if not more:
            raise SystemExit("the recording ended by itself")
        heard, last = heard + len(more), (last + more)[-8:]
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while more := os.read(listen, 1 << 16):
        last = (last + more)[-8:]
    os.close(listen)
    safe = int.from_bytes(last, "little")
    if not folder.exists() or not list(folder.iterdir()):
        if safe:
            raise SystemExit("frames were said to be safe, and there is no file")
        return "no file yet"
    result = recover(folder / "run.mcap", instrument=small_instrument())
    kept = packets_in(result.path) if result.path else []
    if len(kept) < safe or any(p != packets[i % len(packets)] for i, p in enumerate(kept)):
        raise SystemExit(f"{safe} frames were safe, {len(kept)} came back, or others did")
    return result.outcome.name.lower()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--bit-step", type=int, default=1, help="flip one bit in so many")
    parser.add_argument("--byte-step", type=int, default=1, help="cut at one byte in so many")
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
    print("| what was done | times | how recovery went |\n|---|---|---|")
    for title, times, outcomes in rows:
        told = "; ".join(f"{count} {what}" for what, count in outcomes.most_common())
        print(f"| {title} | {times} | {told} |")


if __name__ == "__main__":
    main()
