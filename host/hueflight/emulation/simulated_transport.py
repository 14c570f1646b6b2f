# SPDX-License-Identifier: Apache-2.0
"""Transport and stream of a simulated board: the endpoints of a model, without a bus."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from hueflight.devices.camera import TRANSFER_S
from hueflight.devices.errors import DeviceGoneError
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.emulation.camera_model import CameraModel

UNPLUGGED = "the simulated camera is unplugged, as it was asked for"
_POLL_S = 0.002  #: how often a stream looks for frames that have become due


class SimulatedTransport:
    """Carries messages to a function that answers as a board does.

    Parameters
    ----------
    handle : callable
        Returns the answer to a message, or None; see `RegisterFile.handle`.
    name : str
        Place of the board for people.
    is_plugged : callable, optional
        Returns False while the cable is pulled.
    """

    def __init__(
        self,
        handle: Callable[[bytes], bytes | None],
        name: str = "simulated",
        *,
        is_plugged: Callable[[], bool] = lambda: True,
    ) -> None:
        self.name = name
        self._is_plugged = is_plugged
        self._handle: Callable[[bytes], bytes | None] | None = handle
        self._answers: deque[bytes] = deque()

    def send(self, message: bytes, /) -> None:
        """Send one encoded request.

        Parameters
        ----------
        message : bytes
            The request.
        """
        if self._handle is None:
            raise DeviceGoneError(f"{self.name}: the simulated board is closed")
        if not self._is_plugged():
            raise DeviceGoneError(f"{self.name}: {UNPLUGGED}")
        answer = self._handle(message)
        if answer is not None:
            self._answers.append(answer)

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Return the answer; a model answers at once or never.

        Parameters
        ----------
        timeout_s : float
            Not used.

        Returns
        -------
        bytes or None
            The answer, None if there is none.
        """
        return self._answers.popleft() if self._answers else None

    def close(self) -> None:
        """Release the model."""
        self._handle = None


class SimulatedStream:
    """The packet stream of a camera model.

    Parameters
    ----------
    model : CameraModel
        The camera.
    transfer_bytes : int
        Most bytes that are read at once.
    is_plugged : callable, optional
        Returns False while the cable is pulled.
    """

    def __init__(
        self,
        model: CameraModel,
        transfer_bytes: int,
        /,
        *,
        is_plugged: Callable[[], bool] = lambda: True,
    ) -> None:
        self._is_plugged = is_plugged
        self._model = model
        self._transfer_bytes = transfer_bytes
        self._received = 0

    def read(self, timeout_s: float, /) -> bytes:
        """Return the bytes that are ready.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait for the next frame, in seconds.

        Returns
        -------
        bytes
            Part of the stream, empty if no frame came in time.
        """
        if not self._is_plugged():
            raise DeviceGoneError(f"simulated: {UNPLUGGED}")
        deadline = time.monotonic() + timeout_s
        while not (data := self._transfer()):  # frames that are gathered to sums send nothing yet
            if time.monotonic() >= deadline:
                return b""
            time.sleep(_POLL_S)
        self._received += len(data)
        return data

    def _transfer(self) -> bytes:
        """Fetch what is there, after the time that a transfer on a bus takes to fill."""
        ready = self._model.ready_bytes
        if not ready:
            return b""
        if ready < self._transfer_bytes:
            time.sleep(TRANSFER_S)
        return self._model.pull(self._transfer_bytes)

    @property
    def statistics(self) -> StreamStatistics:
        """Totals so far; the queue is the model's buffer."""
        return StreamStatistics(self._received, self._model.waiting_bytes)

    def close(self) -> None:
        """Release the model."""
