# SPDX-License-Identifier: Apache-2.0
"""Memory runs out once in the Python code of a recording: what was acknowledged must be kept.

A small recording is made again and again, each time in a process of its own. In the first run the
first allocation of the interpreter fails, then the second one, and so on, until no run fails any
more. The program goes on after a `MemoryError` or a `RecordingError`, as the daemon does, and
closes the recording at its end. Then its files must hold exactly the packets that it has counted as
stored, in order, and what it has counted as stored and as lost must be all that it was given.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from child_process import in_child
from power_cuts import MEMORY, packets_in, small_instrument
from report import Report, table

from hueflight.errors import HueflightError, RecordingError
from hueflight.recording import RecordingWriter, recover
from hueflight.recording.layout import segment_files
from hueflight_protocol import encode_frame

PASSES = 200
"""Runs in a row without a failure, after which there are taken to be no more allocations."""
FEWEST_PASSES = 20  #: if only some allocations are tried
FRAMES = 24
QUICK_STEP = 97
MOST_FINDINGS = 10
OUTCOMES = {
    "complete": "everything was stored nevertheless",
    "refused": "the recording was not begun",
    "counted": "the rest was counted as lost",
    "reported": "a call raised MemoryError, and took nothing",
    "other": "a call raised another error of the interpreter or NumPy",
    "ended": "the interpreter or NumPy crashed or hung",
}


def run(*, step: int = 1) -> tuple[Counter[str], list[str]]:
    """Let every `step`-th allocation fail; return outcomes by name, and findings."""
    outcomes: Counter[str] = Counter()
    findings: list[str] = []
    codes = np.random.default_rng(1).integers(0, 512, (FRAMES, 8, 8))
    packets = [encode_frame(c, sequence=i, frame=i, timestamp=i) for i, c in enumerate(codes)]
    passes, number = 0, 0
    enough = max(PASSES // step, FEWEST_PASSES)
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as name:
        _record(Path(name) / "first.mcap", packets)  # what is loaded and kept once, is
        while passes < enough and len(findings) < MOST_FINDINGS:
            found = _try_in_process(Path(name), packets, number)
            passes = 0 if found["failed"] or found["findings"] else passes + 1
            if found["failed"]:
                outcomes[found["outcome"]] += 1
            findings += [f"allocation {number}: {finding}" for finding in found["findings"]]
            number += step
    return outcomes, findings


def _try_in_process(folder: Path, packets: list[bytes], number: int) -> dict[str, Any]:
    """Make one run in a child process, and return what it found."""
    shutil.rmtree(folder / "run", ignore_errors=True)
    (folder / "run").mkdir()
    path = folder / "run" / "run.mcap"
    found = in_child(lambda: _try(path, packets, number), folder / "said.json")
    if found is not None:
        return found
    kept = _kept(path) if list(path.parent.iterdir()) else []
    return {"failed": True, "outcome": "ended", "findings": _misplaced(kept, packets)}


def _try(path: Path, packets: list[bytes], number: int) -> dict[str, Any]:
    writer, errors = _record(path, packets, failing=number)
    if writer is None:
        left = sorted(each.name for each in path.parent.iterdir())
        findings = [f"{', '.join(left)} left of a recording that was not begun"] if left else []
        return {"failed": True, "outcome": "refused", "findings": findings}
    return _judge(path, packets, writer, errors)


def _record(
    path: Path, packets: list[bytes], *, failing: int | None = None
) -> tuple[RecordingWriter | None, list[Exception]]:
    """Record packets as the daemon does; return the writer if there is one, and all errors."""
    hooks = import_module("_testcapi")  # the interpreter's own tests use it for this
    writer: RecordingWriter | None = None
    errors: list[Exception] = []
    if failing is not None:
        hooks.set_nomemory(failing, failing + 1)
    try:
        writer = RecordingWriter(
            path, small_instrument(), chunk_bytes=300, settle_bytes=600, segment_bytes=1500
        )
    except Exception as error:
        errors.append(error)
    for packet in packets:
        try:
            if writer:
                writer.write(packet)
        except Exception as error:
            errors.append(error)
    try:
        if writer:
            writer.close()
    except Exception as error:
        errors.append(error)
    hooks.remove_mem_hooks()
    return writer, errors


def _judge(
    path: Path, packets: list[bytes], writer: RecordingWriter, errors: list[Exception]
) -> dict[str, Any]:
    """Compare the files with what the writer has counted."""
    kept = _kept(path)
    findings = _misplaced(kept, packets)
    if len(kept) != writer.frames:
        findings.append(f"{writer.frames} packets counted as stored, {len(kept)} in the files")
    # a call that raised something else than a RecordingError may have taken nothing
    refused = sum(not isinstance(error, RecordingError) for error in errors)
    if not 0 <= len(packets) - writer.frames - writer.lost_frames <= refused:
        findings.append(
            f"{writer.frames} stored and {writer.lost_frames} lost, of {len(packets)}: "
            + "; ".join(map(repr, errors))
        )
    if writer.lost_frames and writer.error is None:
        findings.append(f"{writer.lost_frames} packets are lost, and no error says so")
    foreign = [e for e in errors if not isinstance(e, (MemoryError, RecordingError))]
    if foreign:
        outcome = "other"
    elif len(kept) == len(packets):
        outcome = "complete"
    else:
        outcome = "counted" if writer.error else "reported"
    return {"failed": bool(errors), "outcome": outcome, "findings": findings}


def _misplaced(kept: list[bytes], packets: list[bytes]) -> list[str]:
    """Return what is wrong with the order of the packets that were found."""
    places = [packets.index(packet) if packet in packets else -1 for packet in kept]
    if -1 in places:
        return ["packets that were never recorded"]
    if places != sorted(set(places)):
        return ["packets twice or in another order"]
    return []


def _kept(path: Path) -> list[bytes]:
    """Return the packets of all files that are there, finished or not."""
    if not segment_files(path)[1]:
        with suppress(HueflightError):
            return packets_in(path)
    made = recover(path, path.with_name("out.mcap"), instrument=small_instrument())
    return packets_in(made.path) if made.path else []


def report(quick: bool) -> Report:
    """Return the figures of the page."""
    outcomes, findings = run(step=QUICK_STEP if quick else 1)
    rows = [["runs in which an allocation failed", f"{outcomes.total():,}"]]
    rows += [[words, f"{outcomes[name]:,}"] for name, words in OUTCOMES.items()]
    rows.append(["packets lost in silence or stored twice, wrong counts", str(len(findings))])
    return Report(table(["memory runs out while a recording is made", "number"], rows), findings)
