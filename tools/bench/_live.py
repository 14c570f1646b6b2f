# SPDX-License-Identifier: Apache-2.0
"""A producer process sends packets over a socket; this process checks, counts and records them."""

from __future__ import annotations

import json
import os
import queue
import resource
import select
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _measure import FRAMES_PER_SECOND, best_of, packets_of, table, uniform_codes

from hueflight.errors import RecordingError
from hueflight.ingest import HistogramStream
from hueflight.ingest.kernels import choose
from hueflight.ingest.scanner import Scanner
from hueflight.model.instrument import Instrument
from hueflight.recording import RecordingWriter, open_recording

PIECE = 1 << 20
FRAMES = 620
SECONDS = 3.0  # of each live run
QUEUED_PIECES = 32  # that wait for the recording's thread
BACKLOG_FRAMES = 620  # what a camera with a few MB of memory could still hold


def in_child(work: Callable[[], None]) -> int:
    """Run something in a process of its own; return its number."""
    child = os.fork()
    if child:
        return child
    try:
        work()
        os._exit(0)
    except BrokenPipeError:
        os._exit(0)
    finally:
        os._exit(1)


def socket_pair() -> tuple[socket.socket, socket.socket]:
    """A connected pair of Unix sockets with the largest buffers that are allowed."""
    ours, theirs = socket.socketpair()
    for end, option in ((ours, socket.SO_RCVBUF), (theirs, socket.SO_SNDBUF)):
        end.setsockopt(socket.SOL_SOCKET, option, 8 << 20)
    return ours, theirs


class Background:
    """Records in a thread of its own, as acquisition does, and makes the source wait for it."""

    def __init__(self, writer: RecordingWriter) -> None:
        self._writer = writer
        self._error: RecordingError | None = None
        self._pieces: queue.Queue[bytes | None] = queue.Queue(QUEUED_PIECES)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while (piece := self._pieces.get()) is not None:
            try:
                self._writer.write(piece)
            except RecordingError as error:
                self._error = error

    def write(self, piece: memoryview) -> None:
        """Take a copy of a piece, when there is room."""
        self._pieces.put(bytes(piece))

    def close(self) -> None:
        """Write what waits, finish the files, wait for the disk."""
        self._pieces.put(None)
        self._thread.join()
        self._writer.close()
        if self._error is not None:
            raise self._error


def receive(
    source: socket.socket,
    stream: HistogramStream,
    writer: Background | None,
    each_second: Callable[[], None] = lambda: None,
    until: float = float("inf"),
) -> int:
    """Take what comes until the end; return how many bytes it was."""
    received, due = 0, time.monotonic() + 1
    while time.monotonic() < until:
        space = stream.writable()[:PIECE]
        size = source.recv_into(space)
        if not size:
            break
        received += size
        if writer is not None:
            writer.write(space[:size])
        for block in stream.commit(size):
            stream.recycle(block)
        if time.monotonic() >= due:
            each_second()
            due += 1
    return received


def live() -> None:
    """Socket, CRC, histogram, and recording at the same time, as fast as it goes."""
    paper = Instrument.load("paper")
    rows = []
    for occupancy in (0.05, 0.3, 0.7, 1.0):
        packets = packets_of(uniform_codes(FRAMES, 192, 128, occupancy))
        for record in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                rows.append(_live_once(paper, packets, occupancy, Path(folder), record=record))
    print("## Socket → CRC → histogram, the producer on the same cores\n")
    print(table(["occupancy", "recording too", "MB/s", "× RT", "lost"], rows))


def _live_once(
    paper: Instrument, packets: bytes, occupancy: float, folder: Path, *, record: bool
) -> list[str]:
    ours, theirs = socket_pair()

    def produce() -> None:
        ours.close()
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            theirs.sendall(packets)

    child = in_child(produce)
    theirs.close()
    stream = HistogramStream(paper, block_frames=FRAMES)
    writer = Background(RecordingWriter(folder / "live.mcap", paper)) if record else None
    start = time.monotonic()
    size = receive(ours, stream, writer)
    if writer is not None:
        writer.close()
    seconds = time.monotonic() - start
    os.waitpid(child, 0)
    report = stream.report
    rate = report.frames / seconds / FRAMES_PER_SECOND
    lost = report.missing + report.damaged + (size // len(packets) * FRAMES - report.frames)
    return [
        f"{occupancy}",
        "yes" if record else "no",
        f"{size / seconds / 1e6:.0f}",
        f"{rate:.2f}",
        str(lost),
    ]


def recording() -> None:
    """Writing and reading recordings, beside plain writes of the same bytes."""
    paper = Instrument.load("paper")
    rows = []
    for occupancy in (0.3, 1.0):
        packets = packets_of(uniform_codes(FRAMES, 192, 128, occupancy))
        times = max(1, (400 << 20) // len(packets))
        size = times * len(packets)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            best = best_of(
                {
                    "recording": lambda: _record(folder, paper, packets, times),  # noqa: B023
                    "write": lambda: _write(folder, packets, times, sync=False),  # noqa: B023
                    "write, fsync": lambda: _write(folder, packets, times, sync=True),  # noqa: B023
                    "histogram of it all": lambda: _read(folder),  # noqa: B023
                },
                rounds=3,
            )
        rows += [
            [f"{occupancy}", name, f"{size / seconds / 1e6:.0f}", f"{best['write'] / seconds:.2f}"]
            for name, seconds in best.items()
        ]
    print("## Recordings (400 MiB, best of 3; recording ends with fsync of each segment)\n")
    print(table(["occupancy", "what", "MB/s", "against plain write"], rows))


def _record(folder: Path, paper: Instrument, packets: bytes, times: int) -> None:
    view = memoryview(packets)
    with RecordingWriter(folder / "run.mcap", paper, overwrite=True) as writer:
        for _ in range(times):
            for at in range(0, len(view), PIECE):
                writer.write(view[at : at + PIECE])


def _write(folder: Path, packets: bytes, times: int, *, sync: bool) -> None:
    view = memoryview(packets)
    with (folder / "plain").open("wb", buffering=0) as file:
        for _ in range(times):
            for at in range(0, len(view), PIECE):
                file.write(view[at : at + PIECE])
        if sync:
            os.fsync(file.fileno())


def _read(folder: Path) -> None:
    with open_recording(folder / "run.mcap") as source:
        source.histogram()


# -- at the pace of the camera -------------------------------------------------------------------


def paced(seconds: float, occupancy: float, plot: Path | None, record: Path | None) -> None:
    """A long run at real time: nothing may be lost, memory must not grow."""
    paper = Instrument.load("paper")
    packets = packets_of(uniform_codes(FRAMES, 192, 128, occupancy))
    sizes = np.diff(np.append(_starts(packets), len(packets)))
    ours, theirs = socket_pair()
    listen, tell = os.pipe()

    def produce() -> None:
        ours.close()
        told = json.dumps(_pace(theirs, packets, sizes, seconds)).encode()
        theirs.close()
        os.write(tell, told)

    child = in_child(produce)
    theirs.close()
    os.close(tell)
    stream = HistogramStream(paper, block_frames=FRAMES)
    writer = None
    if record:
        path = record / "paced.mcap"
        writer = Background(RecordingWriter(path, paper, segment_seconds=10))
    resident: list[float] = []
    start, used = time.monotonic(), time.process_time()
    receive(ours, stream, writer, lambda: resident.append(_resident_mb()))
    elapsed, busy = time.monotonic() - start, time.process_time() - used
    if writer is not None:
        writer.close()
    sent = json.loads(os.read(listen, 1 << 12))
    os.waitpid(child, 0)
    report = stream.report
    steady = resident[len(resident) // 10 :]
    rows = [
        ["seconds", f"{elapsed:.1f}"],
        ["frames sent by the producer", f"{sent['frames']:,}"],
        ["frames the producer had to drop", f"{sent['dropped']}"],
        ["frames counted", f"{report.frames:,}"],
        ["packets damaged or missing", f"{report.damaged + report.missing}"],
        ["frames per second", f"{report.frames / elapsed:,.0f}"],
        ["largest backlog of the producer, ms", f"{sent['backlog'] / FRAMES_PER_SECOND * 1e3:.1f}"],
        ["share of one core used here", f"{busy / elapsed:.2f}"],
        ["memory after a tenth, at the end, most (MB)",
         f"{steady[0]:.0f}, {steady[-1]:.0f}, {max(steady):.0f}"],
    ]  # fmt: skip
    print(f"## {seconds:.0f} s at real time, occupancy {occupancy}\n")
    print(table(["what", "value"], rows))
    if plot is not None:
        _plot(plot, resident, seconds, occupancy)
    if sent["dropped"] or report.frames != sent["frames"]:
        raise SystemExit("frames were lost")


def _starts(packets: bytes) -> list[int]:
    """Where the packets of a stream begin."""
    scanner = Scanner(Instrument.load("paper").sensor, choose())
    scanner.scan(packets, 0, final=True)
    return scanner.places[: scanner.frames, 0].astype(int).tolist()


def _pace(
    target: socket.socket, packets: bytes, sizes: np.ndarray, seconds: float
) -> dict[str, int]:
    """Send each frame when it is due; drop frames when too many wait, as a camera must."""
    target.setblocking(False)
    ends = np.cumsum(sizes).tolist()
    view = memoryview(packets)
    start = time.monotonic()
    total = int(seconds * FRAMES_PER_SECOND)
    sent = dropped = worst = 0
    at = 0  # byte of the stream's repetition that goes next
    place = 0  # frame of the repetition that goes next
    while sent + dropped < total:
        due = min(int((time.monotonic() - start) * FRAMES_PER_SECOND), total)
        waiting = due - sent - dropped
        worst = max(worst, waiting)
        if waiting > BACKLOG_FRAMES:  # whole repetitions, so that the stream stays in step
            dropped += FRAMES * (waiting // FRAMES)
            continue
        if not waiting:
            time.sleep(0.001)
            continue
        stop = min(place + waiting, FRAMES)
        try:
            at += target.send(view[at : min(ends[stop - 1], at + PIECE)])
        except BlockingIOError:
            select.select([], [target], [], 0.1)
            continue
        while place < FRAMES and ends[place] <= at:
            place += 1
            sent += 1
        if place == FRAMES:
            place = at = 0
    return {"frames": sent, "dropped": dropped, "backlog": worst}


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def _plot(path: Path, resident: list[float], seconds: float, occupancy: float) -> None:
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "hueflight"
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
    axes.plot(np.arange(1, len(resident) + 1), resident, color="tab:blue")
    axes.set(
        xlabel="time (s)",
        ylabel="resident memory (MB)",
        ylim=(0, 1.3 * max(resident)),
        xlim=(0, seconds),
        title=f"{seconds:.0f} s at 18 600 frames per second, occupancy {occupancy}",
    )
    figure.savefig(path, metadata={"Date": None})
