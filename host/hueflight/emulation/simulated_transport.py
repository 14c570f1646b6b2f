"""A model's endpoints without a bus between: the transport and stream of a simulated board."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from hueflight.devices.errors import DeviceGoneError
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.emulation.camera_model import CameraModel

_POLL_S = 0.002  #: how often a stream looks for frames that have become due


class SimulatedTransport:
    """Messages to a function that answers like a board; see `RegisterFile.handle`."""

    def __init__(self, handle: Callable[[bytes], bytes | None], name: str = "simulated") -> None:
        self.name = name
        self._handle: Callable[[bytes], bytes | None] | None = handle
        self._answers: deque[bytes] = deque()

    def send(self, message: bytes, /) -> None:
        """Ask."""
        if self._handle is None:
            raise DeviceGoneError(f"{self.name}: the simulated board is closed")
        answer = self._handle(message)
        if answer is not None:
            self._answers.append(answer)

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Take the answer; a model answers at once or never."""
        return self._answers.popleft() if self._answers else None

    def close(self) -> None:
        """Leave."""
        self._handle = None


class SimulatedStream:
    """The packet stream of a camera model.

    Parameters
    ----------
    model : whose packets.
    transfer_bytes : most bytes at a time.
    """

    def __init__(self, model: CameraModel, transfer_bytes: int, /) -> None:
        self._model = model
        self._transfer_bytes = transfer_bytes
        self._received = 0

    def read(self, timeout_s: float, /) -> bytes:
        """What the model has ready; waits for the next frame at most `timeout_s`."""
        deadline = time.monotonic() + timeout_s
        while not (data := self._model.pull(self._transfer_bytes)):
            if time.monotonic() >= deadline:
                break
            time.sleep(_POLL_S)
        if 0 < len(data) < self._transfer_bytes:  # let the transfer fill, as one on a bus does
            time.sleep(_POLL_S)
            data += self._model.pull(self._transfer_bytes - len(data))
        self._received += len(data)
        return data

    @property
    def statistics(self) -> StreamStatistics:
        """Totals so far; the queue is the model's buffer."""
        return StreamStatistics(self._received, self._model.waiting_bytes)

    def close(self) -> None:
        """Leave."""
