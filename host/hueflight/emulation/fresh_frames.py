# SPDX-License-Identifier: Apache-2.0
"""New photons for every frame, drawn by a process of their own while the camera runs."""

from __future__ import annotations

import multiprocessing
import random
import threading
from collections import deque
from multiprocessing.connection import Connection

from hueflight.devices.errors import DeviceError, DeviceGoneError
from hueflight.devices.illumination import CaptureKind
from hueflight.emulation.frame_bank import Template, draw_packets
from hueflight.model.instrument import Instrument

BATCH = 32  #: frames in one message
AHEAD = 960  #: frames that may wait for the camera
RECENT = 480  #: frames of which one is repeated if none waits
FIRST_S = 300.0  #: longest time until the first frames come: the scene is computed before
#: pixels of all frames in a second up to which one core draws them in time (measured: 24 million)
MOST_PIXELS_PER_S = 13e6
_ENDLESS = 1 << 31


class FreshFrames:
    """Frames with photons of their own, in the place of a `FrameBank`.

    Parameters
    ----------
    kind : CaptureKind
        Kind of the capture.
    instrument : Instrument
        The instrument to simulate.
    scene : str
        Name of the scene, used where the kind is ``"scene"``.
    distance : float
        Distance of the white target, in metres.
    seed : int
        Seed of the photons.
    frames : int
        Number of frames of each LED of a capture of kind ``"bands"``.

    Attributes
    ----------
    kind : CaptureKind
        Kind of the capture.
    repeated : int
        Frames that were repeated because the next one was not drawn in time.

    Raises
    ------
    DeviceError
        If no frames come.
    """

    def __init__(
        self,
        kind: CaptureKind,
        instrument: Instrument,
        /,
        *,
        scene: str,
        distance: float,
        seed: int,
        frames: int = 0,
    ) -> None:
        self.kind: CaptureKind = kind
        self.repeated = 0
        self._fresh: deque[Template] = deque()
        self._recent: deque[Template] = deque(maxlen=RECENT)
        self._changed = threading.Condition()
        self._ended = False
        self._rng = random.Random(seed)
        context = multiprocessing.get_context("spawn")
        self._receiver, sender = context.Pipe(duplex=False)
        number = frames if kind == "bands" else _ENDLESS
        self._process = context.Process(
            target=_send_frames,
            args=(sender, kind, instrument.to_json(), scene, distance, number, seed),
            daemon=True,
        )
        self._process.start()
        sender.close()  # so that the end of the process is the end of the stream
        threading.Thread(target=self._receive, name="photons", daemon=True).start()
        with self._changed:
            self._changed.wait_for(lambda: self._fresh or self._ended, FIRST_S)
            if not self._fresh:
                raise DeviceError(
                    "simulated instrument: the process that draws photons sent none; its error is "
                    "in the log"
                )

    def template(self, frame: int, /) -> Template:
        """Return the next frame, or an earlier one if none is drawn yet.

        Parameters
        ----------
        frame : int
            Number of the frame in the run; frames follow one another.

        Returns
        -------
        Template
            The frame.

        Raises
        ------
        DeviceGoneError
            If the process that draws photons has ended.
        """
        with self._changed:
            if self._fresh:
                self._recent.append(self._fresh.popleft())
                self._changed.notify_all()
                return self._recent[-1]
            if self._ended and self.kind != "bands":
                raise DeviceGoneError("simulated instrument: the process that draws photons ended")
            self.repeated += 1
            return self._rng.choice(self._recent)

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._process.terminate()
        self._process.join()

    def _receive(self) -> None:
        try:
            while not self._ended:
                templates = [Template(packet) for packet in self._receiver.recv()]
                with self._changed:
                    self._fresh.extend(templates)
                    self._changed.notify_all()
                    self._changed.wait_for(lambda: self._ended or len(self._fresh) < AHEAD)
        except (EOFError, OSError):
            pass  # the process has ended
        with self._changed:
            self._ended = True
            self._changed.notify_all()


def _send_frames(
    sender: Connection,
    kind: str,
    instrument_json: str,
    scene: str,
    distance: float,
    frames: int,
    seed: int,
) -> None:
    """Draw frames as fast as they are taken, until nobody takes them."""
    batch: list[bytes] = []
    try:
        for packet in draw_packets(kind, instrument_json, scene, distance, frames, seed):
            batch.append(packet)
            if len(batch) == BATCH:
                sender.send(batch)
                batch = []
        sender.send(batch)
    except (BrokenPipeError, KeyboardInterrupt):
        return  # the camera is closed
