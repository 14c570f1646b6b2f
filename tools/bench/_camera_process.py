# SPDX-License-Identifier: Apache-2.0
"""An emulated camera in a process of its own, as a camera takes nothing from the daemon's.

The stream comes through two pieces of shared memory, one of which is filled while the other is
read, as a USB host controller fills transfers that wait for it.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

from hueflight.devices.transports.stream import StreamStatistics
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.frame_bank import simulated_packets
from hueflight.emulation.simulated_transport import SimulatedStream
from hueflight.model.instrument import Instrument

KINDS = ("scene", "reference")
KEPT_PICTURES = 3  #: of sums, that are sent in turn as the frames are
TOLD_S = 0.5  #: how often the process tells what it has taken
PATIENCE_S = 1.0  #: of a read that waits for frames


class CameraProcess:
    """A camera model that plays drawn frames in another process.

    Parameters
    ----------
    drawing, played : Instrument
        Instruments by which frames are drawn, and by which they are played.
    drawn : int
        Frames that are played in turn.
    buffer_bytes : int
        Size of the camera's buffer.
    told : Path
        File that receives the processor time of the process, in seconds.
    link_bytes_per_s : float, optional
        What the link carries; by default as much as there is.
    """

    def __init__(
        self,
        drawing: Instrument,
        played: Instrument,
        drawn: int,
        buffer_bytes: int,
        told: Path,
        link_bytes_per_s: float = float("inf"),
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._control, control = context.Pipe()
        self.data, data = context.Pipe()
        self._lock = threading.Lock()
        instruments = (drawing.to_json(), played.to_json())
        self._process = context.Process(
            target=_play,
            args=(
                control,
                data,
                *instruments,
                drawn,
                buffer_bytes,
                str(told),
                link_bytes_per_s,
            ),
            daemon=True,
        )
        self._process.start()
        self._control.recv()  # all frames are drawn

    def handle(self, message: bytes, /) -> bytes | None:
        """Answer a control message as the board does."""
        return self._ask("handle", message)

    def show(self, kind: str, /) -> None:
        """Play frames of another kind."""
        self._ask("show", kind)

    def _ask(self, what: str, argument: Any) -> Any:
        with self._lock:
            self._control.send((what, argument))
            return self._control.recv()


class ProcessStream:
    """The packet stream of a camera in another process.

    Parameters
    ----------
    camera : CameraProcess
        The camera.
    transfer_bytes : int
        Most bytes that are read at once.
    """

    def __init__(self, camera: CameraProcess, transfer_bytes: int, /) -> None:
        self._data = camera.data
        self._memory = [SharedMemory(create=True, size=transfer_bytes) for _ in range(2)]
        self._received = self._waiting = 0
        self._filling = 0
        self._data.send((transfer_bytes, [memory.name for memory in self._memory]))
        self._data.send(self._filling)

    def read(self, timeout_s: float, /) -> bytes:
        """Return the bytes of the next transfer, empty if none came in time."""
        if not self._data.poll(timeout_s):
            return b""
        size, self._waiting = self._data.recv()
        filled, self._filling = self._filling, 1 - self._filling
        self._data.send(self._filling)
        self._received += size
        memory = self._memory[filled].buf
        assert memory is not None  # not closed
        return bytes(memory[:size])

    @property
    def statistics(self) -> StreamStatistics:
        """Totals so far; the queue is the camera's buffer."""
        return StreamStatistics(self._received, self._waiting)

    def close(self) -> None:
        """Wait for the transfer that is being filled, and release the memory."""
        if self._data.poll(2 * PATIENCE_S):
            self._data.recv()
        self._data.send(None)
        for memory in self._memory:
            memory.close()
            memory.unlink()


def _play(
    control: Connection,
    data: Connection,
    drawing: str,
    played: str,
    drawn: int,
    buffer_bytes: int,
    told: str,
    link_bytes_per_s: float,
) -> None:
    banks = {
        kind: FrameBank(simulated_packets(kind, drawing, "fig1", 0.4, drawn, 1)) for kind in KINDS
    }
    model = CameraModel(
        Instrument.from_json(played).sensor,
        banks["scene"],
        buffer_bytes=buffer_bytes,
        kept_pictures=KEPT_PICTURES,
    )
    for work in (lambda: _fill(model, data, link_bytes_per_s), lambda: _tell(Path(told))):
        threading.Thread(target=work, daemon=True).start()
    control.send(None)
    while True:
        try:
            what, argument = control.recv()
        except EOFError:  # the daemon has ended
            return
        if what == "show":
            model.bank = banks[argument]
        control.send(model.handle(argument) if what == "handle" else None)


def _fill(model: CameraModel, data: Connection, link_bytes_per_s: float) -> None:
    """Fill pieces of shared memory as they are asked for, for one stream after another."""
    while True:
        transfer_bytes, names = data.recv()
        stream = SimulatedStream(model, transfer_bytes)
        memory = [SharedMemory(name=name) for name in names]
        free_s = 0.0  # when the link has carried what was read
        while (place := data.recv()) is not None:
            read = stream.read(PATIENCE_S)
            memory[place].buf[: len(read)] = read
            now_s = time.monotonic()
            free_s = max(free_s, now_s) + len(read) / link_bytes_per_s
            time.sleep(free_s - now_s)
            data.send((len(read), model.waiting_bytes))
        for piece in memory:
            piece.close()


def _tell(told: Path) -> None:
    while True:
        new = told.with_suffix(".new")
        new.write_text(str(time.process_time()))
        new.replace(told)
        time.sleep(TOLD_S)
