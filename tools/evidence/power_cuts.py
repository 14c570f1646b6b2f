# SPDX-License-Identifier: Apache-2.0
"""Power cuts during recordings: are acknowledged packets kept, and none invented?

A recording program's writes and waits for the disk are recorded. For every moment between two of
them, files are made as a disk may hold them after a power cut at that moment (`disk_images`), and
recovered with `hueflight.recording.recover`. A packet is acknowledged when the program takes
the bytes that hold it for safe (`Segment.settled`). Each time exactly the packets must be recovered
that are whole in the files, and all acknowledged ones must be among them.
"""

from __future__ import annotations

import hashlib
import random
import shutil
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from unittest import mock

import msgspec
import numpy as np
from disk_images import Image, file_states, images
from disk_log import DiskLog
from report import Report, table

from hueflight.errors import RecordingError
from hueflight.model.instrument import Instrument
from hueflight.recording import RecordingWriter, finish_recording, open_recording, recover
from hueflight.recording.layout import part_path
from hueflight.recording.segment import Segment
from hueflight_protocol import encode_frame

ALL = 300
"""Images of a moment up to which all are tried; of more, a sample of as many."""
MEMORY = Path("/dev/shm")
"""File system in memory, if there is one: a wait for a real disk takes milliseconds."""


@dataclass
class Result:
    """What was tried and found.

    Attributes
    ----------
    recordings, moments, acknowledged : int
        Recordings, moments of a power cut, and acknowledged packets over all images.
    outcomes : Counter of str
        Outcomes of the recoveries.
    finished, refused : int
        Images that were also finished in place, and for which that was refused because the head of
        a file or a segment was lost.
    findings : list of str
        What must not happen.
    """

    recordings: int = 0
    moments: int = 0
    acknowledged: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    finished: int = 0
    refused: int = 0
    findings: list[str] = field(default_factory=list)


@cache
def small_instrument() -> Instrument:
    """Return an instrument with one band and 8 × 8 pixels, whose files are mostly packets."""
    paper = Instrument.load("paper")
    sensor = msgspec.structs.replace(
        paper.sensor, rows=8, cols=8, detection_wavelength_nm=(), detection_probability=()
    )
    return paper.replace(sensor=sensor, lens=None, bands=paper.bands[:1], description="")


def run(*, wanted: int, seed: int = 1) -> Result:
    """Try at least `wanted` different images, or stop at ten findings."""
    rng, result, seen = random.Random(seed), Result(), set[bytes]()
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as name:
        while len(seen) < wanted and len(result.findings) < 10:
            _try_recording(Path(name), rng, result, seen, wanted)
    return result


def _try_recording(
    folder: Path, rng: random.Random, result: Result, seen: set[bytes], wanted: int
) -> None:
    log, packets = record(folder / "recorded", rng)
    result.recordings += 1
    cuts = list(range(1, len(log.events) + 1))
    rng.shuffle(cuts)
    for cut in cuts:
        states = file_states(log.events, cut)
        result.moments += 1
        claimed = log.claimed(cut)
        safe = [packet for packet in packets if any(packet in content for content in claimed)]
        for image in images(states, most=ALL, rng=rng):
            digest = _digest(image)
            if digest in seen:
                continue
            seen.add(digest)
            result.acknowledged += len(safe)
            _try_image(folder / "cut", image, packets, safe, result, finish=rng.random() < 0.05)
            if len(seen) >= wanted or len(result.findings) >= 10:
                return


def _digest(image: Image) -> bytes:
    made = hashlib.blake2b(digest_size=16)
    for name, content in sorted(image.items()):
        made.update(b"%s %d " % (name.encode(), len(content)) + content)
    return made.digest()


def record(folder: Path, rng: random.Random) -> tuple[DiskLog, list[bytes]]:
    """Record some packets, and return what happened to the files, and the packets."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    frames = rng.randrange(20, 120)
    codes = np.random.default_rng(rng.randrange(1 << 30)).integers(0, 512, (frames, 8, 8))
    packets = [encode_frame(c, sequence=i, frame=i, timestamp=i) for i, c in enumerate(codes)]
    log = DiskLog(folder)
    plain = Segment.settle

    def settle(segment: Segment) -> None:
        plain(segment)
        log.claim(part_path(segment.path), segment.settled)

    with (
        log.recording(),
        mock.patch.object(Segment, "settle", settle),
        RecordingWriter(
            folder / "run.mcap",
            small_instrument(),
            chunk_bytes=rng.choice((100, 300, 900, 2500)),
            settle_bytes=rng.choice((1, 800, 3000)),
            segment_bytes=rng.choice((3000, 6000, 1 << 20)),
        ) as writer,
    ):
        for packet in packets:
            writer.write(packet)
    return log, packets


def _try_image(
    folder: Path,
    image: Image,
    packets: list[bytes],
    safe: list[bytes],
    result: Result,
    *,
    finish: bool,
) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in image.items():
        (folder / name).write_bytes(content)
    path = folder / "run.mcap"
    if not image:
        result.outcomes["no file yet"] += 1
        kept = []
    else:
        recovered = recover(path, folder / "out.mcap", instrument=small_instrument())
        result.outcomes[recovered.outcome.name.lower()] += 1
        kept = packets_in(folder / "out.mcap") if recovered.path else []
    _compare("recovered", kept, image, packets, safe, result)
    if finish and image:
        for out in folder.glob("out*.mcap"):
            out.unlink()
        _try_to_finish(path, image, packets, safe, result)


def _try_to_finish(
    path: Path, image: Image, packets: list[bytes], safe: list[bytes], result: Result
) -> None:
    """Finish the recording in place; where that is refused, all packets must still be there."""
    try:
        finish_recording(path)
        kept = packets_in(path)
        result.finished += 1
    except RecordingError:
        out = recover(path, instrument=small_instrument()).path
        kept = packets_in(out) if out else []
        result.refused += 1
    _compare("finished", kept, image, packets, safe, result)


def _compare(
    what: str,
    kept: list[bytes],
    image: Image,
    packets: list[bytes],
    safe: list[bytes],
    result: Result,
) -> None:
    lost = set(safe) - set(kept)
    if lost:
        result.findings.append(f"{what}: {len(lost)} acknowledged packets are lost")
    if set(kept) - set(packets):
        result.findings.append(f"{what}: packets that were never recorded")
    whole = [packet for packet in packets if any(packet in file for file in image.values())]
    if what == "recovered" and kept != whole:
        result.findings.append(f"{what}: {len(kept)} packets, of {len(whole)} that are whole")


def packets_in(path: Path) -> list[bytes]:
    """Return all frame packets of a recording."""
    with open_recording(path) as recording:
        return list(recording.packets())


def report(quick: bool) -> Report:
    """Return the figures of the page."""
    result = run(wanted=2000 if quick else 100_000)
    recovered = ", ".join(f"{count:,} {name}" for name, count in result.outcomes.most_common())
    rows = [
        ["different images of disks", f"{result.outcomes.total():,}"],
        ["of recordings, and moments in them", f"{result.recordings}, {result.moments:,}"],
        ["acknowledged packets in all images", f"{result.acknowledged:,}"],
        ["outcomes of recovery", recovered],
        [
            "also finished in place; refused, and recovered",
            f"{result.finished:,}; {result.refused:,}",
        ],
        [
            "acknowledged packets lost, packets invented, or other findings",
            str(len(result.findings)),
        ],
    ]
    return Report(table(["power cuts", "number"], rows), result.findings)
